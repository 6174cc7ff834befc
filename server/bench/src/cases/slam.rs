//! Odometry over recorded frames, and pose graphs.

use super::depth::Frame;
use super::files::read_cloud;
use super::{Case, timed};
use crate::g2o::pose_graph;
use crate::{Args, BenchError};
use nalgebra::Matrix4;
use percept_evaluation::{Alignment, Delta, PosePair, absolute_error, relative_error};
use percept_formats::g2o::G2oFile;
use percept_formats::g2o::Indefinite;
use percept_formats::{Limits, decode_color, parse_g2o, read_file};
use percept_geometry::{Pose, Timestamp};
use percept_slam::pose_graph::{Manifold, OptimiseParams, PlanarPose, PoseGraph, solve};
use percept_slam::{CloudScan, DepthScan, Odometry, OdometryKind, OdometryParams, Scan};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames fed one by one to an odometry that begins anew with every run.
struct Stream {
    kind: OdometryKind,
    items: usize,
    frame_s: f64,
    scans: Vec<Scan>,
    truth: Option<Vec<Pose>>,
    /// Sensor to base in what is compared.
    t_base_sensor: Pose,
    poses: Vec<Pose>,
}

impl Case for Stream {
    fn items(&self) -> usize {
        self.items
    }

    fn run(&mut self) -> Result<Option<usize>, BenchError> {
        let mut odometry = Odometry::new(self.kind, OdometryParams::default());
        self.poses.clear();
        for (k, scan) in self.scans.iter().enumerate() {
            let stamp = Timestamp::from_secs_f64(k as f64 * self.frame_s);
            let estimate = odometry.register(stamp, scan, None);
            self.poses.push(estimate.t_odom_base * self.t_base_sensor);
        }
        Ok(Some(self.scans.len()))
    }

    fn extra(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("scans".to_owned(), json!(self.poses.len()));
        let Some(truth) = &self.truth else { return out };
        let pairs: Vec<PosePair> = (truth.iter().zip(&self.poses).zip(0..))
            .map(|((&reference, &estimate), k)| PosePair { stamp: Timestamp(k), reference, estimate })
            .collect();
        if let Ok(e) = absolute_error(&pairs, Alignment::Se3) {
            out.insert("ate_m".to_owned(), json!(e.translation_m.rmse));
        }
        if let Ok(e) = relative_error(&pairs, Delta::Frames(1), false, 1.0) {
            out.insert("rpe_t_m".to_owned(), json!(e.translation_m.rmse));
            out.insert("rpe_r_deg".to_owned(), json!(e.rotation_deg.rmse));
        }
        if let (Some(a), Some(b)) = (pairs.first(), pairs.last()) {
            let moved = |from: &Pose, to: &Pose| from.inv_mul(to);
            let off = moved(&a.reference, &b.reference).inv_mul(&moved(&a.estimate, &b.estimate));
            out.insert("end_m".to_owned(), json!(off.translation.vector.norm()));
        }
        out
    }
}

/// `odometry_lidar3d dir= [truth=]`: KITTI scans of a folder in order of their names, ten a second.
pub(super) fn lidar3d(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let dir: PathBuf = args.required("dir")?;
    let entries = std::fs::read_dir(&dir).map_err(|e| BenchError(format!("{}: {e}", dir.display())))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "bin"));
    paths.sort();
    let clouds = paths.iter().map(|p| read_cloud(p)).collect::<Result<Vec<_>, _>>()?;
    let items = clouds.iter().map(percept_geometry::PointCloud::len).sum::<usize>() / clouds.len().max(1);
    let scan = |cloud| Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor: Pose::identity() });
    Ok(Box::new(Stream {
        kind: OdometryKind::Lidar3d,
        items,
        frame_s: 0.1,
        scans: clouds.into_iter().map(scan).collect(),
        truth: args.optional::<PathBuf>("truth")?.map(|p| read_poses(&p, 12)).transpose()?,
        t_base_sensor: Pose::identity(),
        poses: vec![],
    }))
}

/// `odometry_rgbd dir= frames=`: depth and colour of the first frames, thirty a second.
pub(super) fn rgbd(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let (dir, frames): (PathBuf, usize) = (args.required("dir")?, args.required("frames")?);
    let t_base_sensor = Pose::from_parts(Default::default(), percept_geometry::SensorSpec::optical_rotation());
    let limits = Limits::default();
    let scan = |k: usize| {
        let frame = Frame::number(&dir, k)?;
        let bytes = read_file(&dir.join(format!("{k:04}.color.jpg")), &limits).map_err(BenchError::new)?;
        let color = decode_color(&bytes, &limits).map_err(BenchError::new)?;
        let (depth, intrinsics) = (Arc::new(frame.metres()?), frame.camera);
        Ok(Scan::Depth(DepthScan { depth, color: Some(Arc::new(color)), intrinsics, t_base_sensor }))
    };
    let scans = (0..frames).map(scan).collect::<Result<Vec<_>, BenchError>>()?;
    let items = scans.first().map_or(0, |s| match s {
        Scan::Depth(d) => d.depth.width() * d.depth.height(),
        _ => 0,
    });
    Ok(Box::new(Stream {
        kind: OdometryKind::Rgbd,
        items,
        frame_s: 1.0 / 30.0,
        scans,
        truth: Some(read_poses(&dir.join("poses.txt"), 16)?),
        t_base_sensor,
        poses: vec![],
    }))
}

/// Rows of a 3 x 4 or 4 x 4 matrix, one pose after another.
fn read_poses(path: &Path, numbers: usize) -> Result<Vec<Pose>, BenchError> {
    let bytes = read_file(path, &Limits::default()).map_err(BenchError::new)?;
    let text = String::from_utf8_lossy(&bytes);
    let values: Vec<f64> =
        text.split_whitespace().map(str::parse).collect::<Result<_, _>>().map_err(BenchError::new)?;
    let pose = |rows: &[f64]| {
        let mut m = Matrix4::identity();
        rows.iter().enumerate().for_each(|(i, v)| m[(i / 4, i % 4)] = *v);
        let r = nalgebra::Rotation3::from_matrix(&m.fixed_view::<3, 3>(0, 0).into_owned());
        let t = m.fixed_view::<3, 1>(0, 3).into_owned();
        Pose::from_parts(t.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&r))
    };
    Ok(values.chunks_exact(numbers).map(pose).collect())
}

/// `pose_graph file=`: a g2o file solved from where it starts.
pub(super) fn graph(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let path: PathBuf = args.required("file")?;
    let bytes = read_file(&path, &Limits::default()).map_err(BenchError::new)?;
    match parse_g2o(&bytes, &Limits::default(), Indefinite::Refuse).map_err(BenchError::new)? {
        G2oFile::Planar(file) => {
            let (graph, has_poses) = pose_graph(&file, |[x, y, yaw]| PlanarPose { x, y, yaw })?;
            Ok(solved(graph, has_poses))
        }
        G2oFile::Spatial(file) => {
            let (graph, has_poses) = pose_graph(&file, |pose| pose)?;
            Ok(solved(graph, has_poses))
        }
    }
}

fn solved<P: Manifold<D> + 'static, const D: usize>(graph: PoseGraph<P, D>, has_poses: bool) -> Box<dyn Case> {
    let edges = graph.edges.len();
    let work = move || {
        let mut graph = graph.clone();
        solve(&mut graph, has_poses, &OptimiseParams::default()).map_err(BenchError::new)
    };
    timed(edges, work, |r| json!({"chi2": r.chi2, "chi2_start": r.chi2_start, "iterations": r.iterations}))
}

//! Recorded clouds: submaps of a street, a pair of scans, captures of a room, and all of these with one another.

use super::{Failure, Pair, Submap, overlap};
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};
use percept_geometry::{PointCloud, Pose};
use percept_perception::registration::{GlobalParams, IcpMethod, IcpParams, RegisterParams, register, register_global};
use percept_perception::search::KdTree;
use std::path::Path;

/// The submaps of a folder with their poses.
pub(super) fn read_submaps(folder: &Path) -> Result<Vec<Submap>, Failure> {
    let graph = std::fs::read_to_string(folder.join("graph.txt"))?;
    let mut maps = Vec::new();
    for line in graph.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(number) = words.first().and_then(|w| w.strip_prefix('v')) else { continue };
        let v: Vec<f64> = words[1..8].iter().map(|w| w.parse()).collect::<Result<_, _>>()?;
        let t_map_submap = Pose::from_parts(
            Translation3::new(v[0], v[1], v[2]),
            UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[3], v[4], v[5])),
        );
        let number: usize = number.parse()?;
        let bytes = std::fs::read(folder.join(format!("{number:06}")).join("points.bin"))?;
        let f = |c: &[u8]| f32::from_le_bytes([c[0], c[1], c[2], c[3]]);
        let points: Vec<_> =
            bytes.chunks_exact(12).map(|c| Point3::new(f(&c[0..4]), f(&c[4..8]), f(&c[8..12]))).collect();
        maps.push(Submap { number, t_map_submap, cloud: PointCloud::from_positions(points) });
    }
    Ok(maps)
}

/// Whole submaps, each with every other whose overlap is wanted.
pub(super) fn submaps(maps: &[Submap], wanted: impl Fn(f64) -> bool) -> Vec<Pair> {
    let mut out = Vec::new();
    for a in maps {
        let tree = KdTree::build(&a.cloud.positions);
        for b in maps {
            let t_target_source = a.t_map_submap.inverse() * b.t_map_submap;
            let same = a.number == b.number;
            let share = if same { f64::NAN } else { overlap(&tree, &b.cloud, &t_target_source, 0.5) };
            if wanted(share) {
                let name = format!("{}<-{}", a.number, b.number);
                let (source, target) = (b.cloud.clone(), a.cloud.clone());
                out.push(Pair { name, source, target, t_target_source, overlap: share });
            }
        }
    }
    out
}

pub(super) fn small_gicp(folder: &Path) -> Result<Pair, Failure> {
    let limits = percept_formats::Limits::default();
    let read = |name: &str| -> Result<PointCloud, Failure> {
        Ok(percept_formats::read_cloud_file(&folder.join(name), &limits)?.cloud)
    };
    let text = std::fs::read_to_string(folder.join("T_target_source.txt"))?;
    let v: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
    let r = nalgebra::Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
    let pose = Pose::from_parts(Translation3::new(v[3], v[7], v[11]), UnitQuaternion::from_matrix(&r));
    let (source, target) = (read("source.ply")?, read("target.ply")?);
    Ok(Pair { name: "target<-source".into(), source, target, t_target_source: pose, overlap: 0.9 })
}

/// Neighbouring captures of a room, either way. No truth is given: it is what GICP makes of the greatest overlap from
/// several starts, the sensor not having moved and what global registration says among them.
pub(super) fn captures(data: &Path) -> Result<Vec<Pair>, Failure> {
    let limits = percept_formats::Limits::default();
    let read = |k: usize| -> Result<PointCloud, Failure> {
        let file = data.join(format!("cloud-pcl/capture000{k}.pcd"));
        let cloud = percept_formats::read_cloud_file(&file, &limits)?.cloud;
        let finite = cloud.positions.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())).collect();
        Ok(PointCloud::from_positions(finite))
    };
    let clouds: Vec<PointCloud> = (1..=5).map(read).collect::<Result<_, _>>()?;
    let mut out = Vec::new();
    for (k, at) in clouds.windows(2).enumerate() {
        let [target, source] = at else { continue };
        let tree = KdTree::build(&target.positions);
        let mut best = (0.0, Pose::identity());
        let mut starts = vec![Pose::identity()];
        for voxel_size_m in [0.03, 0.05, 0.08] {
            let params = GlobalParams { voxel_size_m, ..GlobalParams::default() };
            starts.push(register_global(source, target, &params)?.t_target_source);
        }
        for start in starts {
            let mut t = start;
            for max_distance_m in [0.1, 0.03] {
                let icp = IcpParams {
                    max_distance_m,
                    max_iterations: 50,
                    num_neighbours: 20,
                    ..IcpParams::lidar(IcpMethod::Gicp)
                };
                let fine = RegisterParams { voxel_sizes_m: vec![0.01], icp };
                t = register(source, target, &t, &fine)?.t_target_source;
            }
            let share = overlap(&tree, source, &t, 0.02);
            if share > best.0 {
                best = (share, t);
            }
        }
        let names = [format!("{}<-{}", k + 1, k + 2), format!("{}<-{}", k + 2, k + 1)];
        let [forth, back] = names;
        let (a, b) = (source.clone(), target.clone());
        out.push(Pair { name: forth, source: a, target: b, t_target_source: best.1, overlap: best.0 });
        let (a, b) = (target.clone(), source.clone());
        out.push(Pair { name: back, source: a, target: b, t_target_source: best.1.inverse(), overlap: best.0 });
    }
    Ok(out)
}

/// Every cloud with every cloud of another recording.
pub(super) fn apart(data: &Path) -> Result<Vec<Pair>, Failure> {
    let limits = percept_formats::Limits::default();
    let mut clouds: Vec<(&str, PointCloud)> = Vec::new();
    for pair in submaps(&read_submaps(&data.join("lidar-kitti-07-submaps"))?, |share| share >= 0.8) {
        clouds.push(("07", pair.target));
    }
    clouds.push(("small_gicp", small_gicp(&data.join("registration-small-gicp"))?.target));
    for (recording, folder) in
        [("00", "lidar-kitti-odometry-00/velodyne"), ("tracking", "lidar-kitti-tracking-0000/velodyne")]
    {
        let mut files: Vec<_> = std::fs::read_dir(data.join(folder))?.filter_map(|e| Some(e.ok()?.path())).collect();
        files.sort();
        for file in files.iter().step_by((files.len() / 5).max(1)) {
            clouds.push((recording, percept_formats::read_cloud_file(file, &limits)?.cloud));
        }
    }
    let mut out = Vec::new();
    for (a, target) in &clouds {
        for (b, source) in clouds.iter().filter(|(b, _)| b != a) {
            let (source, target) = (source.clone(), target.clone());
            out.push(Pair {
                name: format!("{a}<-{b}"),
                source,
                target,
                t_target_source: Pose::identity(),
                overlap: 0.0,
            });
        }
    }
    Ok(out)
}

/// Every outdoor cloud and its own mirror image: all planes and posts of it are there, and no turn makes them one.
pub(super) fn mirrored(data: &Path) -> Result<Vec<Pair>, Failure> {
    let mut clouds: Vec<PointCloud> =
        read_submaps(&data.join("lidar-kitti-07-submaps"))?.into_iter().map(|m| m.cloud).collect();
    let pair = small_gicp(&data.join("registration-small-gicp"))?;
    clouds.extend([pair.source, pair.target]);
    let mirror = |cloud: PointCloud| {
        let target = PointCloud::from_positions(cloud.positions.iter().map(|p| Point3::new(p.x, -p.y, p.z)).collect());
        Pair { name: "mirrored".into(), source: cloud, target, t_target_source: Pose::identity(), overlap: 0.0 }
    };
    Ok(clouds.into_iter().map(mirror).collect())
}

//! 3D lidars' place recognition on recorded submaps: `submaps DIR [OTHER_SCANS_DIR]`.

use super::read::{self, Failure};
use nalgebra::{Point3, UnitQuaternion, Vector3, Vector6};
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, PointCloud, Pose, Timestamp};
use percept_slam::keyframe::keyframe_scan;
use percept_slam::loops::{KeyframePoses, Relocalisation, place_recognition};
use percept_slam::{BackEndParams, CloudScan, KeyframeParams, OdometryKind, OdometryParams, Scan};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

fn seen(points: &[Point3<f32>], t: &Pose) -> KeyframeScan {
    let positions = points.iter().map(|p| (t * p.cast::<f64>()).cast()).collect();
    let cloud = Arc::new(PointCloud::from_positions(positions));
    let scan = Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() });
    keyframe_scan(&KeyframeParams::default(), Timestamp(0), &"lidar".into(), &scan, &Vector6::zeros())
}

/// Where `lost` is in a map that holds nothing but `place`.
fn relocalise(place: &[Point3<f32>], lost: &KeyframeScan) -> Option<Relocalisation> {
    let mut recognition =
        place_recognition(OdometryKind::Lidar3d, &OdometryParams::default(), BackEndParams::default().place_limits())?;
    let mut poses = KeyframePoses::new();
    poses.insert(KeyframeId(0), Pose::identity());
    // A keyframe far away ends the first one's local map.
    poses.insert(KeyframeId(1), Pose::translation(1000.0, 0.0, 0.0));
    let scan = Arc::new(seen(place, &Pose::identity()));
    for id in [KeyframeId(0), KeyframeId(1)] {
        recognition.insert(id, &(&scan).into(), &Covariance6::zeros(), &poses);
    }
    recognition.relocalise(lost, &poses)
}

fn xyz(path: &Path) -> Result<Vec<Point3<f32>>, Failure> {
    let bytes = std::fs::read(path)?;
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    Ok(bytes.chunks_exact(12).map(|c| Point3::new(value(c), value(&c[4..]), value(&c[8..]))).collect())
}

pub(crate) fn submaps(dir: &Path, others: Option<&Path>) -> Result<(), Failure> {
    let rows = read::numbers(&dir.join("graph.txt"))?;
    let truth: Vec<Pose> = rows
        .chunks_exact(7)
        .map(|r| {
            let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(r[6], r[3], r[4], r[5]));
            Pose::from_parts(Vector3::new(r[0], r[1], r[2]).into(), q)
        })
        .collect();
    let clouds: Vec<Vec<Point3<f32>>> =
        (0..truth.len()).map(|i| xyz(&dir.join(format!("{i:06}/points.bin")))).collect::<Result<_, _>>()?;
    let (mut found, mut wrong, mut count, mut seconds) = (0, 0, 0, 0.0);
    let (mut metres, mut degrees) = (vec![], vec![]);
    for i in 0..clouds.len() {
        for j in (0..clouds.len()).filter(|&j| j != i) {
            // The lost robot stands elsewhere and looks elsewhere; the floor is level.
            let yaw = 2.4 * (3 * i + 5 * j) as f64;
            let t_lost_submap = Pose::from_parts(
                Vector3::new(3.0 * yaw.sin(), 5.0 * yaw.cos(), 0.3).into(),
                UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
            );
            let start = Instant::now();
            let answer = relocalise(&clouds[i], &seen(&clouds[j], &t_lost_submap));
            seconds += start.elapsed().as_secs_f64();
            count += 1;
            let Some(r) = answer else {
                println!("{i} <- {j}: not found");
                continue;
            };
            let expected = truth[i].inverse() * truth[j] * t_lost_submap.inverse();
            // Where the cloud's middle comes to lie.
            let middle = t_lost_submap * Point3::origin();
            let m = (r.t_keyframe_base * middle - expected * middle).norm();
            let d = r.t_keyframe_base.rotation.angle_to(&expected.rotation).to_degrees();
            println!("{i} <- {j}: off {m:.3} m {d:.3} deg, overlap {:.2}", r.inlier_ratio);
            let right = m < 0.5 && d < 2.0;
            (found, wrong) = (found + usize::from(right), wrong + usize::from(!right));
            metres.push(m);
            degrees.push(d);
        }
    }
    metres.sort_by(f64::total_cmp);
    degrees.sort_by(f64::total_cmp);
    let median = |v: &[f64]| v.get(v.len() / 2).copied().unwrap_or(f64::NAN);
    println!(
        "recognised {found} of {count}, wrong {wrong}; median {:.3} m {:.3} deg; {:.0} ms a pair",
        median(&metres),
        median(&degrees),
        1e3 * seconds / f64::from(count)
    );
    let Some(others) = others else { return Ok(()) };
    let mut names: Vec<_> = std::fs::read_dir(others)?.filter_map(|e| Some(e.ok()?.path())).collect();
    names.sort();
    let (mut tried, mut false_ones) = (0, 0);
    for path in names {
        let cloud = match path.extension().and_then(|e| e.to_str()) {
            Some("pcd") => read::pcd_xyzi(&path)?,
            _ => read::kitti_bin(&std::fs::read(&path)?),
        };
        let lost = seen(&cloud.positions, &Pose::identity());
        for place in &clouds {
            tried += 1;
            false_ones += usize::from(relocalise(place, &lost).is_some());
        }
    }
    println!("elsewhere: {false_ones} false of {tried}");
    Ok(())
}

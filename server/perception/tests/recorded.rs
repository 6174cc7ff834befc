//! Registration of recorded clouds against the poses of their data sets; skipped where those are absent.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use nalgebra::Point3;
use percept_geometry::{PointCloud, Pose};
use percept_perception::registration::{IcpMethod, IcpParams, IcpResult, RegisterParams, register};
use std::path::Path;

const METHODS: [IcpMethod; 4] = [IcpMethod::PointToPoint, IcpMethod::PointToPlane, IcpMethod::Gicp, IcpMethod::Vgicp];

percept_recorded::tests! {
    two_kitti_scans_agree_with_the_poses_of_the_data_set: "lidar-kitti-odometry-00";
    a_lidar_pair_meets_within_the_truth_of_the_data_set: "registration-small-gicp";
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().filter_map(|w| w.parse().ok()).collect()
}

fn pose(rows: &[f64]) -> Pose {
    let m = nalgebra::Matrix3x4::from_row_slice(&rows[..12]);
    let r = nalgebra::Rotation3::from_matrix(&m.fixed_view::<3, 3>(0, 0).into_owned());
    Pose::from_parts(m.column(3).into_owned().into(), nalgebra::UnitQuaternion::from_rotation_matrix(&r))
}

fn errors(truth: &Pose, found: &IcpResult) -> (f64, f64) {
    let off = truth.inverse() * found.t_target_source;
    (off.translation.vector.norm(), off.rotation.angle().to_degrees())
}

fn two_kitti_scans_agree_with_the_poses_of_the_data_set(data: &Path) {
    let dir = data.join("lidar-kitti-odometry-00");
    let read = |name: &str| std::fs::read_to_string(dir.join(name)).unwrap();
    let t_camera_lidar = pose(&numbers(&read("calib_Tr.txt").replace("Tr:", "")));
    let poses: Vec<Pose> = read("poses_00.txt").lines().map(|l| pose(&numbers(l))).collect();
    let cloud = |i: usize| {
        let bytes = std::fs::read(dir.join(format!("velodyne/{i:06}.bin"))).unwrap();
        let floats: Vec<f32> = bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        PointCloud::from_positions(floats.chunks_exact(4).map(|c| Point3::new(c[0], c[1], c[2])).collect())
    };
    let truth = t_camera_lidar.inverse() * poses[94].inverse() * poses[95] * t_camera_lidar;
    let (target, source) = (cloud(94), cloud(95));
    for method in METHODS {
        let icp = IcpParams { max_distance_m: 2.0, max_iterations: 50, ..IcpParams::lidar(method) };
        let params = RegisterParams { voxel_sizes_m: vec![0.25], icp };
        let found = register(&source, &target, &Pose::identity(), &params).unwrap();
        let (metres, degrees) = errors(&truth, &found);
        // Other libraries are 1 to 17 mm and 0.02 degrees from them.
        assert!(metres < 0.02 && degrees < 0.05, "{method:?}: {metres} m, {degrees} degrees");
        assert!(found.converged(), "{method:?}: {:?}", found.outcome);
    }
}

fn a_lidar_pair_meets_within_the_truth_of_the_data_set(data: &Path) {
    let dir = data.join("registration-small-gicp");
    let truth = pose(&numbers(&std::fs::read_to_string(dir.join("T_target_source.txt")).unwrap()));
    let cloud = |name: &str| {
        // Little-endian floats x, y, z, intensity after a header of text.
        let bytes = std::fs::read(dir.join(name)).unwrap();
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let floats: Vec<f32> =
            bytes[start..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        PointCloud::from_positions(floats.chunks_exact(4).map(|c| Point3::new(c[0], c[1], c[2])).collect())
    };
    let (target, source) = (cloud("target.ply"), cloud("source.ply"));
    for method in METHODS {
        let params = RegisterParams { voxel_sizes_m: vec![0.25], icp: IcpParams::lidar(method) };
        let found = register(&source, &target, &Pose::identity(), &params).unwrap();
        let (metres, degrees) = errors(&truth, &found);
        // The truth itself is a registration, good to about 7 mm and 0.34 degrees.
        assert!(metres < 0.021 && degrees < 0.4, "{method:?}: {metres} m, {degrees} degrees");
        assert!(found.converged() && found.inlier_ratio > 0.85, "{method:?}: {:?}", found.outcome);
    }
}

//! Odometry on recorded data, skipped when absent; bounds are those that a user is promised.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

#[path = "../examples/evaluate/measure.rs"]
#[allow(dead_code)]
mod measure;
#[path = "../examples/evaluate/read.rs"]
#[allow(dead_code)]
mod read;

use percept_geometry::{CameraIntrinsics, Covariance6, FeatureMethod, KeyframeId, Pose, Timestamp};
use percept_slam::loops::{KeyframePoses, place_recognition};
use percept_slam::{
    BackEndParams, CloudScan, DepthScan, ImageScan, KeyframeParams, Odometry, OdometryKind, OdometryParams, PlanarScan,
    Scale, Scan, keyframe,
};
use std::path::{Path, PathBuf};
use std::sync::Arc;

percept_recorded::tests! {
    seven_scenes_is_tracked_to_two_and_a_half_centimetres: "rgbd-7scenes-a";
    views_of_seven_scenes_are_placed_by_features_of_either_method_and_never_wrongly: "rgbd-7scenes-a";
    seven_scenes_is_tracked_by_its_colour_images_alone: "rgbd-7scenes-a";
    a_drive_of_seven_metres_ends_within_six_centimetres: "lidar-kitti-tracking-0000";
    two_scans_half_a_metre_apart_agree_with_the_truth: "lidar-kitti-odometry-00";
    the_intel_lab_comes_out_far_better_than_its_wheels: "lidar2d-intel";
}

fn seven_scenes_is_tracked_to_two_and_a_half_centimetres(data: &Path) {
    let dir = data.join("rgbd-7scenes-a");
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let intrinsics = CameraIntrinsics::pinhole(640, 480, 585.0, 585.0, 320.0, 240.0);
    let (mut truth, mut estimate) = (vec![], vec![]);
    for i in (0..400).step_by(2) {
        let name = dir.join(format!("frame-{i:06}"));
        let file = |end: &str| PathBuf::from(format!("{}{end}", name.display()));
        let depth = Arc::new(read::depth_png(&file(".depth.png"), 0.001).unwrap());
        let color = Some(Arc::new(read::color(&file(".color.jpg")).unwrap()));
        let scan = Scan::Depth(DepthScan { depth, color, intrinsics, t_base_sensor: Pose::identity() });
        let e = odometry.register(Timestamp::from_secs_f64(f64::from(i) / 30.0), &scan, None);
        assert!(!e.state.is_lost(), "frame {i}: {:?}", e.state);
        truth.push(read::pose_3x4(&read::numbers(&file(".pose.txt")).unwrap()).unwrap());
        estimate.push(e.t_odom_base);
    }
    let rmse = measure::ate_rmse(&truth, &estimate);
    // The truth itself is good to 1 to 3 cm.
    assert!(rmse < 0.025, "{rmse}");
}

fn views_of_seven_scenes_are_placed_by_features_of_either_method_and_never_wrongly(data: &Path) {
    let dir = data.join("rgbd-7scenes-a");
    let intrinsics = CameraIntrinsics::pinhole(640, 480, 585.0, 585.0, 320.0, 240.0);
    let view = |i: usize, features| {
        let name = dir.join(format!("frame-{i:06}"));
        let file = |end: &str| PathBuf::from(format!("{}{end}", name.display()));
        let depth = Arc::new(read::depth_png(&file(".depth.png"), 0.001).unwrap());
        let color = Some(Arc::new(read::color(&file(".color.jpg")).unwrap()));
        let scan = Scan::Depth(DepthScan { depth, color, intrinsics, t_base_sensor: Pose::identity() });
        let params = KeyframeParams { features, ..KeyframeParams::default() };
        let kept = keyframe::keyframe_scan(&params, Timestamp(0), &"camera".into(), &scan, &nalgebra::Vector6::zeros());
        (read::pose_3x4(&read::numbers(&file(".pose.txt")).unwrap()).unwrap(), Arc::new(kept))
    };
    for method in [FeatureMethod::Orb, FeatureMethod::Sift] {
        let mut places =
            place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
                .unwrap();
        let mut poses = KeyframePoses::new();
        for i in (0..400).step_by(50) {
            let (pose, kept) = view(i, method);
            poses.insert(KeyframeId(i as u64), pose);
            places.insert(KeyframeId(i as u64), &(&kept).into(), &Covariance6::identity(), &poses);
        }
        let mut found = 0;
        for i in (20..400).step_by(100) {
            let (truth, kept) = view(i, method);
            let Some(r) = places.relocalise(&kept, &poses) else { continue };
            let off = truth.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
            // Its colour camera stands 2 cm from the depth camera, which nothing tells here.
            assert!(off.translation.vector.norm() < 0.1 && off.rotation.angle() < 0.05, "{method:?} {i} {off}");
            found += 1;
        }
        assert!(found >= 3, "{method:?}: {found} of 4");
    }
}

fn seven_scenes_is_tracked_by_its_colour_images_alone(data: &Path) {
    let dir = data.join("rgbd-7scenes-a");
    let mut odometry = Odometry::new(OdometryKind::Mono, OdometryParams::default());
    let intrinsics = CameraIntrinsics::pinhole(640, 480, 585.0, 585.0, 320.0, 240.0);
    let (mut truth, mut estimate) = (vec![], vec![]);
    // Every fourth image of the source: 7.5 a second, which keeps the test short.
    for i in (0..400).step_by(4) {
        let name = dir.join(format!("frame-{i:06}"));
        let file = |end: &str| PathBuf::from(format!("{}{end}", name.display()));
        let image = Arc::new(read::color(&file(".color.jpg")).unwrap());
        let t_base_sensor = Pose::identity();
        let scan = Scan::Image(ImageScan { image, depth: None, second: None, intrinsics, t_base_sensor });
        let e = odometry.register(Timestamp::from_secs_f64(f64::from(i) / 30.0), &scan, None);
        assert_eq!(e.scale, Scale::Unknown);
        if e.state.is_tracking() {
            truth.push(read::pose_3x4(&read::numbers(&file(".pose.txt")).unwrap()).unwrap());
            estimate.push(e.t_odom_base);
        }
    }
    assert!(truth.len() > 80, "{}", truth.len());
    let (_, rmse) = measure::ate_scaled(&truth, &estimate);
    assert!(rmse < 0.07, "{rmse}");
}

fn a_drive_of_seven_metres_ends_within_six_centimetres(data: &Path) {
    let dir = data.join("lidar-kitti-tracking-0000");
    let truth = read::poses_3x4(&dir.join("poses_reference_gicp.txt")).unwrap();
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let mut last = Pose::identity();
    for i in 0..truth.len() {
        let cloud = Arc::new(read::pcd_xyzi(&dir.join(format!("velodyne/{i:010}.pcd"))).unwrap());
        let scan = Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() });
        let e = odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None);
        assert!(!e.state.is_lost());
        last = e.t_odom_base;
    }
    let off = truth.last().unwrap().inverse() * last;
    assert!(off.translation.vector.norm() < 0.06 && off.rotation.angle() < 0.005, "{off}");
}

fn two_scans_half_a_metre_apart_agree_with_the_truth(data: &Path) {
    let dir = data.join("lidar-kitti-odometry-00");
    let poses = read::poses_3x4(&dir.join("poses_00.txt")).unwrap();
    let tr = read::pose_3x4(&read::numbers(&dir.join("calib_Tr.txt")).unwrap()).unwrap();
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let mut last = Pose::identity();
    for i in [94, 95] {
        let bytes = std::fs::read(dir.join(format!("velodyne/{i:06}.bin"))).unwrap();
        let cloud = Arc::new(read::kitti_bin(&bytes));
        let scan = Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() });
        last = odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &scan, None).t_odom_base;
    }
    let truth = (tr.inverse() * poses[94] * tr).inverse() * (tr.inverse() * poses[95] * tr);
    let off = truth.inverse() * last;
    assert!(off.translation.vector.norm() < 0.02 && off.rotation.angle().to_degrees() < 0.06, "{off}");
}

fn the_intel_lab_comes_out_far_better_than_its_wheels(data: &Path) {
    let dir = data.join("lidar2d-intel");
    let log = read::carmen(&dir.join("intel.clf"), 80.0).unwrap();
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    let mut estimate = vec![];
    let mut last: Option<Pose> = None;
    for row in &log {
        let scan = Scan::Planar(PlanarScan { scan: Arc::new(row.scan.clone()), t_base_sensor: Pose::identity() });
        let prior = last.map(|last| measure::wheel_prior(&(last.inverse() * row.t_odom_base)));
        let e = odometry.register(row.stamp, &scan, prior.as_ref());
        assert!(!e.state.is_lost());
        estimate.push(e.t_odom_base);
        last = Some(row.t_odom_base);
    }
    let stamps: Vec<f64> = log.iter().map(|r| r.stamp.as_secs_f64()).collect();
    let rows = read::numbers(&dir.join("intel.relations")).unwrap();
    let errors = measure::relation_errors(&rows, &stamps, &estimate);
    let mean = errors.iter().map(|e| e.metres).sum::<f64>() / errors.len() as f64;
    assert!(mean < 0.5, "{mean}");
}

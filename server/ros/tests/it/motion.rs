//! Scans, calibration, motion, poses and grids.

use nalgebra::{Point2, Vector3};
use percept_geometry::cloud::Beam;
use percept_geometry::sensor::{ImuSample, OdometrySample};
use percept_geometry::{
    CameraIntrinsics, Covariance6, Distortion, GridGeometry, LaserScan, Pose, Stamped, Timestamp, se3,
};
use percept_ros::convert::{
    camera_info_message, grid, grid_message, imu, imu_message, intrinsics, odometry, odometry_message, path_message,
    pose, pose_covariance, pose_message, pose_with_covariance_message, rectified_intrinsics, scan, scan_message,
    transform, transform_message,
};
use percept_ros::messages as m;

#[test]
fn a_scan_keeps_what_rep_117_says() {
    let message = m::LaserScan {
        angle_min: -1.5,
        angle_increment: 0.5,
        range_min: 0.1,
        range_max: 10.0,
        ranges: vec![1.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN],
        ..Default::default()
    };
    let read = scan(&message).unwrap();
    let beams = [Beam::Hit(1.0), Beam::Free(10.0), Beam::Invalid, Beam::Invalid];
    assert_eq!(std::array::from_fn(|i| read.beam(i)), beams);
    assert_eq!((read.angle(1), read.intensities), (-1.0, None));
    let with = |change: fn(&mut m::LaserScan<'_>)| {
        let mut message = message.clone();
        change(&mut message);
        scan(&message).unwrap_err().to_string()
    };
    for bad in [|s: &mut m::LaserScan<'_>| s.range_max = -1.0, |s: &mut m::LaserScan<'_>| s.range_max = f32::NAN] {
        assert!(with(bad).contains("range_max"));
    }
    assert!(with(|s| s.angle_increment = f32::NAN).contains("angle_increment"));
    assert!(with(|s| s.intensities = vec![1.0; 3]).contains("intensities: expected 4 elements, got 3"));
}

/// What converters from clouds leave at its default, and drivers leave out: how far the sensor sees is not known.
#[test]
fn a_scan_without_a_limit_tells_of_what_it_measured() {
    for range_max in [f32::INFINITY, 0.0] {
        let ranges = vec![1.0, f32::INFINITY, 30.0, f32::NAN];
        let message = m::LaserScan { angle_increment: 0.5, range_min: 0.1, range_max, ranges, ..Default::default() };
        let read = scan(&message).unwrap();
        let beams = [Beam::Hit(1.0), Beam::Invalid, Beam::Hit(30.0), Beam::Invalid];
        assert_eq!(std::array::from_fn(|i| read.beam(i)), beams);
        let empty = m::LaserScan { ranges: vec![f32::INFINITY; 4], ..message };
        assert!((1.0..1.01).contains(&scan(&empty).unwrap().range_max_m));
    }
}

fn camera() -> m::CameraInfo<'static> {
    m::CameraInfo {
        height: 480,
        width: 640,
        distortion_model: "plumb_bob",
        d: vec![0.1, -0.2, 0.001, 0.002, 0.3],
        k: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0],
        p: [400.0, 0.0, 310.0, -40.0, 0.0, 410.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..Default::default()
    }
}

#[test]
fn intrinsics_are_those_of_the_raw_and_of_the_rectified_image() {
    let raw = intrinsics(&camera()).unwrap();
    assert_eq!((raw.width, raw.height), (640, 480));
    assert_eq!([raw.fx, raw.fy, raw.cx, raw.cy], [500.0, 510.0, 320.0, 240.0]);
    assert_eq!(raw.distortion, Distortion::PlumbBob([0.1, -0.2, 0.001, 0.002, 0.3]));
    let rectified = rectified_intrinsics(&camera()).unwrap();
    assert_eq!([rectified.fx, rectified.fy, rectified.cx, rectified.cy], [400.0, 410.0, 310.0, 230.0]);
    assert_eq!(rectified.distortion, Distortion::None);
}

#[test]
fn binning_and_region_shrink_and_shift() {
    let roi = m::RegionOfInterest { x_offset: 100, y_offset: 40, width: 320, height: 240, do_rectify: false };
    let part = intrinsics(&m::CameraInfo { roi, binning_x: 2, binning_y: 2, ..camera() }).unwrap();
    assert_eq!((part.width, part.height), (160, 120));
    assert_eq!([part.fx, part.fy, part.cx, part.cy], [250.0, 255.0, 110.0, 100.0]);
}

#[test]
fn models_of_distortion_are_known_by_name_and_number() {
    let with = |model: &'static str, d: &[f64]| {
        intrinsics(&m::CameraInfo { distortion_model: model, d: d.to_vec(), ..camera() }).map(|i| i.distortion)
    };
    assert_eq!(with("", &[0.0; 5]).unwrap(), Distortion::None);
    assert_eq!(with("plumb_bob", &[]).unwrap(), Distortion::None);
    assert_eq!(with("equidistant", &[0.1, 0.2, 0.3, 0.4]).unwrap(), Distortion::Fisheye([0.1, 0.2, 0.3, 0.4]));
    let eight = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
    assert_eq!(with("rational_polynomial", &eight).unwrap(), Distortion::Rational(eight));
    let mut twelve = [&eight[..], &[0.0; 4]].concat();
    assert_eq!(with("rational_polynomial", &twelve).unwrap(), Distortion::Rational(eight));
    twelve[11] = 0.1;
    assert!(with("rational_polynomial", &twelve).unwrap_err().to_string().contains("with 12 coefficients"));
    assert!(with("thin_prism", &[0.1]).unwrap_err().to_string().contains("expected plumb_bob"));
    let zero = m::CameraInfo { k: [0.0; 9], ..camera() };
    assert!(intrinsics(&zero).unwrap_err().to_string().contains("calibrate the camera"));
}

#[test]
fn inertial_samples_say_what_was_not_measured() {
    let mut message = m::Imu { linear_acceleration: m::Vector3 { x: 0.0, y: 0.0, z: 9.81 }, ..Default::default() };
    assert_eq!(imu(&message).unwrap().linear_acceleration, Vector3::new(0.0, 0.0, 9.81));
    message.angular_velocity.x = f64::NAN;
    assert!(imu(&message).unwrap_err().to_string().contains("angular_velocity"));
    message.angular_velocity_covariance[0] = -1.0;
    assert!(imu(&message).unwrap_err().to_string().contains("it was not measured"));
}

#[test]
fn poses_go_out_and_come_back() {
    let t_map_base = Pose::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, -0.2, 0.3));
    assert!((pose(&pose_message(&t_map_base)).unwrap().inverse() * t_map_base).translation.vector.norm() < 1e-12);
    assert!(se3::log(&(transform(&transform_message(&t_map_base)).unwrap().inverse() * t_map_base)).norm() < 1e-12);
    let mut message = m::Odometry::default();
    message.pose.pose = pose_message(&t_map_base);
    assert!(se3::log(&(odometry(&message).unwrap().t_odom_base.inverse() * t_map_base)).norm() < 1e-12);
    message.pose.pose.orientation = m::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
    assert!(odometry(&message).unwrap_err().to_string().contains("quaternion norm 0"));
    let poses = [Stamped { stamp: Timestamp(1_500_000_000), value: t_map_base }];
    let path = path_message(&poses, m::Header::new(Timestamp(9), "map"));
    assert_eq!(path.poses[0].header, m::Header::new(m::Time { sec: 1, nanosec: 500_000_000 }, "map"));
}

#[test]
fn stamps_keep_their_nanoseconds_before_1970_too() {
    for nanos in [0, 1, -1, 1_763_692_800_123_456_789, -1_500_000_000] {
        let time = m::Time::from(Timestamp(nanos));
        assert!(time.nanosec < 1_000_000_000);
        assert_eq!(Timestamp::from(time), Timestamp(nanos));
    }
    assert_eq!(m::Time::from(Timestamp(i64::MAX)).sec, i32::MAX);
}

#[test]
fn grids_go_out_and_come_back() {
    let geometry = GridGeometry::new(0.25, Point2::new(-1.0, 2.0));
    let cells = [0, 100, -1, 50, 7, 8];
    let message = grid_message(&geometry, 3, &cells, m::Header::new(Timestamp(1), "map")).unwrap();
    let read = grid(&message).unwrap();
    assert_eq!((read.geometry, read.width, read.height, &read.cells[..]), (geometry, 3, 2, &cells[..]));
    assert!(grid_message(&geometry, 4, &cells, m::Header::default()).is_err());
    assert!(grid_message(&geometry, 0, &cells, m::Header::default()).is_err());

    let mut turned = message.clone();
    turned.info.origin.orientation = m::Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 };
    assert!(grid(&turned).unwrap_err().to_string().contains("along its frame's axes"));
    let mut short = message.clone();
    short.info.width = u32::MAX;
    assert!(grid(&short).unwrap_err().to_string().contains("6 cells for 4294967295 x 2"));
    let mut flat = message;
    flat.info.resolution = 0.0;
    assert!(grid(&flat).unwrap_err().to_string().contains("info.resolution"));
}

#[test]
fn what_sensors_said_reads_back() {
    let header = m::Header::new(Timestamp(5), "sensor");
    let ours = LaserScan {
        angle_min_rad: -1.5,
        angle_increment_rad: 0.25,
        range_min_m: 0.125,
        range_max_m: 1e300,
        time_increment_s: 0.0,
        ranges_m: vec![1.0, f32::INFINITY],
        intensities: Some(vec![3.0, 4.0]),
        later_echoes_m: vec![],
    };
    let message = scan_message(&ours, header);
    assert_eq!(message.angle_max, -1.25);
    let limit = f64::from(f32::MAX);
    assert_eq!(scan(&message), Ok(LaserScan { range_max_m: limit, ..ours }));

    let base = CameraIntrinsics::pinhole(640, 480, 500.0, 510.0, 320.0, 240.0);
    let lenses = [
        Distortion::None,
        Distortion::PlumbBob([0.1, -0.2, 0.001, 0.002, 0.3]),
        Distortion::Rational([0.1, -0.2, 0.001, 0.002, 0.3, 0.4, 0.5, 0.6]),
        Distortion::Fisheye([0.1, -0.2, 0.001, 0.002]),
    ];
    for distortion in lenses {
        let camera = CameraIntrinsics { distortion, ..base };
        let message = camera_info_message(&camera, header).unwrap();
        assert_eq!(intrinsics(&message), Ok(camera));
        assert_eq!(rectified_intrinsics(&message), Ok(base));
    }

    let sample =
        ImuSample { angular_velocity: Vector3::new(0.1, 0.2, 0.3), linear_acceleration: Vector3::new(1.0, 2.0, 9.81) };
    assert_eq!(imu(&imu_message(&sample, header)), Ok(sample));
    let sample = OdometrySample { t_odom_base: se3::from_xy_yaw(1.0, 2.0, 0.5), covariance: None };
    let read = odometry(&odometry_message(&sample, header, "base_link")).unwrap();
    assert!((read.t_odom_base.inverse() * sample.t_odom_base).translation.vector.norm() < 1e-12);
}

#[test]
fn a_covariance_is_turned_into_the_axes_of_the_poses_frame() {
    let mut covariance = Covariance6::zeros();
    covariance[(0, 0)] = 4.0;
    covariance[(3, 3)] = 9.0;
    let t_map_base = se3::from_xy_yaw(1.0, 2.0, std::f64::consts::FRAC_PI_2);
    let about_map = pose_covariance(&t_map_base, &covariance);
    let diagonal: [f64; 6] = std::array::from_fn(|i| about_map[i * 7].round());
    assert_eq!(diagonal, [0.0, 4.0, 0.0, 0.0, 9.0, 0.0]);
    let message = |c| pose_with_covariance_message(&t_map_base, c, m::Header::default()).pose.covariance;
    assert_eq!((message(Some(&covariance)), message(None)), (about_map, [0.0; 36]));
}

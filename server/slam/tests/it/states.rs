use crate::room::{Noise, Room, drive};
use percept_geometry::{DepthImage, PointCloud, Pose, Timestamp, se3};
use percept_slam::{CloudScan, DepthScan, LostReason, Odometry, OdometryKind, OdometryParams, Scan, TrackingState};
use std::sync::Arc;

fn covered(scan: &Scan) -> Scan {
    let Scan::Depth(s) = scan else { panic!() };
    let depth = Arc::new(DepthImage::new(640, 480, vec![0.0; 640 * 480]).unwrap());
    Scan::Depth(DepthScan { depth, ..s.clone() })
}

#[test]
fn a_covered_camera_is_lost_with_growing_covariance_and_comes_back() {
    let (room, mut noise) = (Room::furnished(), Noise(6));
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let stamp = |i: usize| Timestamp::from_secs_f64(i as f64 / 15.0);
    let scan = room.depth(&drive(0, 200), &mut noise);
    for i in 0..5 {
        odometry.register(stamp(i), &room.depth(&drive(i, 200), &mut noise), None);
    }
    let mut last = 0.0;
    for i in 5..9 {
        let e = odometry.register(stamp(i), &covered(&scan), None);
        assert_eq!(e.state, TrackingState::Lost { reason: LostReason::TooFewPoints });
        assert!(e.covariance[(0, 0)] > last);
        last = e.covariance[(0, 0)];
    }
    let e = odometry.register(stamp(9), &room.depth(&drive(9, 200), &mut noise), None);
    assert!(e.state.is_tracking(), "{:?}", e.state);
    assert!(e.covariance[(0, 0)] < last);
    let truth = drive(0, 200).inverse() * drive(9, 200);
    assert!((truth.inverse() * e.t_odom_base).translation.vector.norm() < 0.015);
}

#[test]
fn another_place_is_lost_and_after_enough_frames_a_new_model_starts_and_says_so() {
    let (room, mut noise) = (Room::furnished(), Noise(7));
    let mut params = OdometryParams::default();
    params.tracking.restart_after_frames = 4;
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, params);
    odometry.register(Timestamp(0), &room.scan(&Pose::identity(), &mut noise), None);
    // Outdoors: nothing around but one far post a beam or so wide.
    let mut other = Room::furnished();
    other.walls = (nalgebra::Vector3::new(-9.0, -1.2, 0.0), nalgebra::Vector3::new(14.0, 12.0, 2.5));
    other.boxes.clear();
    let mut states = vec![];
    for i in 1..=6 {
        let scan = other.scan(&se3::from_xy_yaw(0.0, 0.0, 0.8), &mut noise);
        states.push(odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &scan, None).state);
    }
    assert!(states[..3].iter().all(|s| s.is_lost()), "{states:?}");
    assert_eq!(states[3], TrackingState::Initialising);
    assert!(states[4..].iter().all(|s| s.is_tracking()), "{states:?}");
}

#[test]
fn after_a_gap_a_room_that_shares_walls_with_the_old_one_is_not_taken_for_it() {
    let (room, mut noise) = (Room::furnished(), Noise(9));
    let mut other = Room::furnished();
    other.walls.1 += nalgebra::Vector3::new(2.0, 1.5, 0.0);
    other.boxes.truncate(1);
    let states = |later: &Room, noise: &mut Noise| {
        let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
        (0..5).for_each(|i| {
            odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &room.scan(&Pose::identity(), noise), None);
        });
        let at = |i: u32| (Timestamp::from_secs_f64(4.5 + 0.1 * f64::from(i)), later.scan(&Pose::identity(), noise));
        let frames: Vec<_> = (0..3).map(at).collect();
        frames.iter().map(|(stamp, scan)| odometry.register(*stamp, scan, None).state).collect::<Vec<_>>()
    };
    let lost = TrackingState::Lost { reason: LostReason::TimeGap };
    assert_eq!(states(&other, &mut noise), [lost, lost, TrackingState::Initialising]);
    // Not moved meanwhile.
    assert_eq!(states(&room, &mut noise), [TrackingState::Tracking; 3]);
}

#[test]
fn beams_without_a_return_do_not_move_a_planar_scan() {
    let (room, mut noise) = (Room::furnished(), Noise(10));
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    let mut still = vec![];
    for i in 0..6 {
        let mut scan = room.scan(&Pose::identity(), &mut noise);
        let Scan::Planar(planar) = &mut scan else { panic!() };
        let laser = Arc::make_mut(&mut planar.scan);
        laser.range_min_m = 0.0;
        // A sector each of what drivers send for nothing: the farthest range, more than it, infinity, NaN, zero.
        for (k, nothing) in [20.0, 81.9, f32::INFINITY, f32::NAN, 0.0].into_iter().enumerate() {
            laser.ranges_m[60 * k..60 * k + 40].fill(nothing);
        }
        let e = odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &scan, None);
        still.push((e.state.is_tracking(), e.inlier_ratio, e.t_odom_base.translation.vector.norm()));
    }
    assert!(still[1..].iter().all(|(tracks, share, off)| *tracks && *share > 0.95 && *off < 0.01), "{still:?}");
}

#[test]
fn odd_scans_are_lost_frames_and_do_no_harm() {
    let (room, mut noise) = (Room::furnished(), Noise(8));
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let still = nalgebra::Vector6::zeros();
    let cloud = |positions: Vec<nalgebra::Point3<f32>>| {
        Scan::Cloud(CloudScan {
            cloud: Arc::new(PointCloud::from_positions(positions)),
            t_base_sensor: Pose::identity(),
        })
    };
    odometry.register(Timestamp(0), &room.cloud(&Pose::identity(), 16, &still, &mut noise), None);
    let odd = [
        cloud(vec![]),
        cloud(vec![nalgebra::Point3::new(1.0, 1.0, 1.0)]),
        cloud(vec![nalgebra::Point3::new(1.0, 1.0, 1.0); 5000]),
        cloud(vec![nalgebra::Point3::new(f32::NAN, 1.0, f32::INFINITY); 5000]),
        room.scan(&Pose::identity(), &mut noise),
    ];
    for (i, scan) in odd.iter().enumerate() {
        let e = odometry.register(Timestamp::from_secs_f64(0.01 * (i + 1) as f64), scan, None);
        assert!(e.state.is_lost() && e.t_odom_base.translation.vector.iter().all(|x| x.is_finite()));
    }
    // A repeated and an earlier stamp are no harm either.
    for nanos in [50_000_000, 50_000_000, 40_000_000] {
        let e = odometry.register(Timestamp(nanos), &room.cloud(&Pose::identity(), 16, &still, &mut noise), None);
        assert!(e.state.is_tracking() && e.t_odom_base.translation.vector.norm() < 0.01);
    }
}

#[test]
fn odometry_goes_on_from_keyframes_after_a_restart() {
    let room = Room::furnished();
    for kind in [OdometryKind::Rgbd, OdometryKind::Lidar3d, OdometryKind::Lidar2d] {
        let mut noise = Noise(9);
        let mut see = |t: &Pose| match kind {
            OdometryKind::Rgbd => room.depth(t, &mut noise),
            OdometryKind::Lidar3d => room.cloud(t, 32, &nalgebra::Vector6::zeros(), &mut noise),
            OdometryKind::Lidar2d => room.scan(t, &mut noise),
            OdometryKind::Mono => panic!("a camera's keyframes hold no surfaces to begin with"),
        };
        let before = Odometry::new(kind, OdometryParams::default());
        let t_odom_map = se3::from_xy_yaw(5.0, -3.0, 0.5);
        let keyframes: Vec<_> = [0, 4, 8]
            .map(|i| {
                let scan = before.keyframe_scan(Timestamp(0), &"sensor".into(), &see(&drive(i, 100)));
                (t_odom_map * drive(i, 100), Arc::new(scan))
            })
            .to_vec();
        let mut odometry = Odometry::new(kind, OdometryParams::default());
        odometry.seed(&keyframes[2].0, &keyframes, Timestamp(0));
        let e = odometry.register(Timestamp::from_secs_f64(2.0), &see(&drive(9, 100)), None);
        assert!(e.state.is_tracking(), "{kind:?} {:?}", e.state);
        let off = (t_odom_map * drive(9, 100)).inverse() * e.t_odom_base;
        assert!(off.translation.vector.norm() < 0.03 && off.rotation.angle() < 0.02, "{kind:?} {off}");
    }
}

#[test]
fn defaults_are_valid_and_a_bad_parameter_is_named() {
    assert_eq!(OdometryParams::default().validate(), Ok(()));
    let mut params = OdometryParams::default();
    params.rgbd.max_depth_m = f64::NAN;
    assert_eq!(params.validate().unwrap_err().field, "rgbd.max_depth_m");
}

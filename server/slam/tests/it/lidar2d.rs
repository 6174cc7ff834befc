use crate::room::{Noise, Room, drive, drive_at};
use nalgebra::Vector3;
use percept_geometry::{Covariance6, KeyframeScan, Pose, Timestamp, se3, sensor::ImuSample};
use percept_slam::keyframe::{KeyframeParams, keyframe_scan};
use percept_slam::{
    ImuBuffer, LostReason, MotionPrior, Odometry, OdometryKind, OdometryParams, PlanarScan, Scan, TrackingState,
};
use std::sync::Arc;

#[test]
fn a_drive_through_the_room_is_followed_to_a_centimetre_without_wheels() {
    let (room, mut noise) = (Room::furnished(), Noise(4));
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    for i in 0..100 {
        let scan = room.scan(&drive(i, 100), &mut noise);
        let e = odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None);
        let off = se3::log(&((drive(0, 100).inverse() * drive(i, 100)).inverse() * e.t_odom_base));
        assert!(off.fixed_rows::<3>(0).norm() < 0.015 && off[5].abs() < 0.005, "frame {i}: {off}");
        assert_eq!(e.state.is_tracking(), i > 0);
        assert_eq!((e.t_odom_base.translation.z, off[3], off[4]), (0.0, 0.0, 0.0));
    }
}

/// A drive of 12 s, up to 0.75 m/s and 96 degrees a second and on top of that, from 3 s on, `wobble` (rad) to and fro 0.8 times a second, seen
/// by ten sweeps a second, with a gyro or without: the largest error of the pose (m, rad), and the mean distances from the
/// room's surfaces of the points that keyframes keep, and of the same as they came, metres.
fn swept(time_increment_s: f64, wobble: f64, has_gyro: bool) -> ((f64, f64), (f64, f64)) {
    let (room, mut noise) = (Room::furnished(), Noise(4));
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    // A gyro that has not shown to be right is not believed, so it begins smoothly.
    let turned = |seconds: f64| wobble * (5.0 * (seconds - 3.0).max(0.0)).sin();
    let at = |seconds: f64| drive_at(seconds / 12.0) * se3::from_xy_yaw(0.0, 0.0, turned(seconds));
    let mut imu = ImuBuffer::default();
    let (mut metres, mut radians) = (0f64, 0f64);
    let (mut kept_off, mut raw_off) = (0.0, 0.0);
    for i in 0..120 {
        let (second, t) = (0.1 * f64::from(i), at(0.1 * f64::from(i)));
        let scan = room.sweep(|after| at(second + after), time_increment_s, &mut noise);
        let (stamp, before) = (Timestamp::from_secs_f64(second), Timestamp::from_secs_f64(second - 0.1));
        let laser = "laser".into();
        // Samples have come until the sweep's end.
        for k in 0..if has_gyro { 20 } else { 0 } {
            let felt = second + 0.005 * f64::from(k + 1);
            let rate = se3::log(&at(felt - 0.001).inv_mul(&at(felt + 0.001))).fixed_rows::<3>(3) / 0.002;
            let sample = ImuSample { angular_velocity: rate, linear_acceleration: 9.81 * Vector3::z() };
            imu.push(Timestamp::from_secs_f64(felt), &sample, &Pose::identity());
        }
        let prior = imu.between(before, stamp);
        let last = *odometry.t_odom_base();
        let e = odometry.register_with_imu(stamp, &scan, prior.as_ref(), has_gyro.then_some(&imu));
        imu.learn(before, stamp, &(last.rotation.inverse() * e.t_odom_base.rotation), true);
        let off = se3::log(&((at(0.0).inverse() * t).inverse() * e.t_odom_base));
        (metres, radians) = (metres.max(off.fixed_rows::<3>(0).norm()), radians.max(off[5].abs()));
        let mean = |kept: &KeyframeScan| {
            let hits = &kept.hits.positions;
            hits.iter().map(|p| room.distance(&(t * p.cast::<f64>()))).sum::<f64>() / hits.len() as f64
        };
        kept_off += mean(&odometry.keyframe_scan(stamp, &laser, &scan)) / 120.0;
        let still = nalgebra::Vector6::zeros();
        raw_off += mean(&keyframe_scan(&KeyframeParams::default(), stamp, &laser, &scan, &still)) / 120.0;
    }
    ((metres, radians), (kept_off, raw_off))
}

#[test]
fn what_a_sweep_saw_on_the_move_is_kept_where_it_was() {
    let ((metres, radians), (kept, raw)) = swept(0.1 / 720.0, 0.0, false);
    assert!(raw > 0.02 && kept < 0.5 * raw, "{kept} of {raw}");
    // A sweep turns faster or slower than the step before it.
    assert!(metres < 0.03 && radians < 0.02, "{metres} {radians}");
    // A centimetre of noise.
    let ((metres, radians), (kept, raw)) = swept(0.0, 0.0, false);
    assert!(kept < 0.01 && kept == raw && metres < 0.015 && radians < 0.005, "{kept} {raw} {metres} {radians}");
}

#[test]
fn a_robot_that_turns_to_and_fro_keeps_what_it_saw_where_it_was_by_its_gyro() {
    // Up to 3 rad/s, and otherwise in each sweep than from the sweep before.
    let ((without, _), (kept_without, raw)) = swept(0.1 / 720.0, 0.6, false);
    let ((metres, radians), (kept, _)) = swept(0.1 / 720.0, 0.6, true);
    // A centimetre of noise.
    assert!(kept < 0.01 && raw > 0.05 && kept_without > 0.03, "{kept} {kept_without} of {raw}");
    assert!(metres < 0.04 && radians < 0.015 && without > 0.2, "{metres} {radians}, {without} without");
}

#[test]
fn in_a_corridor_the_wheels_say_how_far() {
    let (room, mut noise) = (Room::corridor(), Noise(5));
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    let step = se3::from_xy_yaw(0.1, 0.0, 0.0);
    let covariance = Covariance6::identity() * 1e-4;
    let mut t_world_base = Pose::identity();
    let mut last = None;
    for i in 0..40 {
        let scan = room.scan(&t_world_base, &mut noise);
        let prior = MotionPrior { t_prev_now: step * se3::from_xy_yaw(0.0, 0.0, 0.004), covariance };
        last = Some(odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, (i > 0).then_some(&prior)));
        t_world_base *= step;
    }
    let e = last.unwrap();
    assert!(e.state.is_tracking());
    assert_eq!(e.degenerate_axes, [true, false, false, false, false, false]);
    // The walls fix heading and side; 3.9 m along them come from the wheels.
    assert!((e.t_odom_base.translation.x - 3.9).abs() < 0.1, "{}", e.t_odom_base);
    assert!(e.t_odom_base.translation.y.abs() < 0.02 && se3::yaw(&e.t_odom_base).abs() < 0.005);
    assert!(e.covariance[(0, 0)] > 4.0 * e.covariance[(1, 1)]);
    // Whatever the wheels say of each step: what they are off by has one cause and adds up.
    assert!(e.covariance[(0, 0)].sqrt() > 0.1, "{}", e.covariance[(0, 0)].sqrt());
}

#[test]
fn in_a_corridor_without_wheels_the_robot_is_lost_before_it_is_far_off() {
    let (room, mut noise) = (Room::corridor(), Noise(5));
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    let mut t_world_base = Pose::identity();
    let mut states = vec![];
    for i in 0..90 {
        let scan = room.scan(&t_world_base, &mut noise);
        let e = odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None);
        let off = (t_world_base.inverse() * e.t_odom_base).translation.vector.norm();
        // What is said of the error grows with it.
        assert!(off < 2.0 * e.covariance[(0, 0)].sqrt() + 0.5, "frame {i}: {off}");
        // It tells which axis is open, when it is lost for that as well.
        let is_open = e.degenerate_axes == [true, false, false, false, false, false];
        assert!(is_open || e.state != TrackingState::Lost { reason: LostReason::Degenerate }, "frame {i}");
        states.push(e.state);
        t_world_base *= se3::from_xy_yaw(0.06, 0.0, 0.0);
    }
    let lost = states.iter().position(|s| s.is_lost()).unwrap();
    assert_eq!(states[lost], TrackingState::Lost { reason: LostReason::Degenerate });
    assert!((40..70).contains(&lost), "{lost}");
    // It stays so until the map begins anew.
    let after = states[lost..].iter().find(|s| !s.is_lost());
    assert!(after.is_none_or(|s| *s == TrackingState::Initialising), "{after:?}");
}

#[test]
fn a_turn_that_begins_at_once_is_followed() {
    let room = Room::furnished();
    let mut noise = Noise(21);
    let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
    let mut t_world_base = se3::from_xy_yaw(-0.5, 0.3, 0.0);
    let start = t_world_base;
    for i in 0..40 {
        // Straight at 0.3 m/s, then on the spot at 2.6 rad/s from one scan to the next, as small robots do.
        t_world_base *= if i < 20 { se3::from_xy_yaw(0.03, 0.0, 0.0) } else { se3::from_xy_yaw(0.0, 0.0, 0.26) };
        let scan = room.scan(&t_world_base, &mut noise);
        let estimate = odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &scan, None);
        let truth = se3::from_xy_yaw(0.03, 0.0, 0.0).inverse() * start.inverse() * t_world_base;
        let off = truth.inverse() * estimate.t_odom_base;
        assert!(i == 0 || estimate.state.is_tracking(), "frame {i}: {:?}", estimate.state);
        assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.03, "frame {i}: {off}");
    }
}

/// The scan as a small lidar has it: nothing beyond 4 m, and a noise of a hundredth of the range.
fn short_sighted(scan: Scan, noise: &mut Noise) -> Scan {
    let Scan::Planar(PlanarScan { scan, t_base_sensor }) = scan else { panic!("planar") };
    let mut scan = Arc::unwrap_or_clone(scan);
    scan.range_max_m = 4.0;
    for r in &mut scan.ranges_m {
        *r = if *r > 4.0 { f32::INFINITY } else { *r * (1.0 + 0.01 * noise.next() as f32) };
    }
    Scan::Planar(PlanarScan { scan: Arc::new(scan), t_base_sensor })
}

#[test]
fn legs_beside_a_wall_tell_a_lidar_that_sees_four_metres_how_far_it_drives() {
    let v = Vector3::new;
    // A wall on the right, tables on the left, and nothing else in sight.
    let legs = (0..60).map(|k| {
        let (x, y) = (-8.0 + 0.45 * f64::from(k), 1.0 + 0.8 * f64::from(k % 3));
        (v(x, y, 0.0), v(x + 0.05, y + 0.05, 0.8))
    });
    let room = Room { walls: (v(-500.0, -0.9, 0.0), v(500.0, 500.0, 2.5)), boxes: legs.collect() };
    for seed in 1..=4 {
        let mut noise = Noise(seed);
        let mut odometry = Odometry::new(OdometryKind::Lidar2d, OdometryParams::default());
        let (mut x, mut speed) = (0.0, 0.0);
        for i in 0..80 {
            let scan = short_sighted(room.scan(&se3::from_xy_yaw(x, 0.0, 0.0), &mut noise), &mut noise);
            let e = odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(i)), &scan, None);
            let off = e.t_odom_base.translation.x - x;
            assert!(i == 0 || e.state.is_tracking(), "seed {seed}, frame {i}: {:?}", e.state);
            assert!(off.abs() < 0.25, "seed {seed}, frame {i}: {off}");
            // Off at 2 m/s^2 after a second, as small robots do.
            speed = if i < 10 { 0.0 } else { f64::min(speed + 0.2, 1.3) };
            x += 0.1 * speed;
        }
    }
}

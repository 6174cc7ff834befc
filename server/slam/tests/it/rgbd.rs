use crate::room::{Noise, Room, drive};
use nalgebra::Vector6;
use percept_geometry::{CameraIntrinsics, Covariance6, DepthImage, Pose, RgbImage, Timestamp, se3};
use percept_slam::{
    DepthScan, LostReason, MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scan, TrackingState,
};
use std::sync::Arc;

fn run(threads: usize, frames: usize) -> Vec<OdometryEstimate> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let (room, mut noise) = (Room::furnished(), Noise(1));
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        (0..frames)
            .map(|i| {
                let scan = room.depth(&drive(i, 150), &mut noise);
                odometry.register(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None)
            })
            .collect()
    })
}

#[test]
fn a_drive_through_the_room_is_followed_to_a_centimetre() {
    let estimates = run(2, 75);
    for (i, e) in estimates.iter().enumerate() {
        let truth: Pose = drive(0, 150).inverse() * drive(i, 150);
        let off = se3::log(&(truth.inverse() * e.t_odom_base));
        assert!(off.fixed_rows::<3>(0).norm() < 0.015 && off.fixed_rows::<3>(3).norm() < 0.01, "frame {i}: {off}");
        assert_eq!(e.state.is_tracking(), i > 0);
        // The covariance is honest: the error is within four of its standard deviations.
        if i > 0 {
            for k in 0..6 {
                assert!(off[k].abs() < 4.0 * e.covariance[(k, k)].sqrt() + 1e-3, "frame {i} axis {k}: {}", off[k]);
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_not_one_bit() {
    assert_eq!(run(1, 6), run(3, 6));
}

#[test]
fn a_wall_alone_is_reported_open_along_itself_and_the_pose_stays() {
    let mut room = Room::furnished();
    room.boxes.clear();
    room.walls = (nalgebra::Vector3::new(-50.0, -50.0, -50.0), nalgebra::Vector3::new(1.5, 50.0, 50.0));
    let mut noise = Noise(2);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let mut last = None;
    for i in 0..10 {
        let scan = room.depth(&Pose::identity(), &mut noise);
        last = Some(odometry.register(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None));
    }
    let e = last.unwrap();
    assert!(e.state.is_tracking());
    // y, z of base and the roll about the line of sight.
    assert_eq!(e.degenerate_axes, [false, true, true, true, false, false]);
    assert!(e.t_odom_base.translation.vector.norm() < 0.005);
    assert!(e.covariance[(1, 1)] > 25.0 * e.covariance[(0, 0)]);
}

/// The same scan with an image of one grey.
fn painted(scan: Scan, grey: u8) -> Scan {
    let Scan::Depth(s) = scan else { return scan };
    let color = RgbImage::new(640, 480, vec![grey; 640 * 480 * 3]).unwrap();
    Scan::Depth(DepthScan { color: Some(Arc::new(color)), ..s })
}

#[test]
fn saturated_and_black_images_leave_depth_to_do_the_work() {
    let run = |grey: fn(usize) -> u8| {
        let (room, mut noise) = (Room::furnished(), Noise(4));
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        let see = |i| painted(room.depth(&drive(i, 150), &mut noise), grey(i));
        (0..8).map(see).enumerate().map(|(i, s)| odometry.register(stamp(i), &s, None)).collect::<Vec<_>>()
    };
    for e in run(|_| 255).iter().zip(run(|_| 0)).zip(run(|i| if i % 2 == 0 { 0 } else { 255 })).skip(1) {
        let ((white, black), flicker) = e;
        assert!(white.state.is_tracking());
        assert_eq!((white, &black), (&black, &flicker));
    }
}

#[test]
fn a_blank_wall_in_colour_is_open_along_itself_too() {
    let mut room = Room::furnished();
    room.boxes.clear();
    room.walls = (nalgebra::Vector3::new(-50.0, -50.0, -50.0), nalgebra::Vector3::new(1.5, 50.0, 50.0));
    let mut noise = Noise(2);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let scans: Vec<Scan> = (0..4).map(|_| painted(room.depth(&Pose::identity(), &mut noise), 120)).collect();
    let e = scans.iter().enumerate().map(|(i, s)| odometry.register(stamp(i), s, None)).last().unwrap();
    assert_eq!(e.degenerate_axes, [false, true, true, true, false, false]);
}

#[test]
fn intrinsics_that_do_not_fit_the_image_and_depth_of_nothing_are_lost() {
    let (room, mut noise) = (Room::furnished(), Noise(4));
    let Scan::Depth(good) = painted(room.depth(&Pose::identity(), &mut noise), 90) else { panic!() };
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    odometry.register(stamp(0), &Scan::Depth(good.clone()), None);
    let larger = CameraIntrinsics::pinhole(1280, 960, 1050.0, 1050.0, 640.0, 480.0);
    let nothing = Arc::new(DepthImage::new(640, 480, vec![0.0; 640 * 480]).unwrap());
    let bad = [DepthScan { intrinsics: larger, ..good.clone() }, DepthScan { depth: nothing, ..good.clone() }];
    for (i, scan) in bad.into_iter().enumerate() {
        let e = odometry.register(stamp(i + 1), &Scan::Depth(scan), None);
        assert_eq!(e.state, TrackingState::Lost { reason: LostReason::TooFewPoints });
    }
    assert!(odometry.register(stamp(3), &Scan::Depth(good), None).state.is_tracking());
}

fn stamp(i: usize) -> Timestamp {
    Timestamp::from_secs_f64(i as f64 / 15.0)
}

/// Ahead and turning, 1.5 cm and a degree a frame.
fn turning(i: usize) -> Pose {
    se3::from_xy_yaw(0.015 * i as f64, 0.0, 0.0175 * i as f64)
}

#[test]
fn colour_takes_no_pose_along_however_fine_its_texture() {
    for block_m in [0.02, 0.04, 0.08, 0.15, 0.3] {
        let (room, mut noise) = (Room::furnished(), Noise(10));
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        for i in 0..15 {
            let e = odometry.register(stamp(i), &room.painted(&turning(i), block_m, &mut noise), None);
            let (m, rad) = off(&e, &turning(i));
            assert!(m < 0.002 && rad < 0.003, "blocks of {block_m} m frame {i}: {m} m {rad} rad");
        }
    }
}

/// Somebody of half a metre's width at (x, y).
fn somebody(x: f64, y: f64) -> (nalgebra::Vector3<f64>, nalgebra::Vector3<f64>) {
    (nalgebra::Vector3::new(x, y, 0.0), nalgebra::Vector3::new(x + 0.3, y + 0.5, 1.8))
}

fn off(e: &OdometryEstimate, truth: &Pose) -> (f64, f64) {
    let off = truth.inverse() * e.t_odom_base;
    (off.translation.vector.norm(), off.rotation.angle())
}

#[test]
fn somebody_who_walks_past_does_not_take_the_pose_along() {
    for (from, speed) in [(-2.2, 0.8), (1.7, -1.2)] {
        let mut noise = Noise(5);
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        for i in 0..45 {
            let mut room = Room::furnished();
            room.boxes.push(somebody(0.9, from + speed * i as f64 / 15.0));
            let e = odometry.register(stamp(i), &room.depth(&drive(i, 450), &mut noise), None);
            let (m, rad) = off(&e, &(drive(0, 450).inverse() * drive(i, 450)));
            assert!(!e.state.is_tracking() || m < 0.02 && rad < 0.01, "frame {i}: {m} m {rad} rad {:?}", e.state);
            assert!(!e.state.is_lost(), "frame {i}: {:?}", e.state);
        }
    }
}

/// What wheels say of the way between two poses: two hundredths too long, a hundredth too much turned.
fn wheels(from: &Pose, to: &Pose) -> MotionPrior {
    let step = se3::log(&(from.inverse() * to));
    let wrong = Vector6::from_fn(|k, _| step[k] * if k < 3 { 1.02 } else { 1.01 });
    let sigma = |k: usize| 0.002 + 0.03 * step[k].abs();
    let covariance = Covariance6::from_diagonal(&Vector6::from_fn(|k, _| sigma(k) * sigma(k)));
    MotionPrior { t_prev_now: se3::exp(&wrong), covariance }
}

#[test]
fn somebody_who_walks_past_does_not_take_the_pose_from_wheels() {
    let mut noise = Noise(5);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    for i in 0..40 {
        let mut room = Room::furnished();
        room.boxes.push(somebody(0.9, -2.2 + 0.8 * i as f64 / 15.0));
        let prior = (i > 0).then(|| wheels(&drive(i - 1, 450), &drive(i, 450)));
        let e = odometry.register(stamp(i), &room.depth(&drive(i, 450), &mut noise), prior.as_ref());
        let (m, rad) = off(&e, &(drive(0, 450).inverse() * drive(i, 450)));
        assert!(!e.state.is_lost() && m < 0.02 && rad < 0.01, "frame {i}: {m} m {rad} rad {:?}", e.state);
    }
}

#[test]
fn what_was_put_down_becomes_part_of_the_room_and_may_go_again() {
    let (mut room, mut noise) = (Room::furnished(), Noise(6));
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let mut ratios = vec![];
    for i in 0..100 {
        match i {
            5 => room.boxes.push(somebody(0.6, -0.4)),
            90 => drop(room.boxes.pop()),
            _ => {}
        }
        let e = odometry.register(stamp(i), &room.depth(&Pose::identity(), &mut noise), None);
        assert_eq!(e.state.is_tracking(), i > 0, "frame {i}: {:?}", e.state);
        let (m, rad) = off(&e, &Pose::identity());
        assert!(m < 0.01 && rad < 0.005, "frame {i}: {m} m {rad} rad");
        ratios.push(e.inlier_ratio);
    }
    assert!(ratios[88] > 0.95 * ratios[4], "{} {}", ratios[4], ratios[88]);
}

#[test]
fn a_pose_called_good_is_right_however_fast_the_camera_turns() {
    let room = Room::furnished();
    for rate in [1.0, 2.5, 5.0, 7.0] {
        let mut noise = Noise(7);
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        let at = |i: usize| {
            // From rest, a third of a second to full speed.
            let t = i as f64 / 15.0;
            se3::from_xy_yaw(0.0, 0.0, rate * (t - 0.33f64.min(t) + 0.5 * t.min(0.33).powi(2) / 0.33))
        };
        let mut lost = false;
        for i in 0..24 {
            let e = odometry.register(stamp(i), &room.depth(&at(i), &mut noise), None);
            lost |= e.state.is_lost();
            let (m, rad) = off(&e, &at(i));
            assert!(!e.state.is_tracking() || m < 0.05 && rad < 0.03, "{rate} rad/s frame {i}: {m} m {rad} rad");
        }
        assert!(rate > 1.5 || !lost, "{rate} rad/s");
    }
}

/// Depth is missing in a band of rows that rolls through the image, and in every other block.
fn with_holes(scan: Scan, i: usize) -> Scan {
    let Scan::Depth(s) = scan else { return scan };
    let mut data = s.depth.data().to_vec();
    for (k, z) in data.iter_mut().enumerate() {
        let (u, v) = (k % 640, k / 640);
        if (v + 480 - 37 * i % 480) % 480 < 160 || (u / 60 + v / 60 + i).is_multiple_of(3) {
            *z = 0.0;
        }
    }
    Scan::Depth(DepthScan { depth: Arc::new(DepthImage::new(640, 480, data).unwrap()), ..s })
}

#[test]
fn holes_that_roll_through_the_depth_do_not_shift_the_pose() {
    let (room, mut noise) = (Room::furnished(), Noise(8));
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    for i in 0..40 {
        let scan = with_holes(room.depth(&drive(i, 150), &mut noise), i);
        let e = odometry.register(stamp(i), &scan, None);
        let (m, rad) = off(&e, &(drive(0, 150).inverse() * drive(i, 150)));
        assert_eq!(e.state.is_tracking(), i > 0, "frame {i}: {:?}", e.state);
        assert!(m < 0.03 && rad < 0.015, "frame {i}: {m} m {rad} rad");
    }
}

#[test]
fn along_a_blank_wall_no_motion_that_nothing_shows_is_called_measured() {
    let mut room = Room::furnished();
    room.boxes.clear();
    room.walls = (nalgebra::Vector3::new(-50.0, -50.0, -50.0), nalgebra::Vector3::new(1.5, 50.0, 50.0));
    let mut noise = Noise(9);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    for i in 0..15 {
        // Sideways by 3 cm a frame: no depth image can tell.
        let t = se3::from_xy_yaw(0.0, 0.03 * i as f64, 0.0);
        let e = odometry.register(stamp(i), &room.depth(&t, &mut noise), None);
        let open = e.degenerate_axes[1] && e.covariance[(1, 1)].sqrt() > 0.01;
        assert!(i == 0 || e.state.is_lost() || open, "frame {i}: {:?} {:?}", e.state, e.degenerate_axes);
    }
}

/// By a portrait camera of few pixels: at this range their noise turns normals by some degrees, which is no shape.
#[test]
fn a_turn_before_a_far_wall_is_not_taken_for_a_move_along_it() {
    let mut room = Room::furnished();
    room.boxes.clear();
    room.walls = (nalgebra::Vector3::new(-50.0, -50.0, 0.0), nalgebra::Vector3::new(3.5, 50.0, 50.0));
    let camera = CameraIntrinsics::pinhole(240, 320, 230.0, 230.0, 119.5, 159.5);
    let mut noise = Noise(3);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    for i in 0..12 {
        let t = se3::from_xy_yaw(0.0, 0.0, 0.02 * i as f64);
        let e = odometry.register(stamp(i), &room.depth_by(camera, &t, &mut noise), None);
        let (m, rad) = off(&e, &t);
        assert!(i == 0 || e.degenerate_axes[1], "frame {i}: {:?}", e.degenerate_axes);
        assert!(m < 0.05 && rad < 0.01, "frame {i}: {m} m {rad} rad");
    }
}

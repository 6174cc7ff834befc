use crate::room::{Noise, Room, drive};
use percept_geometry::{CameraIntrinsics, DepthImage, Pose, RgbImage, Timestamp, se3};
use percept_slam::{
    DepthScan, LostReason, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scan, TrackingState,
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

//! Places found again by a depth camera with colour, in the simulator's worlds.

use percept_geometry::{
    CameraIntrinsics, Covariance6, FeatureMethod, KeyframeId, KeyframeScan, Pose, SensorData, Timestamp, se3,
};
use percept_sim::{DepthCameraParams, SensorSuite, SimParams, Simulation};
use percept_slam::loops::{KeyframePoses, PlaceRecognition, place_recognition};
use percept_slam::{
    BackEndParams, DepthScan, KeyframeParams, LostReason, MotionPrior, Odometry, OdometryKind, OdometryParams, Scan,
    TrackingState, keyframe,
};
use std::sync::Arc;

/// Every `1 / rate_hz` seconds what a keyframe would keep, with the truth.
fn drive(world: u64, noise: u64, rate_hz: f64, seconds: f64) -> Vec<(Pose, Arc<KeyframeScan>)> {
    scans(world, noise, rate_hz, seconds).into_iter().map(|(t, scan)| (t, keep(&scan))).collect()
}

fn scans(world: u64, noise: u64, rate_hz: f64, seconds: f64) -> Vec<(Pose, Scan)> {
    seen_by(DepthCameraParams { rate_hz, ..DepthCameraParams::default() }, world, noise, seconds)
}

fn seen_by(camera: DepthCameraParams, world: u64, noise: u64, seconds: f64) -> Vec<(Pose, Scan)> {
    let (intrinsics, t_base_sensor) = (camera.intrinsics, camera.t_base_sensor());
    let mut params = SimParams { seed: noise, duration_s: Some(seconds), ..SimParams::default() };
    (params.world.seed, params.world.person) = (world, false);
    params.sensors =
        SensorSuite { depth_camera: Some(camera), lidar3d: None, lidar2d: None, odometry: None, imu: None };
    let frames = Simulation::new(params).unwrap().frames();
    frames
        .filter_map(|f| {
            let SensorData::Rgbd(depth, color) = f.frame.data else { return None };
            let (depth, color) = (Arc::new(depth), Some(Arc::new(color)));
            Some((f.t_world_base, Scan::Depth(DepthScan { depth, color, intrinsics, t_base_sensor })))
        })
        .collect()
}

fn keep(scan: &Scan) -> Arc<KeyframeScan> {
    keep_with(FeatureMethod::Orb, scan)
}

fn keep_with(features: FeatureMethod, scan: &Scan) -> Arc<KeyframeScan> {
    let params = KeyframeParams { features, ..KeyframeParams::default() };
    Arc::new(keyframe::keyframe_scan(&params, Timestamp(0), &"camera".into(), scan, &nalgebra::Vector6::zeros()))
}

fn taken_in(keyframes: &[(Pose, Arc<KeyframeScan>)]) -> (Box<dyn PlaceRecognition>, KeyframePoses) {
    let mut places =
        place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
            .unwrap();
    let mut poses = KeyframePoses::new();
    for (k, (t, scan)) in keyframes.iter().enumerate() {
        poses.insert(KeyframeId(k as u64), *t);
        places.insert(KeyframeId(k as u64), &scan.into(), &Covariance6::identity(), &poses);
    }
    (places, poses)
}

#[test]
fn after_a_kidnap_the_camera_finds_itself_without_a_guess_and_never_in_a_wrong_place() {
    let keyframes = drive(2, 1, 1.0, 12.0);
    let (mut places, poses) = taken_in(&keyframes);
    // The same rooms with other noise, between the keyframes.
    let mut found = 0;
    let asked = drive(2, 7, 0.8, 11.0);
    for (truth, scan) in &asked {
        if let Some(r) = places.relocalise(scan, &poses) {
            let off = truth.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
            assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.02, "{off}");
            found += 1;
        }
    }
    assert!(2 * found >= asked.len(), "{found} of {}", asked.len());
    // What was forgotten is not found.
    poses.keys().for_each(|&id| places.forget(id));
    assert!(asked.iter().all(|(_, scan)| places.relocalise(scan, &poses).is_none()));
}

/// Views with where base was.
type Views = Vec<(Pose, Arc<KeyframeScan>)>;

/// What a lost robot saw: the first views as the way, with base then seen from base at the last one.
fn way(views: &[(Pose, Arc<KeyframeScan>)]) -> (Views, Pose, Arc<KeyframeScan>) {
    let (now, scan) = views.last().unwrap();
    let before = views[..views.len() - 1].iter().map(|(then, s)| (now.inv_mul(then), Arc::clone(s))).collect();
    (before, *now, Arc::clone(scan))
}

#[test]
fn a_lost_camera_is_placed_by_one_view_that_shows_much_or_by_several_that_agree() {
    let (mut places, poses) = taken_in(&drive(2, 1, 1.0, 12.0));
    let asked = drive(2, 7, 0.8, 11.0);
    let (mut alone, mut found) = (0, 0);
    for views in asked.windows(4) {
        let (before, truth, scan) = way(views);
        for (before, count) in [(&[][..], &mut alone), (&before[..], &mut found)] {
            if let Some(r) = places.relocalise_driven(before, &scan, &poses) {
                let off = truth.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
                assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.02, "{off}");
                *count += 1;
            }
        }
    }
    assert!(alone >= 1 && found >= 2, "{alone} {found}");
}

#[test]
fn a_way_that_does_not_fit_where_a_view_does_places_nothing() {
    let (mut places, poses) = taken_in(&drive(2, 1, 1.0, 12.0));
    for views in drive(2, 7, 0.8, 11.0).windows(4) {
        let (before, _, scan) = way(views);
        // The same views, but turned by half a right angle more on the way than was driven.
        let turn = se3::from_xy_yaw(0.0, 0.0, 0.8);
        let elsewhere: Vec<_> = before.into_iter().map(|(t, s)| (turn * t, s)).collect();
        assert_eq!(places.relocalise_driven(&elsewhere, &scan, &poses), None);
    }
}

#[test]
fn of_two_rooms_that_are_alike_neither_is_claimed() {
    let keyframes = drive(2, 1, 1.0, 8.0);
    let twin = se3::from_xy_yaw(30.0, 5.0, 1.0);
    let again: Vec<_> = drive(2, 3, 1.0, 8.0).into_iter().map(|(t, s)| (twin * t, s)).collect();
    let (mut places, poses) = taken_in(&[keyframes, again].concat());
    for views in drive(2, 7, 0.8, 8.0).windows(4) {
        let (before, _, scan) = way(views);
        assert_eq!(places.relocalise_driven(&before, &scan, &poses), None);
    }
}

#[test]
fn another_house_is_not_taken_for_this_one() {
    let (mut places, poses) = taken_in(&drive(2, 1, 1.0, 8.0));
    for (_, scan) in [5, 11, 12, 13].into_iter().flat_map(|house| drive(house, 1, 1.0, 8.0)) {
        assert_eq!(places.relocalise(&scan, &poses), None);
        assert_eq!(places.relocalise_driven(&[], &scan, &poses), None);
    }
}

#[test]
fn coming_back_closes_a_loop_where_it_is() {
    // There, and the same way again with other noise; between them more keyframes than count as recent.
    let (there, away, again) = (drive(2, 1, 1.0, 4.0), drive(5, 1, 2.0, 5.0), drive(2, 9, 1.0, 4.0));
    let (mut places, mut poses) = taken_in(&[there.clone(), away].concat());
    let mut found = 0;
    for (truth, scan) in &again {
        let id = KeyframeId(poses.len() as u64);
        poses.insert(id, *truth);
        for l in places.insert(id, &scan.into(), &Covariance6::identity(), &poses) {
            let off = se3::log(&((poses[&l.from].inverse() * truth).inverse() * l.t_from_to));
            assert!(off.norm() < 0.05 && l.from.0 < there.len() as u64, "{l:?}");
            found += 1;
        }
    }
    assert!(found >= 2, "{found}");
}

#[test]
fn a_way_back_is_recognised_by_sift_and_not_by_features_of_another_method() {
    let views = |noise| scans(2, noise, 1.0, 4.0);
    let keep = |views: &[(Pose, Scan)], method| -> Views {
        views.iter().map(|(t, scan)| (*t, keep_with(method, scan))).collect()
    };
    let there = keep(&views(1), FeatureMethod::Sift);
    assert!(there.iter().all(|(_, s)| s.features.as_ref().is_some_and(|f| f.method == FeatureMethod::Sift)));
    // Between there and back more keyframes than count as recent; what they show does not matter.
    let (mut places, poses) = taken_in(&there);
    let again = views(9);
    let mut found = 0;
    for (k, (truth, scan)) in (20u64..).zip(&again) {
        let scan = keep_with(FeatureMethod::Sift, scan);
        for l in places.insert(KeyframeId(k), &scan.into(), &Covariance6::identity(), &poses) {
            let off = se3::log(&((poses[&l.from].inverse() * truth).inverse() * l.t_from_to));
            assert!(off.norm() < 0.05, "{l:?}");
            found += 1;
        }
    }
    assert!(found >= 2, "{found}");
    for (_, scan) in keep(&again, FeatureMethod::Orb) {
        assert_eq!(places.relocalise(&scan, &poses), None);
    }
}

/// Once a second for eight, what a keyframe of a camera with a field of view as usual, in so many pixels, would keep.
fn drive_with(width: usize, height: usize, world: u64, noise: u64) -> Views {
    let f = 525.0 * width as f64 / 640.0;
    let centre = (0.5 * width as f64 - 0.5, 0.5 * height as f64 - 0.5);
    let intrinsics = CameraIntrinsics::pinhole(width, height, f, f, centre.0, centre.1);
    let camera = DepthCameraParams { rate_hz: 1.0, intrinsics, ..DepthCameraParams::default() };
    seen_by(camera, world, noise, 8.0).into_iter().map(|(t, scan)| (t, keep(&scan))).collect()
}

#[test]
fn small_images_are_recognised_as_large_ones_are() {
    for (width, height) in [(240, 180), (320, 240), (424, 240)] {
        let (mut places, poses) = taken_in(&drive_with(width, height, 2, 1));
        let asked = drive_with(width, height, 2, 7);
        let mut found = 0;
        for views in asked.windows(4) {
            let (before, truth, scan) = way(views);
            let Some(r) = places.relocalise_driven(&before, &scan, &poses) else { continue };
            let off = truth.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
            assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.02, "{off}");
            found += 1;
        }
        assert!(found >= 2, "{width}: {found}");
        let elsewhere = drive_with(width, height, 5, 7);
        for views in elsewhere.windows(4) {
            let (before, _, scan) = way(views);
            assert_eq!(places.relocalise(&scan, &poses), None);
            assert_eq!(places.relocalise_driven(&before, &scan, &poses), None);
        }
    }
}

#[test]
fn a_way_back_closes_loops_with_small_images() {
    let there = drive_with(240, 180, 2, 1);
    let (mut places, poses) = taken_in(&there);
    let mut found = 0;
    // Between there and back more keyframes than count as recent; what they show does not matter.
    for (k, (truth, scan)) in (20u64..).zip(&drive_with(240, 180, 2, 9)) {
        for l in places.insert(KeyframeId(k), &scan.into(), &Covariance6::identity(), &poses) {
            let off = se3::log(&((poses[&l.from].inverse() * truth).inverse() * l.t_from_to));
            assert!(off.norm() < 0.05, "{l:?}");
            found += 1;
        }
    }
    assert!(found >= 4, "{found}");
}

/// Depth alone of a small camera, every second.
fn bare_drive(world: u64, noise: u64, seconds: f64) -> Views {
    let intrinsics = CameraIntrinsics::pinhole(160, 120, 131.0, 131.0, 79.5, 59.5);
    let camera = DepthCameraParams { rate_hz: 1.0, intrinsics, ..DepthCameraParams::default() };
    let bare = |scan: Scan| match scan {
        Scan::Depth(s) => Scan::Depth(DepthScan { color: None, ..s }),
        other => other,
    };
    seen_by(camera, world, noise, seconds).into_iter().map(|(t, scan)| (t, keep(&bare(scan)))).collect()
}

#[test]
fn depth_without_colour_is_found_by_what_it_saw_on_its_way_and_not_in_another_house() {
    let (mut places, poses) = taken_in(&bare_drive(2, 1, 45.0));
    let (mut found, asked) = (0, bare_drive(2, 7, 34.0));
    for views in asked.windows(12).step_by(6) {
        let (before, truth, scan) = way(views);
        assert_eq!(places.relocalise(&scan, &poses), None);
        if let Some(r) = places.relocalise_driven(&before, &scan, &poses) {
            let off = truth.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
            assert!(off.translation.vector.norm() < 0.15 && off.rotation.angle() < 0.03, "{off}");
            found += 1;
        }
    }
    assert!(found >= 2, "{found}");
    for views in bare_drive(5, 7, 20.0).windows(12).step_by(6) {
        let (before, _, scan) = way(views);
        assert_eq!(places.relocalise_driven(&before, &scan, &poses), None);
    }
}

#[test]
fn odometry_of_small_images_goes_on_from_keyframes_after_a_restart() {
    let intrinsics = CameraIntrinsics::pinhole(240, 180, 197.0, 197.0, 119.5, 89.5);
    let camera = DepthCameraParams { rate_hz: 2.0, intrinsics, ..DepthCameraParams::default() };
    let views = seen_by(camera, 2, 1, 2.0);
    let t_odom_world = se3::from_xy_yaw(5.0, -3.0, 0.5);
    let keyframes: Vec<_> = views[..2].iter().map(|(t, scan)| (t_odom_world * t, keep(scan))).collect();
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    odometry.seed(&keyframes[1].0, &keyframes, Timestamp(0));
    let (truth, scan) = &views[2];
    let e = odometry.register(Timestamp::from_secs_f64(0.5), scan, None);
    let off = (t_odom_world * truth).inverse() * e.t_odom_base;
    assert!(e.state.is_tracking(), "{:?}", e.state);
    assert!(off.translation.vector.norm() < 0.03 && off.rotation.angle() < 0.02, "{off}");
}

#[test]
fn without_colour_or_depth_there_is_nothing_to_recognise_and_nothing_breaks() {
    let mut keyframes = drive(2, 1, 1.0, 3.0);
    for (_, scan) in &mut keyframes {
        *scan = Arc::new(KeyframeScan { features: None, ..(**scan).clone() });
    }
    let (places, poses) = taken_in(&keyframes);
    assert_eq!(places.relocalise(&keyframes[0].1, &poses), None);
}

#[test]
fn features_know_their_points_and_there_are_at_most_five_hundred() {
    let (_, scan) = scans(2, 1, 1.0, 1.0).remove(0);
    let kept = keep(&scan);
    let features = kept.features.as_ref().unwrap();
    assert!(features.features.len() > 50 && features.features.len() <= 500, "{}", features.features.len());
    let Scan::Depth(depth) = &scan else { panic!() };
    let mut known = 0;
    for f in features.features.iter().filter(|f| f.p_base.x.is_finite()) {
        let p = kept.t_base_sensor.inverse() * f.p_base.cast::<f64>();
        let pixel = depth.intrinsics.project(&p).unwrap();
        // Within the three cells that are looked at.
        assert!((pixel - f.pixel.cast::<f64>()).amax() < 5.0);
        known += 1;
    }
    assert!(2 * known > features.features.len());
}

#[test]
fn after_five_seconds_of_blackout_odometry_says_lost_and_the_place_is_found_again() {
    let before = scans(2, 1, 2.0, 3.0);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let stamp = |k: usize| Timestamp::from_secs_f64(k as f64 * 0.1);
    let first = &before[0].1;
    odometry.register(stamp(0), first, None);
    let Scan::Depth(s) = first else { panic!() };
    let blank = percept_geometry::DepthImage::new(640, 480, vec![0.0; 640 * 480]).unwrap();
    let dark = percept_geometry::RgbImage::new(640, 480, vec![0; 640 * 480 * 3]).unwrap();
    let black = Scan::Depth(DepthScan { depth: Arc::new(blank), color: Some(Arc::new(dark)), ..s.clone() });
    for k in 1..=50 {
        assert!(odometry.register(stamp(k), &black, None).state.is_lost(), "{k}");
    }
    // Nothing but a guess ties what comes next to what was before: it is not called measured unless it is right.
    let e = odometry.register(stamp(51), &before[5].1, None);
    let off = (before[0].0.inverse() * before[5].0).inverse() * e.t_odom_base;
    assert!(!e.state.is_tracking() || off.translation.vector.norm() < 0.03, "{:?} {off}", e.state);
    assert_eq!(keep(&black).features.as_ref().map(|f| f.features.len()), Some(0));
    let kept: Vec<_> = before.iter().map(|(t, scan)| (*t, keep(scan))).collect();
    let (places, poses) = taken_in(&kept);
    assert_eq!(places.relocalise(&keep(&black), &poses), None);
    let r = places.relocalise(&kept[3].1, &poses).unwrap();
    let off = before[3].0.inverse() * poses[&r.keyframe] * r.t_keyframe_base;
    assert!(off.translation.vector.norm() < 0.03, "{off}");
}

#[test]
fn after_a_silence_the_same_shape_with_another_look_is_another_place() {
    let (here, there) = (scans(2, 1, 10.0, 0.8), scans(5, 1, 1.0, 0.5));
    let (Some((_, Scan::Depth(last))), Some((_, Scan::Depth(other)))) = (here.last(), there.first()) else { panic!() };
    // Wheels say that the robot stood still meanwhile.
    let stay = MotionPrior { t_prev_now: Pose::identity(), covariance: Covariance6::identity() * 1e-4 };
    let after = |color: &DepthScan| {
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        let stamp = |s: f64| Timestamp::from_secs_f64(s);
        for (k, (_, scan)) in here.iter().enumerate() {
            odometry.register(stamp(0.1 * k as f64), scan, None);
        }
        let seen = Scan::Depth(DepthScan { color: color.color.clone(), ..last.clone() });
        odometry.register(stamp(5.0), &seen, Some(&stay)).state
    };
    assert_eq!(after(last), TrackingState::Tracking);
    assert_eq!(after(other), TrackingState::Lost { reason: LostReason::TimeGap });
}

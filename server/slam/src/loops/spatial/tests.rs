use super::*;
use crate::keyframe::{KeyframeParams, keyframe_scan};
use crate::{CloudScan, Scan};
use nalgebra::{Point3, UnitQuaternion, Vector3, Vector6};
use percept_geometry::{PointCloud, Timestamp, se3};
use percept_perception::registration::GlobalSearch;

/// A street of boxes that no other place resembles: the same numbers give the same street.
fn street(seed: u32) -> Vec<Point3<f32>> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1u32 << 24)
    };
    let mut points = Vec::new();
    for _ in 0..40 {
        let (x, y, yaw) = (80.0 * next() - 40.0, 80.0 * next() - 40.0, 6.0 * next());
        let (w, d, h) = (1.0 + 7.0 * next(), 1.0 + 5.0 * next(), 1.0 + 6.0 * next());
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
        for _ in 0..1600 {
            let (s, z) = (4.0 * next(), h * next());
            let f = s.fract() - 0.5;
            let side = [(f * w, 0.5 * d), (f * w, -0.5 * d), (0.5 * w, f * d), (-0.5 * w, f * d)][s as usize % 4];
            points.push((turn * Point3::new(side.0, side.1, z) + Vector3::new(x, y, 0.0)).cast());
        }
    }
    for _ in 0..16_000 {
        points.push(Point3::new(90.0 * next() - 45.0, 90.0 * next() - 45.0, 0.02 * next()).cast());
    }
    points
}

fn seen_from(points: &[Point3<f32>], t_world_base: &Pose) -> Arc<KeyframeScan> {
    let t = t_world_base.inverse();
    let near: Vec<_> = points.iter().map(|p| t * p.cast::<f64>()).filter(|p| p.coords.norm() < 35.0).collect();
    // A lidar 1.5 m above the floor does not see what is behind something else.
    let direction = |p: &Point3<f64>| {
        let (up, turn) = ((p.z - 1.5).atan2(p.xy().coords.norm()), p.y.atan2(p.x));
        ((up * 58.0).floor() as i32, (turn * 58.0).floor() as i32)
    };
    let mut nearest = std::collections::BTreeMap::new();
    for p in &near {
        let known = nearest.entry(direction(p)).or_insert(f64::MAX);
        *known = p.coords.norm().min(*known);
    }
    let hits = near.iter().filter(|p| p.coords.norm() < nearest[&direction(p)] + 1.0).map(|p| p.cast());
    let cloud = Arc::new(PointCloud::from_positions(hits.collect()));
    let scan = Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() });
    Arc::new(keyframe_scan(&KeyframeParams::default(), Timestamp(0), &"lidar".into(), &scan, &Vector6::zeros()))
}

#[test]
fn a_scan_is_placed_with_no_guess_and_another_street_is_not() {
    let (here, elsewhere) = (street(1), street(2));
    let mut recognition = SpatialRecognition::new(400);
    let mut poses = KeyframePoses::new();
    for (i, x) in [0.0, 1.0, 12.0, 24.0].into_iter().enumerate() {
        let (id, t) = (KeyframeId(i as u64), se3::from_xy_yaw(x, 0.0, 0.0));
        poses.insert(id, t);
        recognition.insert(id, &seen_from(&here, &t).into(), &Covariance6::zeros(), &poses);
    }
    let truth = se3::from_xy_yaw(4.0, 3.0, 2.0);
    let found = recognition.relocalise(&seen_from(&here, &truth), &poses).unwrap();
    let off = (poses[&found.keyframe] * found.t_keyframe_base).inverse() * truth;
    assert!(off.translation.vector.norm() < 0.1 && off.rotation.angle() < 0.01, "{off}");
    assert_eq!(recognition.relocalise(&seen_from(&elsewhere, &truth), &poses), None);
}

#[test]
fn coming_back_closes_a_loop_and_the_neighbourhood_does_not() {
    let world = street(3);
    let mut recognition = SpatialRecognition::new(400);
    let mut poses = KeyframePoses::new();
    let mut found = vec![];
    // Out and back on a circle of 120 m; odometry has drifted by 2 m at its end.
    let at = |i: u64| {
        let a = std::f64::consts::TAU * i as f64 / 24.0;
        se3::from_xy_yaw(19.0 * a.sin(), 19.0 - 19.0 * a.cos(), a)
    };
    for i in 0..32 {
        let drifted = Pose::translation(2.0 * i as f64 / 24.0, 0.0, 0.0) * at(i);
        poses.insert(KeyframeId(i), drifted);
        let drift = diagonal(0.5, 0.02);
        found.extend(recognition.insert(KeyframeId(i), &seen_from(&world, &at(i)).into(), &drift, &poses));
    }
    assert!(!found.is_empty());
    for l in found {
        assert!(l.to.0 - l.from.0 >= 6, "{} {}", l.from.0, l.to.0);
        let off = l.t_from_to.inverse() * (at(l.from.0).inverse() * at(l.to.0));
        assert!(off.translation.vector.norm() < 0.6 && off.rotation.angle() < 0.03, "{} {} {off}", l.from.0, l.to.0);
    }
}

#[test]
fn nothing_is_measured_in_what_merging_left_of_a_visit() {
    let world = street(3);
    let loops_with = |merged: &[u64]| {
        let mut recognition = SpatialRecognition::new(400);
        let mut poses = KeyframePoses::new();
        for i in 0..25 {
            let a = std::f64::consts::TAU * i as f64 / 24.0;
            let at = se3::from_xy_yaw(19.0 * a.sin(), 19.0 - 19.0 * a.cos(), a);
            poses.insert(KeyframeId(i), at);
            if i == 24 {
                merged.iter().for_each(|id| recognition.forget(KeyframeId(*id)));
            }
            recognition.take(KeyframeId(i), &seen_from(&world, &at).into(), None, &poses);
        }
        recognition.near(KeyframeId(24), &diagonal(0.1, 0.01), &poses)
    };
    assert!(loops_with(&[]).is_some());
    assert!(loops_with(&[3]).is_some());
    assert_eq!(loops_with(&[1, 3, 4, 5, 6, 7, 8]), None);
}

#[test]
fn a_robot_is_found_by_what_it_sees_and_what_it_saw_on_the_way_and_nowhere_in_a_street_not_seen_before() {
    let (here, elsewhere) = (street(5), street(6));
    let mut recognition = SpatialRecognition::new(400);
    let mut poses = KeyframePoses::new();
    for i in 0..16 {
        let (id, t) = (KeyframeId(i), se3::from_xy_yaw(2.0 * i as f64 - 15.0, 0.0, 0.1 * i as f64));
        poses.insert(id, t);
        recognition.insert(id, &seen_from(&here, &t).into(), &Covariance6::zeros(), &poses);
    }
    let drive = |k: usize| se3::from_xy_yaw(2.0 - 1.5 * k as f64, 1.0, 2.0);
    let mut find = |world: &[Point3<f32>], last: usize| {
        let seen = |k: usize| (drive(last).inverse() * drive(k), seen_from(world, &drive(k)));
        let before: Vec<_> = (0..last).map(seen).collect();
        recognition.relocalise_driven(&before, &seen_from(world, &drive(last)), &poses)
    };
    for last in 0..8 {
        let found = find(&here, last).unwrap();
        let off = (poses[&found.keyframe] * found.t_keyframe_base).inverse() * drive(last);
        assert!(off.translation.vector.norm() < 0.15 && off.rotation.angle() < 0.02, "{last}: {off}");
        assert_eq!(find(&elsewhere, last), None);
    }
}

/// A map that was given, or made by another lidar, shows less far than this one sees: most of its points are beyond.
#[test]
fn a_lidar_that_sees_farther_than_the_map_shows_is_found_in_it() {
    let (here, elsewhere) = (street(5), street(6));
    let mut recognition = SpatialRecognition::new(400);
    let mut poses = KeyframePoses::new();
    for i in 0..16 {
        let (id, t) = (KeyframeId(i), se3::from_xy_yaw(2.0 * i as f64 - 15.0, 0.0, 0.1 * i as f64));
        let mut scan = KeyframeScan::clone(&seen_from(&here, &t));
        scan.hits.positions.retain(|p| p.coords.norm() < 20.0);
        poses.insert(id, t);
        recognition.insert(id, &Arc::new(scan).into(), &Covariance6::zeros(), &poses);
    }
    let t = se3::from_xy_yaw(2.0, 1.0, 2.0);
    let found = recognition.relocalise_driven(&[], &seen_from(&here, &t), &poses).unwrap();
    let off = (poses[&found.keyframe] * found.t_keyframe_base).inverse() * t;
    assert!(off.translation.vector.norm() < 0.15 && off.rotation.angle() < 0.02, "{off}");
    assert_eq!(recognition.relocalise_driven(&[], &seen_from(&elsewhere, &t), &poses), None);
}

#[test]
fn surfaces_registered_step_by_step_lie_as_the_world_has_it() {
    let world = street(7);
    let seen = |number: u64, x: f64, yaw: f64, drifted: Pose| {
        let truth: Vec<Pose> = (0..5).map(|i| se3::from_xy_yaw(x + f64::from(i), 2.0, yaw)).collect();
        let view = |(i, t): (usize, &Pose)| (KeyframeId(number + i as u64), seen_from(&world, t), drifted * t);
        (truth[2], Views { t_map_anchor: drifted * truth[2], keyframes: truth.iter().enumerate().map(view).collect() })
    };
    let (truth_from, from) = seen(0, -4.0, 0.3, Pose::identity());
    // Odometry has drifted by more than what is searched from above: surfaces need no guess.
    let (truth_to, to) = seen(10, 0.0, 1.2, se3::from_xy_yaw(9.0, -5.0, 0.4));
    let mut registering = Registering::new(from, to);
    let found = (0..=GlobalSearch::MAX_STEPS).find_map(|_| match registering.step() {
        Step::GoesOn => None,
        Step::Done(found) => Some(found),
    });
    let off = found.unwrap().unwrap().inverse() * truth_from.inverse() * truth_to;
    assert!(off.translation.vector.norm() < 0.1 && off.rotation.angle() < 0.01, "{off}");
}

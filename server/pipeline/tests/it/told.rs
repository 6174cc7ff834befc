//! Somebody says where a robot is: it was carried off, was not found, or is seen where people stand in the way.

use crate::plan::{Plan, drive, frames, pipeline, tour};
use crate::twins::views_of_tour;
use percept_geometry::{Pose, SensorData, SensorFrame, Timestamp, se3};
use percept_pipeline::{Pipeline, PoseEstimate, Told};

/// One that has mapped all four rooms, and base to world where its map begins.
fn mapped(plan: &Plan) -> (Pipeline, Pose) {
    let way = tour(&[0, 1, 2, 3]);
    let mut pipeline = pipeline();
    frames(plan, &way).for_each(|f| drop(pipeline.process(&f).unwrap()));
    pipeline.settle();
    let (x, y, yaw) = way[0];
    (pipeline, se3::from_xy_yaw(x, y, yaw))
}

/// What it sees so many seconds after the start, from a place in the world.
fn seen(plan: &Plan, at: (f64, f64, f64), seconds: f64) -> SensorFrame {
    let mut frame = frames(plan, &[at]).next().unwrap();
    frame.stamp = Timestamp::from_secs_f64(seconds);
    frame
}

fn off(pose: &PoseEstimate, t_world_map: &Pose, (x, y, _): (f64, f64, f64)) -> f64 {
    let at = (t_world_map * pose.t_map_base).translation.vector;
    (at.x - x).hypot(at.y - y)
}

#[test]
fn a_robot_that_was_carried_off_goes_on_where_it_is_told_to_be() {
    for off_m in [(0.4, -0.3), (0.9, 0.0), (0.0, -0.9)] {
        carried_off_and_told(off_m);
    }
}

/// Told so far beside where it is, metres.
fn carried_off_and_told(off_m: (f64, f64)) {
    let plan = Plan::of_rooms(false);
    let (mut pipeline, t_world_map) = mapped(&plan);
    let keyframes = pipeline.snapshot().keyframes.len();
    // Into the third room, which looks like the first.
    let way = drive(&[(15.0, 3.0), (14.7, 4.5), (15.0, 3.0), (15.0, 1.0), (9.0, 1.0), (9.0, 3.0)]);
    let mut before = pipeline.snapshot().pose.unwrap();
    for (i, at) in way.iter().enumerate() {
        if i == 0 {
            // Pointed out by hand.
            let t_world_told = se3::from_xy_yaw(at.0 + off_m.0, at.1 + off_m.1, at.2 + 0.2);
            pipeline.tell_pose(Some(t_world_map.inverse() * t_world_told));
        }
        let report = pipeline.process(&seen(&plan, *at, 1000.0 + 0.1 * i as f64)).unwrap();
        let pose = report.pose.unwrap();
        assert_eq!(report.told, (i == 0).then_some(Told::Placed), "{i}");
        assert!(pose.state.is_tracking() && off(&pose, &t_world_map, *at) < 0.1, "{i}: {pose:?}");
        assert_eq!(pose.is_relocalised, i == 0, "{i}");
        assert!(pose.covariance[(0, 0)].hypot(pose.covariance[(1, 1)]).sqrt() < 0.2, "{i}: {}", pose.covariance);
        if i == 0 {
            assert!(pose.is_tentative, "another view has to agree");
        } else {
            let step = (pose.t_odom_base.translation.vector - before.t_odom_base.translation.vector).norm();
            assert!(step < 0.15, "{i}: odom jumps by {step} m");
        }
        before = pose;
    }
    let now = pipeline.snapshot();
    assert!(!now.pose.unwrap().is_tentative, "it is certain once other rooms agree");
    // Revisited: the map does not grow by the way, and nothing is drawn twice.
    assert!(now.keyframes.len() < keyframes + 60, "{} after {keyframes}", now.keyframes.len());
}

#[test]
fn a_word_that_what_is_seen_contradicts_changes_nothing() {
    let plan = Plan::of_rooms(false);
    let (mut pipeline, t_world_map) = mapped(&plan);
    let at = (1.0, 1.0, std::f64::consts::PI);
    for (k, wrong) in
        [(2.5, 0.0, 0.0), (0.0, 0.0, 1.57), (0.0, 0.0, 3.1), (8.0, 3.0, 0.3), (20.0, 5.0, 1.0)].into_iter().enumerate()
    {
        let (dx, dy, turn) = wrong;
        pipeline.tell_pose(Some(t_world_map.inverse() * se3::from_xy_yaw(at.0 + dx, at.1 + dy, at.2 + turn)));
        let report = pipeline.process(&seen(&plan, at, 1000.0 + 0.1 * k as f64)).unwrap();
        let pose = report.pose.unwrap();
        assert_eq!(report.told, Some(Told::Refuted), "{wrong:?}");
        assert!(pose.state.is_tracking() && !pose.is_tentative && !pose.is_relocalised);
        assert!(off(&pose, &t_world_map, at) < 0.1, "{wrong:?}: {pose:?}");
    }
}

#[test]
fn a_word_is_believed_where_nobody_has_mapped_and_without_a_map_there_is_nowhere_to_be() {
    let plan = Plan::of_rooms(false);
    let (mut pipeline, _) = mapped(&plan);
    let far = se3::from_xy_yaw(100.0, 50.0, 1.0);
    pipeline.tell_pose(Some(far));
    let report = pipeline.process(&seen(&plan, (1.0, 1.0, 0.0), 1000.0)).unwrap();
    let pose = report.pose.unwrap();
    assert_eq!(report.told, Some(Told::Believed));
    assert!((pose.t_map_base.translation.vector - far.translation.vector).norm() < 1e-9 && pose.is_tentative);
    assert!(pose.covariance[(0, 0)].sqrt() > 0.3, "no more sure than who pointed");

    // On through the building, nine tenths of it elsewhere than told: nothing agrees, and nothing is drawn.
    let keyframes = pipeline.snapshot().keyframes.len();
    for (i, at) in drive(&[(1.0, 1.0), (23.0, 1.0), (1.0, 1.0)]).iter().enumerate() {
        pipeline.process(&seen(&plan, *at, 1000.1 + 0.1 * i as f64)).unwrap();
        let pose = pipeline.snapshot().pose.unwrap();
        assert!(pose.is_tentative || pose.state.is_lost(), "{i}: certain, where nobody has been");
    }
    assert_eq!(pipeline.snapshot().keyframes.len(), keyframes);

    let mut empty = crate::plan::pipeline();
    empty.tell_pose(Some(far));
    let report = empty.process(&seen(&plan, (1.0, 1.0, 0.0), 1.0)).unwrap();
    assert_eq!(report.told, Some(Told::NoMap));
    assert!(report.pose.unwrap().t_map_base.translation.vector.norm() < 1e-9);
}

#[test]
fn a_start_is_believed_though_somebody_stands_in_the_way_or_a_door_was_shut() {
    let open = Plan::of_rooms(false);
    let (views, t_world_map) = views_of_tour(&[0, 1, 2, 3], &open);
    let way = drive(&[(9.0, 3.0), (8.7, 4.5), (9.0, 3.0), (9.3, 4.5), (9.0, 3.0)]);
    let mut with_person = open.clone();
    with_person.thing(9.3, 2.75, 9.75, 3.25);
    let mut with_shut_door = open.clone();
    with_shut_door.wall(8.5, 2.0, 9.5, 2.0);
    for (name, plan) in [("somebody", with_person), ("a door", with_shut_door)] {
        let mut pipeline = pipeline();
        let (x, y, yaw) = way[0];
        let told = t_world_map.inverse() * se3::from_xy_yaw(x + 0.2, y - 0.1, yaw + 0.05);
        pipeline.take_given(views.clone(), Some(told)).unwrap();
        for (i, at) in way.iter().enumerate() {
            // Who stood there has gone after five seconds.
            let plan = if name == "somebody" && i > 50 { &open } else { &plan };
            let scan = SensorData::Scan(plan.scan(*at, i));
            let frame = SensorFrame { data: scan, ..seen(plan, *at, 1.0 + 0.1 * i as f64) };
            let pose = pipeline.process(&frame).unwrap().pose.unwrap();
            let off = off(&pose, &t_world_map, *at);
            assert!(pose.state.is_tracking() && off < 0.1, "{name}, {i}: {off} m off, {:?}", pose.state);
        }
    }
}

//! A robot that is carried off: the map must not take in what it sees elsewhere, and it is found when it comes back.

use crate::drive::{empty, feed, planar, simulation};
use percept_geometry::{SensorFrame, Timestamp};
use percept_pipeline::{PipelineParams, TrajectoryEntry};
use percept_sim::{MainSensor, Scenario, SensorSuite, SimParams, Simulation, WorldParams};
use percept_slam::{LostReason, TrackingState};

/// The frames with their stamps moved by `nanos`.
fn later(frames: &[SensorFrame], nanos: i64) -> impl Iterator<Item = SensorFrame> + '_ {
    frames.iter().map(move |f| SensorFrame { stamp: Timestamp::from_nanos(f.stamp.nanos() + nanos), ..f.clone() })
}

/// Another building: six narrow rooms.
fn elsewhere() -> Vec<SensorFrame> {
    let world = WorldParams { seed: 77, rooms: 6, person: false, ..WorldParams::default() };
    let params = SimParams {
        world,
        sensors: SensorSuite::only_lidar2d(),
        duration_s: Some(12.0),
        seed: 9,
        ..SimParams::default()
    };
    Simulation::new(params).unwrap().frames().map(|f| f.frame).collect()
}

#[test]
fn a_robot_carried_off_is_lost_and_leaves_the_map_alone_until_it_is_back() {
    let home = simulation(SensorSuite::only_lidar2d(), 28.0);
    let frames: Vec<_> = home.frames().map(|f| f.frame).collect();
    let (first, rest) = frames.split_at(frames.len() / 2);
    let mut pipeline = empty(&home, PipelineParams::default());
    feed(&mut pipeline, first.iter().cloned());
    let before = pipeline.snapshot();
    let left = first.last().unwrap().stamp.nanos();

    let away = elsewhere();
    let gap = left + 2_000_000_000 - away[0].stamp.nanos();
    feed(&mut pipeline, later(&away, gap));
    let lost = pipeline.snapshot();
    assert_eq!(lost.pose.as_ref().unwrap().state, TrackingState::Lost { reason: LostReason::Adrift });
    assert_eq!(lost.keyframes.len(), before.keyframes.len());
    assert_eq!(lost.layers.occupancy, before.layers.occupancy);

    let back = away.last().unwrap().stamp.nanos() + gap + 1_000_000_000;
    let (by, mut mended) = (back - rest[0].stamp.nanos(), vec![]);
    for frame in later(rest, by) {
        mended.extend(pipeline.process(&frame).unwrap().mended);
    }
    pipeline.settle();
    let snapshot = pipeline.snapshot();
    // What it saw before it was found again is known since, and what it saw elsewhere is not.
    assert!(mended.len() > 10, "{}", mended.len());
    let of_home = snapshot.trajectory().filter(|(_, e)| e.stamp.nanos() >= back);
    let known = of_home.filter(|(_, e)| e.tracked).collect::<Vec<_>>();
    // But for the three seconds until odometry began anew.
    assert!(known.len() + 30 >= rest.len(), "{} of {}", known.len(), rest.len());
    for (t_map_base, entry) in &known {
        let truth = home.t_world_start().inverse() * home.pose_at(Timestamp::from_nanos(entry.stamp.nanos() - by));
        let off = (truth.translation.vector - t_map_base.translation.vector).norm();
        assert!(off < 0.15, "{}: {off}", entry.stamp);
    }
    let stored = |e: &TrajectoryEntry| known.iter().any(|(_, k)| *k == e);
    assert!(mended.iter().all(stored), "what is stored is what is shown");
    let of_elsewhere = snapshot.trajectory().filter(|(_, e)| (left + 1..back).contains(&e.stamp.nanos()));
    assert!(of_elsewhere.filter(|(_, e)| e.tracked).count() == 0);
    let found = snapshot.pose.unwrap();
    assert_eq!(found.state, TrackingState::Tracking);
    let truth = home.t_world_start().inverse() * home.pose_at(rest.last().unwrap().stamp);
    let off = (truth.translation.vector - found.t_map_base.translation.vector).norm();
    assert!(off < 0.08, "{off}");
}

#[test]
fn wheels_carry_the_map_through_a_blackout() {
    let simulation = planar(24.0);
    let frames: Vec<_> = simulation.frames().map(|f| f.frame).collect();
    let (start, end) = (frames[0].stamp.nanos() + 8_000_000_000, frames[0].stamp.nanos() + 14_000_000_000);
    let dark = |f: &SensorFrame| {
        (start..end).contains(&f.stamp.nanos()) && matches!(f.data, percept_geometry::SensorData::Scan(_))
    };
    let mut pipeline = empty(&simulation, PipelineParams::default());
    // The lidar is covered: it sends scans without a return.
    let covered = frames.iter().map(|f| if dark(f) { without_returns(f) } else { f.clone() });
    feed(&mut pipeline, covered);
    let snapshot = pipeline.snapshot();
    let pose = snapshot.pose.unwrap();
    assert_eq!(pose.state, TrackingState::Tracking);
    assert!(snapshot.keyframes.last().unwrap().stamp.nanos() > end);
    let truth = simulation.t_world_start().inverse() * simulation.pose_at(pose.stamp);
    let off = (truth.translation.vector - pose.t_map_base.translation.vector).norm();
    assert!(off < 0.25, "{off}");
}

#[test]
fn a_robot_that_is_adrift_in_the_dark_is_told_of_the_dark() {
    let home = simulation(SensorSuite::only_lidar2d(), 14.0);
    let frames: Vec<_> = home.frames().map(|f| f.frame).collect();
    let mut pipeline = empty(&home, PipelineParams::default());
    feed(&mut pipeline, frames.iter().cloned());
    let away = elsewhere();
    let gap = frames.last().unwrap().stamp.nanos() + 2_000_000_000 - away[0].stamp.nanos();
    let (lit, dark) = away.split_at(away.len() / 2);
    let state = |pipeline: &percept_pipeline::Pipeline| pipeline.snapshot().pose.unwrap().state;
    feed(&mut pipeline, later(lit, gap));
    assert_eq!(state(&pipeline), TrackingState::Lost { reason: LostReason::Adrift });
    feed(&mut pipeline, later(dark, gap).map(|f| without_returns(&f)));
    assert_eq!(state(&pipeline), TrackingState::Lost { reason: LostReason::TooFewPoints });
}

fn without_returns(frame: &SensorFrame) -> SensorFrame {
    let mut frame = frame.clone();
    if let percept_geometry::SensorData::Scan(scan) = &mut frame.data {
        scan.ranges_m.iter_mut().for_each(|r| *r = f32::INFINITY);
    }
    frame
}

#[test]
fn a_kidnapped_robot_is_found_in_the_other_room_and_never_said_to_be_where_it_is_not() {
    let params = Scenario::Kidnap { trials: 1 }.params(MainSensor::Lidar2d, 2, 0.0, 2).unwrap();
    let simulation = Simulation::new(params).unwrap();
    let kidnap = &simulation.params().disturbances.kidnaps[0];
    let put_down_s = kidnap.at_s + kidnap.carried_s;
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let t_map_world = simulation.t_world_start().inverse();
    let mut found_s = None;
    for sim in simulation.frames() {
        let report = pipeline.process(&sim.frame).unwrap();
        let Some(pose) = report.pose.filter(|_| report.trajectory.is_some_and(|t| t.tracked)) else { continue };
        let off = (t_map_world * sim.t_world_base).inverse() * pose.t_map_base;
        assert!(off.translation.vector.norm() < 0.1, "{:.1} s: {off}", sim.measured_s);
        if sim.measured_s > put_down_s {
            found_s.get_or_insert(sim.measured_s - put_down_s);
        }
    }
    assert!(found_s.is_some_and(|s| s < 15.0), "{found_s:?}");
    let believed = |l: &&percept_pipeline::Loop| l.state == percept_pipeline::LoopState::Active;
    assert!(pipeline.snapshot().loops.iter().filter(believed).count() > 5);
}

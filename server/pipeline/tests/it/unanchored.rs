//! A robot that is carried off: the map must not take in what it sees elsewhere, and it is found when it comes back.

use crate::drive::{empty, feed, planar, simulation};
use percept_geometry::{KeyframeId, Pose, SensorFrame, Timestamp};
use percept_mapping::Occupancy as _;
use percept_pipeline::{
    FrameReport, Loop, LoopId, Pipeline, PipelineParams, Restored, RestoredContent, RestoredKeyframe, TrajectoryEntry,
};
use percept_sim::{MainSensor, Scenario, SensorSuite, SimParams, Simulation, WorldParams};
use percept_slam::{LostReason, TrackingState};
use std::collections::BTreeMap;

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
    // Nor does how long it was away say how sure its place is now.
    let sigma = snapshot.pose.as_ref().unwrap().covariance.diagonal().map(f64::sqrt);
    assert!(sigma.x < 0.3 && sigma.y < 0.3, "{sigma}");
    // What it saw before it was found again is known since, and what it saw elsewhere is not.
    assert!(!mended.is_empty());
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
fn an_unanchored_robot_in_the_dark_is_told_of_the_dark() {
    let home = simulation(SensorSuite::only_lidar2d(), 14.0);
    let frames: Vec<_> = home.frames().map(|f| f.frame).collect();
    let mut pipeline = empty(&home, PipelineParams::default());
    feed(&mut pipeline, frames.iter().cloned());
    let away = elsewhere();
    let gap = frames.last().unwrap().stamp.nanos() + 2_000_000_000 - away[0].stamp.nanos();
    let (lit, dark) = away.split_at(away.len() / 2);
    let state = |pipeline: &Pipeline| pipeline.snapshot().pose.unwrap().state;
    feed(&mut pipeline, later(lit, gap));
    assert_eq!(state(&pipeline), TrackingState::Lost { reason: LostReason::Adrift });
    feed(&mut pipeline, later(dark, gap).map(|f| without_returns(&f)));
    assert_eq!(state(&pipeline), TrackingState::Lost { reason: LostReason::TooFewPoints });
}

/// A frame of a lidar that is covered.
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
    let believed = |l: &&Loop| l.state == percept_pipeline::LoopState::Active;
    assert!(pipeline.snapshot().loops.iter().filter(believed).count() > 5);
}

/// What a store knows of a session: what reports said, in their order.
#[derive(Default)]
struct Book {
    keyframes: Vec<RestoredKeyframe>,
    trajectory: Vec<TrajectoryEntry>,
    loops: BTreeMap<LoopId, Loop>,
    next_loop_id: u64,
}

impl Book {
    fn write(&mut self, report: FrameReport) {
        for k in report.joined.into_iter().chain(report.keyframe) {
            assert_eq!(k.info.id.0 as usize, self.keyframes.len());
            let content = RestoredContent::Scan(k.scan);
            let (t_map_base, t_odom_base, after_gap) = (k.info.t_map_base, k.t_odom_base, k.after_gap);
            self.keyframes.push(RestoredKeyframe { t_map_base, t_odom_base, after_gap, content });
        }
        for l in report.map.loops {
            self.next_loop_id = self.next_loop_id.max(l.id.0 + 1);
            self.loops.insert(l.id, l);
        }
        report.map.corrected.iter().for_each(|(id, t)| self.keyframes[id.0 as usize].t_map_base = *t);
        for (info, merged) in report.map.merged {
            let k = &mut self.keyframes[info.id.0 as usize];
            k.t_map_base = info.t_map_base;
            k.content = RestoredContent::Merged { stamp: info.stamp, sensor: info.sensor, merged };
        }
        self.loops.retain(|id, _| !report.map.dissolved.contains(id));
        assert!(report.mended.is_sorted_by_key(|e| e.stamp));
        for entry in report.mended {
            let i = self.trajectory.partition_point(|e| e.stamp < entry.stamp);
            assert_eq!(self.trajectory[i].stamp, entry.stamp);
            self.trajectory[i] = entry;
        }
        self.trajectory.extend(report.trajectory);
    }

    /// The session as it goes on from this.
    fn restored(&self, simulation: &Simulation) -> Pipeline {
        let mut pipeline = empty(simulation, PipelineParams::default());
        pipeline.restore(Restored {
            keyframes: self.keyframes.clone(),
            trajectory: self.trajectory.clone(),
            loops: self.loops.values().cloned().collect(),
            next_loop_id: self.next_loop_id,
            ..Restored::default()
        });
        pipeline
    }
}

/// What there is to see of a map: keyframes in it, the trajectory and which of it is in the map, loops, known cells.
type Seen = (Vec<(KeyframeId, Pose)>, Vec<(Pose, bool)>, Vec<Loop>, usize);

fn seen(pipeline: &Pipeline) -> Seen {
    let snapshot = pipeline.snapshot();
    let alive = snapshot.keyframes.iter().filter(|k| k.merged.is_none());
    (
        alive.map(|k| (k.id, k.t_map_base)).collect(),
        snapshot.trajectory().map(|(t, e)| (t, e.tracked)).collect(),
        snapshot.loops.to_vec(),
        snapshot.layers.occupancy.num_known(),
    )
}

#[test]
fn where_a_session_is_lost_early_the_larger_part_is_the_map_and_the_smaller_joins_later() {
    let mut params = Scenario::Loops.params(MainSensor::Lidar2d, 2, 150.0, 6).unwrap();
    params.sensors = SensorSuite::only_lidar2d();
    let simulation = Simulation::new(params).unwrap();
    let (mut pipeline, mut book) = (empty(&simulation, PipelineParams::default()), Book::default());
    // The lidar is covered until the robot is in the other room, a corner of which looks as one of the first does.
    const LIGHT_S: f64 = 44.0;
    let (mut covered, mut total, mut placed_s, mut took_over) = (0usize, 0usize, None, false);
    for sim in simulation.frames() {
        let is_dark = (8.0..LIGHT_S).contains(&sim.measured_s);
        (covered, total) = (covered + usize::from(is_dark), total + 1);
        let frame = if is_dark { without_returns(&sim.frame) } else { sim.frame };
        let report = pipeline.process(&frame).unwrap();
        if sim.measured_s > LIGHT_S && report.trajectory.is_some_and(|t| t.tracked) {
            placed_s.get_or_insert(sim.measured_s);
        }
        let is_forgotten = report.mended.iter().any(|e| !e.tracked);
        book.write(report);
        if is_forgotten {
            took_over = true;
            book.write(FrameReport { map: pipeline.finish_revision(), ..FrameReport::default() });
            assert!(seen(&pipeline).1[..70].iter().all(|(_, tracked)| !tracked));
            assert_eq!(seen(&book.restored(&simulation)), seen(&pipeline));
        }
    }
    // It does not wait until it comes back to the first room.
    assert!(took_over && placed_s.is_some_and(|s| s < 75.0), "{placed_s:?}");
    book.write(FrameReport { map: pipeline.settle(), ..FrameReport::default() });
    let after = seen(&pipeline);
    assert_eq!(seen(&book.restored(&simulation)), after);
    let num_tracked = after.1.iter().filter(|(_, tracked)| *tracked).count();
    assert!(num_tracked as f64 > 0.98 * (total - covered) as f64, "{num_tracked} of {total}");
    let snapshot = pipeline.snapshot();
    let tracked: Vec<_> = snapshot.trajectory().filter(|(_, e)| e.tracked).collect();
    let (last, end) = tracked.last().unwrap();
    let t_map_world = last * simulation.pose_at(end.stamp).inverse();
    let off = |(t, e): &(Pose, &TrajectoryEntry)| {
        let truth = t_map_world * simulation.pose_at(e.stamp);
        (truth.translation.vector - t.translation.vector).norm()
    };
    let worst = tracked.iter().map(off).fold(0.0, f64::max);
    assert!(worst < 0.15, "{worst}");
}

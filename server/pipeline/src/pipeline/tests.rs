//! The map that is shown is whole at every frame, whatever was corrected.

use super::*;
use crate::MapChange;
use crate::map_graph::Decision;
use percept_geometry::{Cell, Correction, KeyframeId, se3};
use percept_mapping::{Occupancy, OccupancyGrid};
use percept_sim::{SensorSuite, SimParams, Simulation};
use percept_slam::MergedKeyframe;
use std::collections::BTreeMap;

/// A pipeline in the middle of a drive, and the rest of the drive.
fn driven() -> (Pipeline, Vec<SensorFrame>) {
    let sensors = SensorSuite::only_lidar2d();
    let simulation =
        Simulation::new(SimParams { sensors, duration_s: Some(80.0), ..SimParams::default() }).expect("valid");
    let mut params = PipelineParams::default();
    // Corrections come from the test, none from loops.
    params.slam.back_end.enabled = false;
    let mut pipeline = Pipeline::new(params).expect("valid");
    simulation.sensors().into_iter().for_each(|spec| pipeline.declare_sensor(spec));
    let mut frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let rest = frames.split_off(frames.len() * 3 / 4);
    frames.iter().for_each(|f| drop(pipeline.process(f).expect("accepted")));
    (pipeline, rest)
}

fn decide(pipeline: &mut Pipeline, decision: Decision) -> MapChange {
    pipeline.revise(None, |graph, update| graph.decide(decision, update))
}

fn newest_keyframe(pipeline: &Pipeline) -> &KeyframeInfo {
    pipeline.map_graph.keyframes().last().expect("driven")
}

/// Walls that are shown in their cell or beside while submaps are bent as much as here, and once they are built anew, percent:
/// where a bend puts one keyframe's wall into what another saw free, a submap's sum may decide otherwise than each in turn.
const BENT: usize = 85;
const BUILT: usize = 98;

/// Panics unless keyframes, submaps, layers and pose belong together.
fn check_whole(pipeline: &Pipeline, percent: usize) {
    let shown = pipeline.snapshot();
    let living: Vec<_> = shown.living_keyframes().map(|k| (k.id, k.t_map_base)).collect();
    let of_map: Vec<_> = pipeline.map_graph.map().keyframes().iter().map(|(id, k)| (*id, k.t_map_base)).collect();
    assert_eq!(living, of_map);
    let mut grid = OccupancyGrid::new(pipeline.params.map.occupancy).expect("valid");
    for (id, t_map_base) in living {
        grid.integrate(&t_map_base, &pipeline.map_graph.map().scan(id).expect("kept")).expect("sound");
    }
    let occupied = |grid: &dyn Fn(Cell) -> Option<f64>, c: Cell| grid(c).is_some_and(|p| p >= 0.6);
    let (min, max) = grid.bounds().expect("driven");
    let of_grid = |c| grid.probability(c);
    let of_map = |c| shown.layers.occupancy.probability(c);
    let cells = (min.y..=max.y).flat_map(|y| (min.x..=max.x).map(move |x| Cell::new(x, y)));
    let walls: Vec<Cell> = cells.filter(|c| occupied(&of_grid, *c)).collect();
    // Cells of submaps that lie askew are read within a cell of where they are.
    let beside = |c: &Cell| {
        (-1..=1)
            .flat_map(|y| (-1..=1).map(move |x| (x, y)))
            .any(|(x, y)| occupied(&of_map, Cell::new(c.x + x, c.y + y)))
    };
    let there = walls.iter().filter(|c| beside(c)).count();
    assert!(there * 100 >= walls.len() * percent, "{there} of {}", walls.len());
    let pose = shown.pose.expect("driven");
    assert_eq!((pose.map_version, shown.map_version), (shown.layers.version, shown.layers.version));
    let off = se3::log(&(pose.t_map_base.inverse() * pipeline.map_graph.t_map_odom() * pose.t_odom_base)).norm();
    let newest = newest_keyframe(pipeline);
    let seam = newest.t_map_base.inverse() * pipeline.map_graph.t_map_odom() * newest.t_odom_base;
    let seam = se3::log(&seam).norm();
    assert!(off < 1e-9 && seam < 1e-9, "{off} {seam}");
}

/// All keyframes bent along the way by so much each.
fn bent(pipeline: &Pipeline, yaw: f64) -> Correction {
    let bend = |(k, info): (usize, &KeyframeInfo)| {
        (info.id, info.t_map_base * se3::from_xy_yaw(0.001 * k as f64, 0.0, yaw * k as f64))
    };
    Correction { t_map_base: pipeline.map_graph.keyframes().iter().enumerate().map(bend).collect() }
}

/// A correction of all keyframes, as the back end decides it.
fn moved(pipeline: &Pipeline, correction: &Correction, merged: Vec<MergedKeyframe>) -> Decision {
    let poses: BTreeMap<KeyframeId, Pose> = correction.t_map_base.iter().copied().collect();
    let (newest, t_map_base) = poses.last_key_value().map(|(id, pose)| (*id, *pose)).expect("some");
    let t_map_odom = Some(t_map_base * newest_keyframe(pipeline).t_odom_base.inverse());
    Decision { poses, t_map_odom, newest: Some(newest), merged }
}

#[test]
fn what_is_decided_is_shown_at_once_and_frames_go_on_from_there_while_bent_submaps_are_built_anew() {
    let (mut pipeline, rest) = driven();
    let before = pipeline.snapshot();
    let picture = before.layers.occupancy.dense(1 << 22).expect("small");
    let correction = bent(&pipeline, -0.002);
    let merged =
        MergedKeyframe { id: KeyframeId(3), into: KeyframeId(4), t_into_base: se3::from_xy_yaw(-0.2, 0.0, 0.0) };
    let t_decided = correction.t_map_base.last().expect("some").1 * newest_keyframe(&pipeline).t_odom_base.inverse();
    let decision = moved(&pipeline, &correction, vec![merged]);
    let change = decide(&mut pipeline, decision);
    check_whole(&pipeline, BENT);
    assert!(pipeline.is_revising() && change.merged.len() == 1);
    let shown = pipeline.snapshot();
    for (id, pose) in correction.t_map_base.iter().filter(|(id, _)| id.0 != 3) {
        assert_eq!((shown.keyframes[id.0 as usize].t_map_base, change.corrected[id]), (*pose, *pose));
    }
    assert_eq!(before.layers.occupancy.dense(1 << 22).expect("small"), picture, "who looked before sees that");

    let mut came = vec![];
    for frame in &rest {
        came.extend(pipeline.process(frame).expect("accepted").keyframe.map(|k| (k.info.id, k.t_odom_base)));
    }
    assert!(!came.is_empty() && !pipeline.is_revising());
    check_whole(&pipeline, BUILT);
    let shown = pipeline.snapshot();
    for (id, t_odom_base) in came {
        let off = se3::log(&(shown.keyframes[id.0 as usize].t_map_base.inverse() * t_decided * t_odom_base)).norm();
        assert!(off < 1e-9, "{id:?}: {off}");
    }
}

#[test]
fn keyframes_that_came_while_a_correction_was_thought_out_move_with_odom() {
    let (mut pipeline, _) = driven();
    let count = pipeline.map_graph.keyframes().len();
    let mut correction = bent(&pipeline, 0.002);
    correction.t_map_base.truncate(count - 5);
    let (newest, t_map_base) = *correction.t_map_base.last().expect("some");
    let t_map_odom = t_map_base * pipeline.map_graph.keyframes()[newest.0 as usize].t_odom_base.inverse();
    let poses = correction.t_map_base.iter().copied().collect();
    let decision = Decision { poses, t_map_odom: Some(t_map_odom), newest: Some(newest), merged: vec![] };
    decide(&mut pipeline, decision);
    check_whole(&pipeline, BENT);
    for k in pipeline.map_graph.keyframes().range(count - 5..count) {
        assert_eq!(k.t_map_base, t_map_odom * k.t_odom_base, "{:?}", k.id);
    }
}

#[test]
fn who_is_moved_twice_is_where_it_was_moved_last() {
    let (mut pipeline, _) = driven();
    let decision = moved(&pipeline, &bent(&pipeline, 0.002), vec![]);
    let mut change = decide(&mut pipeline, decision);
    let again = bent(&pipeline, 0.003);
    let decision = moved(&pipeline, &again, vec![]);
    change.extend(decide(&mut pipeline, decision));
    assert_eq!(change.corrected.into_iter().collect::<Vec<_>>(), again.t_map_base);
    assert!(pipeline.settle().corrected.is_empty() && !pipeline.is_revising());
    check_whole(&pipeline, BUILT);
}

#[test]
fn odometry_that_goes_on_elsewhere_does_so_from_the_keyframe_as_it_is_now() {
    let (mut pipeline, _) = driven();
    let correction = bent(&pipeline, 0.002);
    let decision = moved(&pipeline, &correction, vec![]);
    decide(&mut pipeline, decision);
    let t_keyframe_odom = se3::from_xy_yaw(1.0, 2.0, 0.3);
    pipeline.map_graph.place_odometry(KeyframeId(7), &t_keyframe_odom);
    assert_eq!(pipeline.map_graph.t_map_odom(), correction.t_map_base[7].1 * t_keyframe_odom);
}

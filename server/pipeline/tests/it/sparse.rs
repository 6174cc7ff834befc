//! Scans that come a metre of the way apart, without wheels that would tell it.

use crate::drive::empty;
use percept_geometry::se3;
use percept_pipeline::PipelineParams;
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};

#[test]
fn scans_a_metre_apart_are_placed_without_wheels() {
    let world = WorldParams { seed: 3, rooms: 4, person: false, ..WorldParams::default() };
    let sensors = SensorSuite::only_lidar2d();
    let params = SimParams { world, sensors, duration_s: Some(150.0), seed: 3, ..SimParams::default() };
    let office = Simulation::new(params).unwrap();
    let mut pipeline = empty(&office, PipelineParams::default());
    let (mut num, mut before, mut ways) = (0, None, vec![]);
    for frame in office.frames().step_by(20).map(|f| f.frame) {
        pipeline.process(&frame).unwrap();
        let truth = office.pose_at(frame.stamp);
        ways.extend(before.map(|b| se3::log(&truth.inv_mul(&b)).fixed_rows::<3>(0).norm()));
        before = Some(truth);
        num += 1;
    }
    pipeline.settle();
    ways.sort_by(f64::total_cmp);
    assert!(ways[ways.len() * 3 / 4] > 0.8, "{}", ways[ways.len() * 3 / 4]);
    let snapshot = pipeline.snapshot();
    let t_map_world = office.t_world_start().inverse();
    let mut off = vec![];
    for (t_map_base, entry) in snapshot.trajectory().filter(|(_, e)| e.tracked) {
        let truth = t_map_world * office.pose_at(entry.stamp);
        off.push((truth.translation.vector - t_map_base.translation.vector).norm());
    }
    off.sort_by(f64::total_cmp);
    assert!(off.len() * 10 >= num * 9, "{} of {num} placed", off.len());
    assert!(off[off.len() / 2] < 0.05 && off[off.len() - 1] < 0.3, "{} {}", off[off.len() / 2], off[off.len() - 1]);
}

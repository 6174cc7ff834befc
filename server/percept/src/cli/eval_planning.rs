//! Paths judged in simulated worlds, whose truth is exact.

use super::Failure;
use nalgebra::Point2;
use percept_geometry::{Cell, Pose};
use percept_mapping::DenseGrid;
use percept_planning::{NoPathReason, PlanOutcome, PlanParams, plan_dense};
use percept_sim::{TrueOccupancy, World, WorldParams};

#[derive(Debug, clap::Args)]
pub(crate) struct PlanningArgs {
    /// Worlds to plan in, by seeds 1, 2, ...
    #[arg(long, default_value_t = 100)]
    worlds: u64,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

/// Counts over all worlds.
#[derive(Debug, Default, Clone, Copy, serde::Serialize)]
struct PlanningCounts {
    worlds: usize,
    paths: usize,
    no_path: usize,
    collisions: usize,
    unreachable_asked: usize,
    unreachable_said: usize,
}

pub(crate) fn planning(args: &PlanningArgs) -> Result<(), Failure> {
    let bar = super::progress(args.worlds, "planning");
    let mut counts = PlanningCounts::default();
    for seed in 1..=args.worlds {
        plan_in_world(seed, &mut counts)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string(&counts)?);
    } else {
        println!(
            "{} worlds: {} paths, {} in collision, {} goals without a path; {} of {} walled-in goals said to be unreachable",
            counts.worlds,
            counts.paths,
            counts.collisions,
            counts.no_path,
            counts.unreachable_said,
            counts.unreachable_asked
        );
    }
    Ok(())
}

/// The true occupancy as a map, coarse enough to plan on: a cell is occupied if anything in it is.
fn map_of(truth: &TrueOccupancy) -> Result<DenseGrid, Failure> {
    let cells = truth.cells.iter().map(|&c| if c { 100 } else { 0 }).collect();
    Ok(DenseGrid::new(truth.geometry, truth.width, truth.height, cells)?)
}

/// From room to room, judged on a truth four times finer than the map.
fn plan_in_world(seed: u64, counts: &mut PlanningCounts) -> Result<(), Failure> {
    const BAND_M: (f64, f64) = (0.1, 1.8);
    let rooms = 2 + (seed % 5) as usize;
    let world = World::generate(&WorldParams { seed, rooms, ..WorldParams::default() })?;
    let (map, fine) = (map_of(&world.occupancy(0.05, BAND_M)?)?, world.occupancy(0.0125, BAND_M)?);
    let params = PlanParams::default();
    let simulation_start = percept_sim::RobotPath::new(&world, &percept_sim::RobotParams::default())?;
    let start = position(&simulation_start.pose_at(0.0));
    counts.worlds += 1;
    for i in 1..=4 {
        let goal = position(&simulation_start.pose_at(simulation_start.lap_duration_s() * f64::from(i) / 5.0));
        match plan_dense(&map, start, goal, &params)? {
            PlanOutcome::Path(path) => {
                counts.paths += 1;
                let points: Vec<Point2<f64>> = path.waypoints.iter().map(|w| w.position).collect();
                counts.collisions += usize::from(collides(&fine, &points, params.robot_radius_m));
            }
            PlanOutcome::NoPath { .. } => counts.no_path += 1,
        }
    }
    // A goal that a closed wall surrounds, with room enough inside.
    let goal = position(&simulation_start.pose_at(simulation_start.lap_duration_s() / 2.0));
    counts.unreachable_asked += 1;
    let answer = plan_dense(&walled_in(&map, goal)?, start, goal, &params)?;
    let said = matches!(answer, PlanOutcome::NoPath { reason: NoPathReason::Unreachable, .. });
    counts.unreachable_said += usize::from(said);
    Ok(())
}

fn position(pose: &Pose) -> Point2<f64> {
    pose.translation.vector.xy().into()
}

/// A ring of occupied cells around the goal, 0.4 m away.
fn walled_in(map: &DenseGrid, goal: Point2<f64>) -> Result<DenseGrid, Failure> {
    let mut cells = map.cells.clone();
    let edge = map.geometry.resolution_m;
    for (i, cell) in cells.iter_mut().enumerate() {
        let center = map.geometry.center(Cell::new((i % map.width) as i32, (i / map.width) as i32));
        let distance = (center - goal).norm();
        if (0.4..0.4 + 2.0 * edge).contains(&distance) {
            *cell = 100;
        }
    }
    Ok(DenseGrid::new(map.geometry, map.width, map.height, cells)?)
}

/// Whether a disc along the path touches an occupied cell, sampled every centimetre.
fn collides(truth: &TrueOccupancy, path: &[Point2<f64>], radius_m: f64) -> bool {
    let edge = truth.geometry.resolution_m;
    // A cell counts if its centre is inside by more than half its diagonal: certain overlap.
    let reach = radius_m - edge * 0.71;
    let n = (reach / edge).ceil() as i32;
    let hit = |p: Point2<f64>| {
        let Some(c) = truth.geometry.cell(&p) else { return true };
        (-n..=n).any(|dy| {
            (-n..=n).any(|dx| {
                let cell = Cell::new(c.x + dx, c.y + dy);
                (truth.geometry.center(cell) - p).norm() < reach && truth.at(cell).unwrap_or(true)
            })
        })
    };
    path.windows(2).any(|pair| {
        let steps = ((pair[1] - pair[0]).norm() / 0.01).ceil().max(1.0) as usize;
        (0..=steps).any(|i| hit(pair[0] + (pair[1] - pair[0]) * (i as f64 / steps as f64)))
    })
}

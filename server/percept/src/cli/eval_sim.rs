//! Objects and paths judged in simulated worlds, whose truth is exact.

use super::{Failure, local};
use nalgebra::Point2;
use percept_evaluation::{DetectionScore, FoundObject, TrueObject, match_detections};
use percept_geometry::{Cell, ObjectClass, OrientedBox3, Pose};
use percept_mapping::DenseGrid;
use percept_pipeline::PipelineParams;
use percept_planning::{NoPathReason, PlanOutcome, PlanParams, plan_dense};
use percept_scene::{Object, ObjectState};
use percept_sim::{SensorSuite, SimParams, Simulation, TrueOccupancy, World, WorldParams};
use serde_json::json;

/// Overlap from which a box counts as found, 3D intersection over union.
const MIN_IOU: f64 = 0.25;

#[derive(Debug, clap::Args)]
pub(crate) struct ObjectsArgs {
    /// Worlds to drive through, by seeds 1, 2, ...
    #[arg(long, default_value_t = 3)]
    worlds: u64,
    /// Rooms of a world.
    #[arg(long, default_value_t = 4)]
    rooms: usize,
    /// Threads for computing; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Name every object that was missed or that is not there.
    #[arg(long, conflicts_with = "json")]
    list: bool,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

/// A simulated robot with depth camera (5 Hz), planar lidar and wheels, as the demo has it.
pub(crate) fn demo_params(seed: u64, rooms: usize) -> SimParams {
    let mut sensors = SensorSuite::default();
    if let Some(camera) = &mut sensors.depth_camera {
        camera.rate_hz = 5.0;
    }
    SimParams { world: WorldParams { seed, rooms, ..WorldParams::default() }, sensors, seed, ..SimParams::default() }
}

/// True objects in the map frame, which begins at the robot's start.
pub(crate) fn truth_in_map(simulation: &Simulation, stamp: percept_geometry::Timestamp) -> Vec<TrueObject> {
    let t_map_world = simulation.t_world_start().inverse();
    simulation.objects_at(stamp).iter().map(|o| (o.class, o.bbox.transformed(&t_map_world))).collect()
}

fn add(total: &mut [usize; 5], score: &DetectionScore) {
    let right = (score.class_correct.unwrap_or(0.0) * score.true_positives as f64).round() as usize;
    let counts = [score.true_positives, score.false_positives, score.false_negatives, right, 1];
    total.iter_mut().zip(counts).for_each(|(t, c)| *t += c);
}

fn share(a: usize, b: usize) -> f64 {
    if b == 0 { 0.0 } else { a as f64 / b as f64 }
}

pub(crate) fn objects(args: &ObjectsArgs) -> Result<(), Failure> {
    let pool = super::compute_pool(args.threads, 0)?;
    let (mut total, mut by_class) = ([0; 5], Vec::new());
    for seed in 1..=args.worlds {
        let simulation = Simulation::new(demo_params(seed, args.rooms))?;
        let frames = simulation.frames();
        let bar = super::progress(frames.total(), "objects");
        let source = frames.map(|f| Ok::<_, Failure>(f.frame));
        let run = local::run(&pool, PipelineParams::default(), &simulation.sensors(), source, |_, _| bar.inc(1))?;
        bar.finish_and_clear();
        let stamp = run.snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default();
        // Everything counts, the person who walks on unseen, too.
        let truth = truth_in_map(&simulation, stamp);
        let there: Vec<_> = run.snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone).collect();
        let found: Vec<FoundObject> = there.iter().map(|o| (o.class, o.confidence, o.bbox)).collect();
        let score = match_detections(&truth, &found, MIN_IOU)?;
        add(&mut total, &score);
        if !args.json {
            println!(
                "world {seed}: {} true, {} found, {} matched; precision {:.3} recall {:.3}",
                truth.len(),
                found.len(),
                score.true_positives,
                score.precision.unwrap_or(0.0),
                score.recall.unwrap_or(0.0)
            );
        }
        if args.list {
            list_errors(&truth, &there, &score);
        }
        by_class.push(score.classes);
    }
    let [tp, fp, missed, right, _] = total;
    let (precision, recall) = (share(tp, tp + fp), share(tp, tp + missed));
    if args.json {
        println!(
            "{}",
            json!({"worlds": args.worlds, "min_iou": MIN_IOU, "precision": precision, "recall": recall,
                   "class_accuracy": share(right, tp), "true_positives": tp, "false_positives": fp,
                   "false_negatives": missed, "classes": by_class})
        );
        return Ok(());
    }
    println!("classifier, all worlds: class          true  found  right");
    for class in ObjectClass::BUILT_IN {
        let of_class = by_class.iter().flatten().filter(|c| c.class == class);
        let sums = of_class.fold([0; 3], |s, c| [s[0] + c.num_true, s[1] + c.num_located, s[2] + c.num_correct]);
        if sums[0] > 0 {
            println!("{:>24} {:<12} {:6} {:6} {:6}", "", class.name(), sums[0], sums[1], sums[2]);
        }
    }
    println!(
        "precision {precision:.3}, recall {recall:.3} at 3D IoU {MIN_IOU}; class right for {:.3} of the matches",
        share(right, tp)
    );
    Ok(())
}

/// What was missed and what is not there, with the true object that overlaps most.
fn list_errors(truth: &[TrueObject], found: &[&Object], score: &DetectionScore) {
    let place = |b: &OrientedBox3| {
        let (c, s) = (b.center(), b.size);
        format!("at ({:.2}, {:.2}, {:.2}) m, {:.2} x {:.2} x {:.2} m", c.x, c.y, c.z, s.x, s.y, s.z)
    };
    for (i, (class, bbox)) in truth.iter().enumerate().filter(|(i, _)| score.matches.iter().all(|m| m.0 != *i)) {
        let best = found.iter().map(|f| bbox.iou_upright(&f.bbox)).fold(0.0, f64::max);
        println!("  missed {i} {}: {}; best overlap {best:.2}", class.name(), place(bbox));
    }
    for (i, object) in found.iter().enumerate().filter(|(i, _)| score.matches.iter().all(|m| m.1 != *i)) {
        let overlap = |t: &&TrueObject| t.1.iou_upright(&object.bbox);
        let nearest = truth.iter().max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
        let (name, iou) = nearest.map_or(("nothing", 0.0), |t| (t.0.name(), overlap(&t)));
        println!(
            "  not there {i} {} ({:.2}): {}; {} points, seen {} times, last at {} s, {:?}; overlaps {name} by {iou:.2}",
            object.class.name(),
            object.confidence,
            place(&object.bbox),
            object.num_points,
            object.observation_count,
            object.last_seen.nanos() / 1_000_000_000,
            object.state,
        );
    }
}

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

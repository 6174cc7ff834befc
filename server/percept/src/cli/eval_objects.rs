//! Things and how they lie to each other, judged in simulated worlds, whose truth is exact.

use super::{Failure, local};
use percept_evaluation::{
    DetectionScore, FoundObject, Judged, TrueObject, average_precision, calibration_error, match_detections,
};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, Timestamp};
use percept_pipeline::{PipelineParams, Snapshot};
use percept_scene::{Object, ObjectId, ObjectState, Related, RelationKind};
use percept_sim::{MainSensor, Scenario, SensorSuite, SimParams, Simulation, WorldParams};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Overlaps from which a box counts as found, 3D intersection over union; what is told of things that were found counts from the first.
const MIN_IOU: [f64; 2] = [0.25, 0.5];
/// Bins of confidence for the calibration error.
const BINS: usize = 10;
/// What stands where nothing does, so near to where somebody walked, is their ghost, metres.
const GHOST_M: f64 = 0.5;
/// Cells of a map in which rooms are sought.
const MAX_CELLS: usize = 100_000_000;

/// What the robot sees with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Eyes {
    /// A depth camera (5 Hz) and a planar lidar, as the demo has them.
    Demo,
    /// A depth camera (10 Hz).
    Rgbd,
    /// A spinning lidar of 16 rings (10 Hz).
    Lidar3d,
}

#[derive(Debug, clap::Args)]
pub(crate) struct ObjectsArgs {
    /// Worlds to drive through.
    #[arg(long, default_value_t = 3)]
    worlds: u64,
    /// Seed of the first world; those after it have the next ones.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rooms of a world.
    #[arg(long, default_value_t = 4)]
    rooms: usize,
    /// What the robot sees with.
    #[arg(long, value_enum, default_value_t = Eyes::Demo)]
    sensor: Eyes,
    /// Length of a drive; a lap through all rooms if it is not given.
    #[arg(long)]
    seconds: Option<f64>,
    /// Threads for computing; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Name every object that was missed or that is not there, and every relation.
    #[arg(long, conflicts_with = "json")]
    list: bool,
    /// Write each world's map, pictures, objects and scene graph into a folder of its own in this one.
    #[arg(long)]
    out: Option<PathBuf>,
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

fn share(a: usize, b: usize) -> f64 {
    if b == 0 { 0.0 } else { a as f64 / b as f64 }
}

/// A relation with true objects for things, by their numbers, or the number of a room.
type Fact = (u64, RelationKind, Option<u64>);

/// Relations that were told and hold, were told, and hold.
#[derive(Debug, Clone, Copy, Default)]
struct Told {
    right: usize,
    told: usize,
    hold: usize,
}

/// What all worlds say together.
#[derive(Debug, Default)]
struct Total {
    true_positives: usize,
    found: usize,
    num_true: usize,
    class_right: usize,
    ghosts: usize,
    /// Found things by whether they are there, for each overlap.
    boxes: [Vec<Judged>; 2],
    /// Those of known class by whether a thing of that class is there.
    classes: Vec<Judged>,
    by_class: BTreeMap<ObjectClass, [usize; 3]>,
    relations: BTreeMap<RelationKind, Told>,
    /// Of all that hold, those whose things were found.
    between_found: usize,
}

pub(crate) fn objects(args: &ObjectsArgs) -> Result<(), Failure> {
    let pool = super::compute_pool(args.threads, 0)?;
    let mut total = Total::default();
    for seed in args.seed..args.seed.saturating_add(args.worlds) {
        let simulation = Simulation::new(params_of(args, seed)?)?;
        let frames = simulation.frames();
        let bar = super::progress(frames.total(), "objects");
        let source = frames.map(|f| Ok::<_, Failure>(f.frame));
        let run = local::run(&pool, PipelineParams::default(), &simulation.sensors(), source, |_, _| bar.inc(1))?;
        bar.finish_and_clear();
        let stamp = run.snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default();
        let world = Judgement::of(&simulation, &run.snapshot, stamp)?;
        if !args.json {
            println!("world {seed}: {}", world.line());
        }
        if args.list {
            world.list();
        }
        if let Some(out) = &args.out {
            super::replay::write_results(&out.join(format!("world-{seed}")), &run.snapshot)?;
        }
        total.add(&world);
    }
    if args.json {
        println!("{}", total.json(args))
    } else {
        total.print()
    }
    Ok(())
}

fn params_of(args: &ObjectsArgs, seed: u64) -> Result<SimParams, Failure> {
    let main = match args.sensor {
        Eyes::Demo => return Ok(SimParams { duration_s: args.seconds, ..demo_params(seed, args.rooms) }),
        Eyes::Rgbd => MainSensor::Rgbd,
        Eyes::Lidar3d => MainSensor::Lidar3d,
    };
    let params = Scenario::Loops.params(main, args.rooms, 1.0, seed)?;
    let world = WorldParams { person: true, ..params.world };
    Ok(SimParams { duration_s: args.seconds, world, ..params })
}

/// One world.
struct Judgement {
    truth: Vec<TrueObject>,
    there: Vec<Object>,
    scores: Vec<DetectionScore>,
    ghosts: Vec<ObjectId>,
    /// Facts that hold; those among them whose things were found; those told, each with what was told where a thing is not there.
    hold: BTreeSet<Fact>,
    between_found: BTreeSet<Fact>,
    told: Vec<(RelationKind, Option<Fact>, String)>,
}

impl Judgement {
    fn of(simulation: &Simulation, snapshot: &Snapshot, stamp: Timestamp) -> Result<Self, Failure> {
        // Everything counts, the person who walks on unseen, too.
        let truth = truth_in_map(simulation, stamp);
        let there: Vec<Object> = snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone).cloned().collect();
        let found: Vec<FoundObject> = there.iter().map(|o| (o.class, o.confidence, o.bbox)).collect();
        let scores: Vec<DetectionScore> =
            MIN_IOU.iter().map(|iou| match_detections(&truth, &found, *iou)).collect::<Result<_, _>>()?;
        let is_matched = |f: usize| scores[0].matches.iter().any(|m| m.1 == f);
        let walked = walked(simulation, stamp);
        let is_ghost = |o: &Object| {
            let is_free = truth.iter().all(|t| t.1.iou_upright(&o.bbox) < 0.01);
            is_free && walked.iter().any(|p| (p - o.bbox.center().xy().coords).norm() < GHOST_M)
        };
        let unmatched = there.iter().enumerate().filter(|(f, _)| !is_matched(*f)).map(|(_, o)| o);
        let ghosts = unmatched.filter(|o| is_ghost(o)).map(|o| o.id).collect();
        let (hold, told) = (facts(snapshot, &as_objects(&truth))?, facts(snapshot, &there)?);
        let to_true: BTreeMap<u64, u64> = scores[0].matches.iter().map(|m| (there[m.1].id.0, m.0 as u64)).collect();
        let matched: BTreeSet<u64> = to_true.values().copied().collect();
        let name = |id: u64| there.iter().find(|o| o.id.0 == id).map_or("", |o| o.class.name());
        let told = told.into_iter().map(|(subject, kind, object)| {
            let is_thing = kind != RelationKind::InRoom;
            let whom = object.map(|o| if is_thing { to_true.get(&o).copied() } else { Some(o) });
            let fact = match (to_true.get(&subject), whom) {
                (Some(subject), Some(Some(object))) => Some(ordered((*subject, kind, Some(object)))),
                (Some(subject), None) => Some((*subject, kind, None)),
                _ => None,
            };
            let whom = object
                .map_or(String::new(), |o| if is_thing { format!("{} {o}", name(o)) } else { format!("room {o}") });
            (kind, fact, format!("{} {subject} {} {whom}", name(subject), kind.name()))
        });
        let told = told.collect();
        let hold: BTreeSet<Fact> = hold.into_iter().map(ordered).collect();
        let is_between_found = |f: &&Fact| {
            matched.contains(&f.0) && f.2.is_none_or(|o| f.1 == RelationKind::InRoom || matched.contains(&o))
        };
        let between_found = hold.iter().filter(is_between_found).copied().collect();
        Ok(Self { truth, there, scores, ghosts, hold, between_found, told })
    }

    fn is_right(&self, fact: Option<Fact>) -> bool {
        fact.is_some_and(|f| self.hold.contains(&f))
    }

    fn line(&self) -> String {
        let score = &self.scores[0];
        let right = self.told.iter().filter(|t| self.is_right(t.1)).count();
        format!(
            "{} true, {} found, {} matched ({} at {}); precision {:.3} recall {:.3}; {} ghosts; {} relations, {} hold, of {} that hold {}",
            self.truth.len(),
            self.there.len(),
            score.true_positives,
            self.scores[1].true_positives,
            MIN_IOU[1],
            score.precision.unwrap_or(0.0),
            score.recall.unwrap_or(0.0),
            self.ghosts.len(),
            self.told.len(),
            right,
            self.hold.len(),
            right,
        )
    }

    fn list(&self) {
        list_errors(&self.truth, &self.there.iter().collect::<Vec<_>>(), &self.scores[0]);
        self.ghosts.iter().for_each(|id| println!("  ghost {id}"));
        self.told.iter().filter(|t| !self.is_right(t.1)).for_each(|t| println!("  does not hold: {}", t.2));
        let told: BTreeSet<Fact> = self.told.iter().filter_map(|t| t.1).collect();
        let name = |t: u64| self.truth.get(t as usize).map_or("", |t| t.0.name());
        for &(subject, kind, object) in self.between_found.iter().filter(|f| !told.contains(f)) {
            let whom = object.map_or(String::new(), |o| {
                if kind == RelationKind::InRoom { format!("room {o}") } else { format!("{} {o}", name(o)) }
            });
            println!("  not told: {} {subject} {} {whom}", name(subject), kind.name());
        }
    }
}

/// Relations that name the smaller one first do so by the true numbers.
fn ordered(fact: Fact) -> Fact {
    match fact {
        (a, kind @ (RelationKind::NextTo | RelationKind::Near), Some(b)) if b < a => (b, kind, Some(a)),
        fact => fact,
    }
}

/// True objects as the scene would have them.
fn as_objects(truth: &[TrueObject]) -> Vec<Object> {
    let one = |(i, (class, bbox)): (usize, &TrueObject)| Object {
        id: ObjectId(i as u64),
        class: *class,
        confidence: 1.0,
        class_probabilities: vec![(*class, 1.0)],
        bbox: *bbox,
        state: ObjectState::Static,
        velocity_mps: nalgebra::Vector3::zeros(),
        velocity_variance: 0.0,
        first_seen: Timestamp::default(),
        last_seen: Timestamp::default(),
        observation_count: 1,
        num_points: 1,
        annotation: percept_scene::Annotation::default(),
        history: vec![],
    };
    truth.iter().enumerate().map(one).collect()
}

/// How these objects lie to each other and in which room of the map they are.
fn facts(snapshot: &Snapshot, objects: &[Object]) -> Result<Vec<Fact>, Failure> {
    use percept_scene::{NodeId, RelationFilter, SceneGraph, SceneView};
    let rooms = snapshot.rooms(MAX_CELLS)?;
    let related = Related::of(objects, &rooms, &snapshot.params.relations);
    let (names, t_map_base) = (BTreeMap::new(), Pose::identity());
    let view = SceneView {
        stamp: Timestamp::default(),
        map_version: snapshot.map_version,
        t_map_base: &t_map_base,
        objects,
        rooms: &rooms,
        related: &related,
        names: &names,
        since: None,
    };
    let graph = SceneGraph::build(&view, &snapshot.params.relations, None, &RelationFilter::default());
    let fact = |r: &percept_scene::Relation| match (r.subject, r.object) {
        (NodeId::Object(a), NodeId::Object(b)) => Some((a.0, r.kind, Some(b.0))),
        (NodeId::Object(a), NodeId::Room(b)) => Some((a.0, r.kind, Some(b.0))),
        _ => None,
    };
    Ok(graph.edges.iter().filter_map(fact).collect())
}

/// Where what moves was until a time, ten times a second, in the map.
fn walked(simulation: &Simulation, until: Timestamp) -> Vec<nalgebra::Vector2<f64>> {
    let t_map_world = simulation.t_world_start().inverse();
    let times = simulation.truth(10.0).into_iter().map(|s| s.stamp).filter(|t| *t <= until);
    let moving = times.flat_map(|t| simulation.objects_at(t).into_iter().filter(|o| o.moving));
    moving.map(|o| (t_map_world * o.bbox.center()).xy().coords).collect()
}

impl Total {
    fn add(&mut self, world: &Judgement) {
        let score = &world.scores[0];
        self.true_positives += score.true_positives;
        self.found += world.there.len();
        self.num_true += world.truth.len();
        self.ghosts += world.ghosts.len();
        for (boxes, score) in self.boxes.iter_mut().zip(&world.scores) {
            let is_matched: BTreeSet<usize> = score.matches.iter().map(|m| m.1).collect();
            boxes.extend(world.there.iter().enumerate().map(|(f, o)| (o.confidence, is_matched.contains(&f))));
        }
        let right: BTreeSet<usize> =
            score.matches.iter().filter(|m| world.truth[m.0].0 == world.there[m.1].class).map(|m| m.1).collect();
        self.class_right += right.len();
        let known = world.there.iter().enumerate().filter(|(_, o)| o.class != ObjectClass::Unknown);
        self.classes.extend(known.map(|(f, o)| (o.confidence, right.contains(&f))));
        for c in &score.classes {
            let sums = self.by_class.entry(c.class).or_default();
            [c.num_true, c.num_located, c.num_correct].iter().zip(sums).for_each(|(n, sum)| *sum += n);
        }
        for (kind, fact, _) in &world.told {
            let of_kind = self.relations.entry(*kind).or_default();
            of_kind.told += 1;
            of_kind.right += usize::from(world.is_right(*fact));
        }
        world.hold.iter().for_each(|f| self.relations.entry(f.1).or_default().hold += 1);
        self.between_found += world.between_found.len();
    }

    fn told(&self) -> Told {
        self.relations.values().fold(Told::default(), |a, b| Told {
            right: a.right + b.right,
            told: a.told + b.told,
            hold: a.hold + b.hold,
        })
    }

    fn average_precision(&self, k: usize) -> f64 {
        average_precision(&self.boxes[k], self.num_true).unwrap_or(0.0)
    }

    fn json(&self, args: &ObjectsArgs) -> serde_json::Value {
        let told = self.told();
        json!({
            "worlds": args.worlds,
            "min_iou": MIN_IOU[0],
            "precision": share(self.true_positives, self.found),
            "recall": share(self.true_positives, self.num_true),
            "average_precision": { "0.25": self.average_precision(0), "0.5": self.average_precision(1) },
            "class_accuracy": share(self.class_right, self.true_positives),
            "calibration_error": calibration_error(&self.classes, BINS),
            "true_positives": self.true_positives,
            "false_positives": self.found - self.true_positives,
            "false_negatives": self.num_true - self.true_positives,
            "ghosts": self.ghosts,
            "relations": {
                "precision": share(told.right, told.told),
                "recall": share(told.right, told.hold),
                "recall_between_found": share(told.right, self.between_found),
            },
            "classes": self.by_class.iter().map(|(class, [t, located, correct])| {
                json!({ "class": class.name(), "num_true": t, "num_located": located, "num_correct": correct })
            }).collect::<Vec<_>>(),
        })
    }

    fn print(&self) {
        println!("classifier, all worlds: class          true  found  right");
        for (class, [num_true, located, correct]) in self.by_class.iter().filter(|(_, s)| s[0] > 0) {
            println!("{:>24} {:<12} {num_true:6} {located:6} {correct:6}", "", class.name());
        }
        println!("relations, all worlds:  kind           hold   told  right");
        for (kind, told) in &self.relations {
            println!("{:>24} {:<12} {:6} {:6} {:6}", "", kind.name(), told.hold, told.told, told.right);
        }
        let told = self.told();
        println!(
            "precision {:.3}, recall {:.3}, average precision {:.3} at 3D IoU {}, {:.3} at {}; class right for {:.3} of the matches, \
             calibration error {:.3}; {} ghosts",
            share(self.true_positives, self.found),
            share(self.true_positives, self.num_true),
            self.average_precision(0),
            MIN_IOU[0],
            self.average_precision(1),
            MIN_IOU[1],
            share(self.class_right, self.true_positives),
            calibration_error(&self.classes, BINS).unwrap_or(0.0),
            self.ghosts,
        );
        println!(
            "relations: precision {:.3}, recall {:.3}, {:.3} between what was found",
            share(told.right, told.told),
            share(told.right, told.hold),
            share(told.right, self.between_found),
        );
    }
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
    for (t, f) in score.matches.iter().map(|m| (m.0, m.1)) {
        let (truth, object) = (&truth[t], found[f]);
        println!(
            "  found {t} {}, overlap {:.2}: {}; as {f} {} ({:.2}): {}",
            truth.0.name(),
            truth.1.iou_upright(&object.bbox),
            place(&truth.1),
            object.class.name(),
            object.confidence,
            place(&object.bbox),
        );
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

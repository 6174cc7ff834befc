//! People who walk by, tracked: `passing demo|rgbd|lidar3d [--worlds N] [--seed N] [--rooms N] [--seconds S] [--list]` of simulated
//! worlds.
//!
//! At each frame that shows the person (three of nine rays to them end there, within 6 m) the tracked object nearest to them counts if
//! it is within 0.6 m; what else is told as moving, anywhere, is false. Printed are the identity score (IDF1, from one
//! second after the person came into sight), how far off position and velocity are, and what is still told as standing at the end
//! where nothing stands.

use nalgebra::{Point3, Vector3};
use percept_evaluation::{IdentityPair, identity_score};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, SensorKind, Timestamp};
use percept_pipeline::{Pipeline, PipelineParams};
use percept_scene::{Object, ObjectState};
use percept_sim::{MainSensor, Scenario, SensorSuite, SimParams, Simulation, TrueObject, WorldParams};
use std::collections::BTreeSet;
use std::error::Error;

type Failure = Box<dyn Error + Send + Sync>;

/// What is so near is the person, metres: half a person wide, and what they walk in 0.3 s.
const SAME_M: f64 = 0.6;
/// As far as a depth camera sees well, metres.
const RANGE_M: f64 = 6.0;
/// Time to see that something moves, seconds.
const SETTLE_S: f64 = 1.0;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: passing demo|rgbd|lidar3d [--worlds N] [--seed N] [--rooms N] [--seconds S] [--list]";
    let source = args.first().ok_or(usage)?;
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let number = |name: &str, default: u64| after(name).map_or(Ok(default), |v| v.parse());
    let (worlds, first) = (number("--worlds", 1)?, number("--seed", 1)?);
    let (rooms, seconds) = (number("--rooms", 4)? as usize, number("--seconds", 120)?);
    let mut all = Score::default();
    for seed in first..first + worlds {
        let params = match source.as_str() {
            "demo" => demo(rooms, seed),
            "rgbd" => Scenario::Loops.params(MainSensor::Rgbd, rooms, seconds as f64, seed)?,
            "lidar3d" => Scenario::Loops.params(MainSensor::Lidar3d, rooms, seconds as f64, seed)?,
            _ => return Err(usage.into()),
        };
        let world = WorldParams { person: true, ..params.world };
        let score = run(&Simulation::new(SimParams { world, ..params })?, args.iter().any(|a| a == "--list"))?;
        println!("world {seed}: {}", score.line());
        all.add(score);
    }
    println!("{worlds} worlds: {}", all.line());
    Ok(())
}

/// What `percept demo` drives.
fn demo(rooms: usize, seed: u64) -> SimParams {
    let mut sensors = SensorSuite::default();
    if let Some(camera) = &mut sensors.depth_camera {
        camera.rate_hz = 5.0;
    }
    SimParams { world: WorldParams { seed, rooms, ..WorldParams::default() }, sensors, seed, ..SimParams::default() }
}

#[derive(Default)]
struct Score {
    pairs: Vec<IdentityPair>,
    off_m: Vec<f64>,
    velocity_off: Vec<f64>,
    named: usize,
    false_ids: BTreeSet<i64>,
    standing: BTreeSet<i64>,
    ghosts: usize,
}

impl Score {
    fn add(&mut self, other: Self) {
        // Numbers of other worlds are other things.
        let base = 1 + self.pairs.iter().flat_map(|p| [p.0, p.1]).flatten().max().unwrap_or(0);
        let moved = |id: Option<i64>| id.map(|id| id + base);
        self.pairs.extend(other.pairs.iter().map(|(a, b)| (moved(*a), moved(*b))));
        self.false_ids.extend(other.false_ids.iter().map(|id| id + base));
        self.standing.extend(other.standing.iter().map(|id| id + base));
        self.off_m.extend(other.off_m);
        self.velocity_off.extend(other.velocity_off);
        self.named += other.named;
        self.ghosts += other.ghosts;
    }

    fn line(&self) -> String {
        let identity = identity_score(&self.pairs);
        let matched = self.pairs.iter().filter(|p| p.0.is_some() && p.1.is_some()).count();
        let median = |of: &[f64]| {
            let mut sorted = of.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
        };
        format!(
            "seen in {} frames, tracked in {matched}, named person in {}; IDF1 {:.3}, {} switches; off by {:.2} m and {:.2} m/s in \
             the median; {} false movers, {} told as people who stand at some time; {} ghosts",
            identity.num_true,
            self.named,
            identity.idf1.unwrap_or(0.0),
            identity.num_switches,
            median(&self.off_m),
            median(&self.velocity_off),
            self.false_ids.len(),
            self.standing.len(),
            self.ghosts
        )
    }
}

fn run(simulation: &Simulation, is_listed: bool) -> Result<Score, Failure> {
    let mut pipeline = Pipeline::new(PipelineParams::default())?;
    let sensors = simulation.sensors();
    sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let t_map_world = simulation.t_world_start().inverse();
    let (mut score, mut in_sight_since, mut last) = (Score::default(), None, Timestamp::default());
    for frame in simulation.frames() {
        let stamp = frame.frame.stamp;
        let spec = sensors.iter().find(|s| s.id == frame.frame.sensor);
        pipeline.process(&frame.frame)?;
        last = stamp;
        let Some(spec) = spec.filter(|s| matches!(s.kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Lidar3d))
        else {
            continue;
        };
        let person = simulation.objects_at(stamp).into_iter().find(|o| o.moving);
        let t_world_sensor = frame.t_world_base * spec.t_base_sensor;
        let half_angle = spec.intrinsics.as_ref().map(|k| (0.5 * k.width as f64 / k.fx).atan());
        let shown = person.filter(|p| is_shown(simulation, p, &t_world_sensor, half_angle, frame.measured_s));
        in_sight_since = shown.as_ref().map(|_| in_sight_since.unwrap_or(stamp));
        let snapshot = pipeline.snapshot();
        let moving = |o: &&Object| o.state == ObjectState::Moving;
        let mut told: Vec<&Object> = snapshot.objects.iter().filter(moving).collect();
        let standing = |o: &&Object| o.class == ObjectClass::Person && o.state == ObjectState::Static;
        score.standing.extend(snapshot.objects.iter().filter(standing).map(|o| o.id.0 as i64));
        if let Some(person) = &shown {
            let place = t_map_world * person.bbox.center();
            let off = |o: &Object| (o.bbox.center() - place).xy().norm();
            told.sort_by(|a, b| off(a).total_cmp(&off(b)));
            let nearest = told.first().filter(|o| off(o) <= SAME_M).copied();
            let is_settled = in_sight_since.is_some_and(|since| stamp.seconds_since(since) >= SETTLE_S);
            if let Some(o) = nearest {
                let walked = walk(simulation, stamp);
                score.off_m.push(off(o));
                score.velocity_off.push((o.velocity_mps - t_map_world.rotation * walked).xy().norm());
                score.named += usize::from(o.class == ObjectClass::Person);
                told.remove(0);
            }
            if nearest.is_some() || is_settled {
                score.pairs.push((Some(0), nearest.map(|o| o.id.0 as i64)));
            }
        }
        // Where the person is, seen or not, somebody is.
        let there = simulation.objects_at(stamp).into_iter().find(|o| o.moving).map(|o| t_map_world * o.bbox.center());
        for o in told.iter().filter(|o| there.is_none_or(|p| (o.bbox.center() - p).xy().norm() > 2.0 * SAME_M)) {
            if score.false_ids.insert(o.id.0 as i64) && is_listed {
                println!(
                    "  {:.1} s: {} {} {:?} at {:.2?}, {:.2?}; person at {there:.2?}",
                    stamp.nanos() as f64 * 1e-9,
                    o.class,
                    o.id,
                    o.state,
                    o.bbox.center().coords.as_slice(),
                    o.bbox.size.as_slice()
                );
            }
            score.pairs.push((None, Some(o.id.0 as i64)));
        }
    }
    pipeline.finish_revision();
    let truth: Vec<OrientedBox3> =
        simulation.objects_at(last).iter().map(|o| o.bbox.transformed(&t_map_world)).collect();
    let stands = |o: &&Object| o.state == ObjectState::Static;
    let grown = |b: &OrientedBox3| OrientedBox3 { size: b.size.add_scalar(0.3), ..*b };
    let is_ghost =
        |o: &&Object| truth.iter().all(|t| !grown(t).contains(&o.bbox.center()) && t.iou_upright(&o.bbox) < 0.05);
    let snapshot = pipeline.snapshot();
    for o in snapshot.objects.iter().filter(stands).filter(is_ghost) {
        score.ghosts += 1;
        if is_listed {
            println!(
                "  ghost: {} {} ({:.2}) at {:.2?}, {:.2?}, {} points, {} looks",
                o.class,
                o.id,
                o.confidence,
                o.bbox.center().coords.as_slice(),
                o.bbox.size.as_slice(),
                o.num_points,
                o.observation_count
            );
        }
    }
    Ok(score)
}

/// Whether a sensor shows the person: optical axis z where it has a field of view, all around else.
fn is_shown(
    simulation: &Simulation,
    person: &TrueObject,
    t_world_sensor: &Pose,
    half_angle: Option<f64>,
    t_s: f64,
) -> bool {
    let origin: Point3<f64> = t_world_sensor.translation.vector.into();
    let lattice = (0..9).map(|i| {
        let at = |k: i32| f64::from(k - 1) * 0.3;
        person.bbox.t_frame_box * Point3::new(0.0, at(i % 3) * person.bbox.size.y, at(i / 3) * person.bbox.size.z)
    });
    let reached = lattice.filter(|p| {
        let direction = p - origin;
        let seen = t_world_sensor.rotation.inverse() * direction;
        let is_in_view = half_angle.is_none_or(|half| seen.z > 0.0 && seen.x.atan2(seen.z).abs() < half);
        let hit = simulation.world().cast(&origin, &direction.normalize(), t_s, RANGE_M);
        is_in_view && hit.is_some_and(|h| h.object == Some(person.id))
    });
    reached.count() >= 3
}

/// Velocity of the person, world frame, m/s.
fn walk(simulation: &Simulation, stamp: Timestamp) -> Vector3<f64> {
    let at = |seconds: f64| simulation.objects_at(stamp.plus_seconds(seconds)).into_iter().find(|o| o.moving);
    match (at(-0.1), at(0.1)) {
        (Some(before), Some(after)) => (after.bbox.center() - before.bbox.center()) / 0.2,
        _ => Vector3::zeros(),
    }
}

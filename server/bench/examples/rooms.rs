//! Rooms and doors that are found: `rooms lidar2d|lidar3d|rgbd|demo [--worlds N] [--seed N] [--rooms N] [--seconds S]
//! [--out PICTURE.png]` of simulated
//! worlds against what was built, or `rooms PATH [--out PICTURE.png]` of a recording.
//!
//! Printed are the mean overlap (intersection over union, by cells) of each built room, as far as the map knows it, with the one found
//! that overlaps it most; rooms found that no built one answers for half; doors found within half a metre of a built one that was
//! driven through, and those found where none is; links of places; and the time it took.

use nalgebra::{Point2, Point3};
use percept_formats::dataset;
use percept_geometry::{Pose, RgbImage, SensorFrame, SensorSpec};
use percept_pipeline::{Pipeline, PipelineParams, Snapshot};
use percept_scene::rooms::Rooms;
use percept_sim::{MainSensor, Scenario, SensorSuite, SimParams, Simulation, World, WorldParams};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Failure = Box<dyn Error + Send + Sync>;

/// Cells of a map.
const MAX_CELLS: usize = 100_000_000;
/// A door is found if one is told so near, metres.
const DOOR_M: f64 = 0.5;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let source = args
        .first()
        .ok_or("usage: rooms lidar2d|lidar3d|rgbd|PATH [--worlds N] [--rooms N] [--seconds S] [--out PNG]")?;
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let number = |name: &str, default: u64| after(name).map_or(Ok(default), |v| v.parse());
    let sensor = match source.as_str() {
        "lidar2d" => Some(MainSensor::Lidar2d),
        "lidar3d" => Some(MainSensor::Lidar3d),
        "rgbd" => Some(MainSensor::Rgbd),
        _ => None,
    };
    if sensor.is_none() && source != "demo" {
        let recording = dataset::open(Path::new(source))?;
        let (snapshot, _) = run(&recording.sensors, recording.frames(None).map(|f| Ok(f?)))?;
        let (grid, rooms) = divided(&snapshot)?;
        rooms.rooms.iter().for_each(|r| {
            println!("  {:>6} {:9} {:6.1} m2 at {:.1} {:.1}", r.id, r.kind.name(), r.area_m2, r.center.x, r.center.y)
        });
        rooms.doors.iter().for_each(|d| {
            println!("  door {} {} {:.2} m at {:.1} {:.1}", d.rooms.0, d.rooms.1, d.width_m, d.center.x, d.center.y)
        });
        return draw(&grid, &rooms, after("--out"));
    };
    let (worlds, count, seconds) = (number("--worlds", 1)?, number("--rooms", 6)? as usize, number("--seconds", 120)?);
    let mut all = Vec::new();
    for seed in number("--seed", 1)?..number("--seed", 1)? + worlds {
        let params = match sensor {
            Some(sensor) => Scenario::Loops.params(sensor, count, seconds as f64, seed)?,
            None => demo(count, seed),
        };
        let simulation = Simulation::new(params)?;
        let mut t_world_map = None;
        let frames = simulation.frames().map(|f| {
            t_world_map.get_or_insert(f.t_world_base);
            Ok(f.frame)
        });
        let (snapshot, _) = run(&simulation.sensors(), frames)?;
        let (grid, rooms) = divided(&snapshot)?;
        let score = judge(simulation.world(), &t_world_map.unwrap_or_default(), &grid, &rooms);
        println!("world {seed}: {score:?}");
        draw(&grid, &rooms, after("--out"))?;
        all.push(score);
    }
    let sum = |of: fn(&Score) -> f64| all.iter().map(of).sum::<f64>();
    println!(
        "{worlds} worlds: overlap {:.3}; {} of {} rooms at 0.5, {} told too many; {} of {} doors, {} where none is",
        sum(|s| s.overlaps.iter().sum()) / sum(|s| s.overlaps.len() as f64),
        sum(|s| s.overlaps.iter().filter(|v| **v >= 0.5).count() as f64),
        sum(|s| s.overlaps.len() as f64),
        sum(|s| s.too_many as f64),
        sum(|s| s.doors_found as f64),
        sum(|s| s.doors as f64),
        sum(|s| s.doors_wrong as f64),
    );
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

fn run(
    sensors: &[SensorSpec],
    frames: impl Iterator<Item = Result<SensorFrame, Failure>>,
) -> Result<(Snapshot, usize), Failure> {
    let mut pipeline = Pipeline::new(PipelineParams::default())?;
    sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let mut count = 0;
    for frame in frames {
        pipeline.process(&frame?)?;
        count += 1;
    }
    pipeline.settle();
    Ok((pipeline.snapshot(), count))
}

fn divided(snapshot: &Snapshot) -> Result<(percept_mapping::DenseGrid, Rooms), Failure> {
    use percept_mapping::Occupancy;
    let grid = snapshot.layers.occupancy.dense(MAX_CELLS)?;
    let begin = Instant::now();
    let rooms = Rooms::clone(&*snapshot.rooms(MAX_CELLS)?);
    println!(
        "  {} x {} cells, {} objects: {} rooms, {} doors, {} places, {} links in {:.0} ms",
        grid.width,
        grid.height,
        snapshot.objects.len(),
        rooms.rooms.len(),
        rooms.doors.len(),
        rooms.places.len(),
        rooms.links.len(),
        begin.elapsed().as_secs_f64() * 1e3
    );
    Ok((grid, rooms))
}

#[derive(Debug)]
struct Score {
    overlaps: Vec<f64>,
    too_many: usize,
    doors: usize,
    doors_found: usize,
    doors_wrong: usize,
}

fn judge(world: &World, t_world_map: &Pose, grid: &percept_mapping::DenseGrid, rooms: &Rooms) -> Score {
    let built = world.rooms();
    let in_world = |p: &Point2<f64>| (t_world_map * Point3::new(p.x, p.y, 0.0)).xy();
    let (mut known, mut both) = (vec![0usize; built.len()], vec![vec![0usize; rooms.rooms.len()]; built.len()]);
    let mut told = vec![0usize; rooms.rooms.len()];
    for i in 0..grid.cells.len() {
        let cell = percept_geometry::Cell::new((i % grid.width) as i32, (i / grid.width) as i32);
        let p = grid.geometry.center(cell);
        let of = rooms.at(&p).and_then(|r| rooms.rooms.iter().position(|o| o.id == r.id));
        let truth = built.iter().position(|r| r.contains(&in_world(&p)));
        if let Some(of) = of {
            told[of] += 1;
        }
        if let Some(truth) = truth.filter(|_| grid.cells[i] >= 0) {
            known[truth] += 1;
            if let Some(of) = of {
                both[truth][of] += 1;
            }
        }
    }
    let iou = |truth: usize, of: usize| {
        let both = both[truth][of] as f64;
        both / (known[truth] as f64 + told[of] as f64 - both)
    };
    // Rooms of which the map shows a third.
    let area = grid.geometry.resolution_m.powi(2);
    let seen: Vec<usize> = (0..built.len()).filter(|r| known[*r] as f64 * area > built[*r].area() / 3.0).collect();
    let overlaps: Vec<f64> =
        seen.iter().map(|r| (0..rooms.rooms.len()).map(|of| iou(*r, of)).fold(0.0, f64::max)).collect();
    let is_answered = |of: &usize| {
        (0..built.len()).any(|truth| 2 * both[truth][*of] > known[truth].min(told[*of]) && iou(truth, *of) > 0.5)
    };
    let too_many = (0..rooms.rooms.len()).filter(|of| !is_answered(of)).count();
    let doors: Vec<_> =
        world.doors().iter().filter(|d| seen.contains(&d.rooms.0) && seen.contains(&d.rooms.1)).collect();
    let is_near = |d: &percept_scene::rooms::Door, center: &Point2<f64>| (in_world(&d.center) - center).norm() < DOOR_M;
    Score {
        overlaps,
        too_many,
        doors: doors.len(),
        doors_found: doors.iter().filter(|t| rooms.doors.iter().any(|d| is_near(d, &t.center))).count(),
        doors_wrong: rooms.doors.iter().filter(|d| !world.doors().iter().any(|t| is_near(d, &t.center))).count(),
    }
}

/// Rooms in colours, walls black, doors red, places white with their links.
fn draw(grid: &percept_mapping::DenseGrid, rooms: &Rooms, out: Option<&String>) -> Result<(), Failure> {
    const COLORS: [[u8; 3]; 8] = [
        [166, 206, 227],
        [178, 223, 138],
        [251, 154, 153],
        [253, 191, 111],
        [202, 178, 214],
        [255, 255, 153],
        [141, 211, 199],
        [217, 217, 217],
    ];
    let Some(out) = out else { return Ok(()) };
    let (width, height) = (grid.width, grid.height);
    let mut data = vec![90u8; 3 * width * height];
    let mut put = |p: &Point2<f64>, color: [u8; 3]| {
        if let Some(i) = grid.geometry.cell(p).and_then(|c| grid.index(c)) {
            let at = (height - 1 - i / width) * width + i % width;
            data[3 * at..3 * at + 3].copy_from_slice(&color);
        }
    };
    for i in 0..grid.cells.len() {
        let p = grid.geometry.center(percept_geometry::Cell::new((i % width) as i32, (i / width) as i32));
        let room = rooms.at(&p).and_then(|r| rooms.rooms.iter().position(|o| o.id == r.id));
        let color = match room {
            _ if grid.cells[i] >= 60 => [0; 3],
            Some(room) => COLORS[room % COLORS.len()],
            None if grid.cells[i] >= 0 => [255; 3],
            None => [90; 3],
        };
        put(&p, color);
    }
    let mut line = |a: &Point2<f64>, b: &Point2<f64>, color: [u8; 3]| {
        let steps = ((b - a).norm() / grid.geometry.resolution_m * 2.0).ceil().max(1.0);
        (0..=steps as usize).for_each(|k| put(&(a + (b - a) * (k as f64 / steps)), color));
    };
    for link in &rooms.links {
        let at = |id: percept_scene::rooms::PlaceId| rooms.places[id.0 as usize].position;
        line(&at(link.places.0), &at(link.places.1), [120; 3]);
    }
    for room in &rooms.rooms {
        for (i, a) in room.outline.iter().enumerate() {
            line(a, &room.outline[(i + 1) % room.outline.len()], [0, 0, 200]);
        }
    }
    for door in &rooms.doors {
        let half = nalgebra::Vector2::new(door.angle_rad.cos(), door.angle_rad.sin()) * (0.5 * door.width_m);
        line(&(door.center - half), &(door.center + half), [230, 0, 0]);
    }
    std::fs::write(out, percept_formats::images::encode_rgb_png(&RgbImage::new(width, height, data)?)?)?;
    Ok(())
}

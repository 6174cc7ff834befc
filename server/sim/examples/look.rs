//! Draws a world to look at: `cargo run --release -p percept-sim --example look -- FOLDER [SEED] [ROOMS]`.
//!
//! Writes the plan with the robot's lane (`plan.ppm`) and, along the lap, colour and depth as the camera
//! sees them (`color-*.ppm`, `depth-*.pgm`, 16 bit millimetres); prints how long a frame of each sensor takes.

use nalgebra::Point2;
use percept_geometry::{Cell, SensorData};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let folder = Path::new(args.get(1).ok_or("usage: look FOLDER [SEED] [ROOMS]")?);
    let number = |i: usize, default: u64| args.get(i).map_or(Ok(default), |s| s.parse::<u64>());
    let world = WorldParams { seed: number(2, 1)?, rooms: number(3, 4)? as usize, ..WorldParams::default() };
    let simulation = Simulation::new(SimParams { world, sensors: SensorSuite::all(), ..SimParams::default() })?;
    std::fs::create_dir_all(folder)?;
    println!(
        "{} rooms, {} objects, lap {:.1} m in {:.0} s",
        simulation.world().rooms().len(),
        simulation.world().objects_at(0.0).len(),
        simulation.path().lap_length_m(),
        simulation.path().lap_duration_s()
    );
    draw_plan(&simulation, &folder.join("plan.ppm"))?;
    for k in 0..8 {
        look_at(&simulation, f64::from(k) / 8.0, folder, k)?;
    }
    time_sensors(&simulation);
    Ok(())
}

/// Occupancy in grey, lane in blue, objects' boxes in red.
fn draw_plan(simulation: &Simulation, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let grid = simulation.world().occupancy(0.02, (0.1, 1.8))?;
    let mut pixels = vec![[255u8; 3]; grid.width * grid.height];
    let mut dot = |p: Point2<f64>, color: [u8; 3]| {
        if let Some(Cell { x, y }) = grid.geometry.cell(&p)
            && x >= 0
            && y >= 0
            && (x as usize) < grid.width
            && (y as usize) < grid.height
        {
            pixels[(grid.height - 1 - y as usize) * grid.width + x as usize] = color;
        }
    };
    for y in 0..grid.height as i32 {
        for x in 0..grid.width as i32 {
            if grid.at(Cell::new(x, y)) == Some(true) {
                dot(grid.geometry.center(Cell::new(x, y)), [90, 90, 90]);
            }
        }
    }
    for i in 0..20_000 {
        let t = simulation.path().lap_duration_s() * f64::from(i) / 20_000.0;
        let p = simulation.path().pose_at(t).translation.vector;
        dot(Point2::new(p.x, p.y), [0, 0, 255]);
    }
    for step in 0..40 {
        for object in simulation.world().objects_at(f64::from(step) * 0.2) {
            let corners = object.bbox.footprint();
            for i in 0..4 {
                for s in 0..100 {
                    let p = corners[i] + (corners[(i + 1) % 4] - corners[i]) * (f64::from(s) / 100.0);
                    dot(p, if object.moving { [0, 160, 0] } else { [255, 0, 0] });
                }
            }
        }
    }
    let mut out = format!("P6 {} {} 255\n", grid.width, grid.height).into_bytes();
    out.extend(pixels.iter().flatten());
    Ok(std::fs::write(path, out)?)
}

/// The colour and depth image nearest to a share of the lap.
fn look_at(simulation: &Simulation, share: f64, folder: &Path, k: i32) -> Result<(), Box<dyn std::error::Error>> {
    let mut params = simulation.params().clone();
    params.sensors = SensorSuite::only_depth_camera();
    // One image a lap's eighth: the first is at the start, so that the rate chooses the time.
    let at = share * simulation.path().lap_duration_s();
    let rate = if at > 0.0 { 1.0 / at } else { 1.0 };
    if let Some(camera) = &mut params.sensors.depth_camera {
        camera.rate_hz = rate.max(0.1);
    }
    let skip = (at * rate.max(0.1)).round() as usize;
    let Some(shot) = Simulation::new(params)?.frames().nth(skip) else { return Ok(()) };
    if let SensorData::Rgbd(depth, color) = shot.frame.data {
        let mut out = format!("P6 {} {} 255\n", color.width(), color.height()).into_bytes();
        out.extend(color.data());
        std::fs::write(folder.join(format!("color-{k}.ppm")), out)?;
        let mut out = format!("P5 {} {} 65535\n", depth.width(), depth.height()).into_bytes();
        out.extend(depth.data().iter().flat_map(|d| ((d * 1000.0) as u16).to_be_bytes()));
        std::fs::write(folder.join(format!("depth-{k}.pgm")), out)?;
    }
    Ok(())
}

fn time_sensors(simulation: &Simulation) {
    let mut spent = std::collections::BTreeMap::<String, (f64, u32)>::new();
    let mut frames = simulation.frames();
    loop {
        let start = Instant::now();
        let Some(frame) = frames.next().filter(|f| simulation.seconds_at(f.frame.stamp) < 6.0) else { break };
        let entry = spent.entry(frame.frame.sensor.0).or_default();
        *entry = (entry.0 + start.elapsed().as_secs_f64(), entry.1 + 1);
    }
    for (sensor, (seconds, count)) in spent {
        println!("{sensor}: {:.3} ms a frame ({count} frames)", 1e3 * seconds / f64::from(count));
    }
}

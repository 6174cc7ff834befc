//! A drive through streets, and what its grid is worth: `outdoors PATH [--outdoor] [--set KEY=VALUE]... [--out PICTURE.png] [--every N]`.
//!
//! `--outdoor` begins with that preset's defaults, as a session with a lidar that sees far does.
//! PATH is a recording of a 3D lidar; KITTI's labels (`label_02.txt`, `calib.txt`) beside it are boxes that the grid has to show. Printed
//! are how wide the map is; of the known cells within a metre of the driven way how many are occupied, which it drove over; how many of
//! fifty goals on that way are reached from its start; how many labelled things that stand within 30 m the grid shows; precision and recall
//! of its occupied cells (`cells.rs`; `OUTDOORS_WRONG=1` lists those that are wrong or missed); the
//! processor time of a scan on one thread, map and objects included; and that of a keyframe in each layer.

mod cells;
mod labels;

use labels::{labels, shown, told};
use nalgebra::Point2;
use percept_formats::dataset;
use percept_geometry::{Cell, KeyframeScan, Pose, SensorData};
use percept_mapping::{DenseGrid, KeyframeView, Layer, MapParams, Occupancy};
use percept_pipeline::{Pipeline, PipelineParams, Preset};
use percept_planning::{PlanOutcome, plan_dense};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

pub(crate) type Failure = Box<dyn Error + Send + Sync>;

/// Cells from this on are occupied, per cent: what planning takes.
pub(crate) const OCCUPIED: i8 = 60;
/// Goals along the way.
const GOALS: usize = 50;

/// Keyframes, and where they are in the map.
type Seen = Vec<(Pose, Arc<KeyframeScan>)>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let path =
        args.first().ok_or("usage: outdoors PATH [--outdoor] [--set KEY=VALUE]... [--out PICTURE.png] [--every N]")?;
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let every: usize = after("--every").map_or(Ok(1), |v| v.parse())?;
    let preset = if args.iter().any(|a| a == "--outdoor") { Preset::Outdoor } else { Preset::Auto };
    let mut tree = serde_json::to_value(PipelineParams::default().for_preset(preset))?;
    for (i, _) in args.iter().enumerate().filter(|(_, a)| *a == "--set") {
        let (key, value) = args.get(i + 1).and_then(|a| a.split_once('=')).ok_or("--set: write KEY=VALUE")?;
        let slot = tree.pointer_mut(&format!("/{}", key.replace('.', "/"))).ok_or("--set: no such parameter")?;
        *slot = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    let recording = dataset::open(Path::new(path.as_str()))?;
    let mut pipeline = Pipeline::new(serde_json::from_value(tree)?)?;
    recording.sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let t_base_lidar = recording.sensors.first().map_or_else(Pose::identity, |s| s.t_base_sensor);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (ms, t_map_lidars, keyframes) = pool.install(|| -> Result<_, Failure> {
        let (mut ms, mut poses, mut keyframes) = (vec![], BTreeMap::new(), vec![]);
        for (number, frame) in recording.frames(None).enumerate().filter(|(n, _)| n % every.max(1) == 0) {
            let frame = frame?;
            let is_cloud = matches!(frame.data, SensorData::Cloud(_));
            let before = processor_ms();
            let report = pipeline.process(&frame)?;
            if is_cloud {
                ms.push(processor_ms() - before);
                poses.extend(report.pose.map(|p| (number, p.t_map_base * t_base_lidar)));
            }
            keyframes.extend(report.keyframe.map(|k| (k.info.t_map_base, k.scan)));
        }
        Ok((ms, poses, keyframes))
    })?;
    pipeline.settle();
    let snapshot = pipeline.snapshot();
    let way: Vec<Point2<f64>> = snapshot.trajectory().map(|(t, _)| t.translation.vector.xy().into()).collect();
    let grid = snapshot.layers.occupancy.dense(100_000_000)?;
    let resolution = grid.geometry.resolution_m;
    let length: f64 = way.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    println!(
        "{path}: {} scans, {length:.1} m; {} keyframes; map of {:.1} m x {:.1} m, cells of {resolution} m",
        ms.len(),
        snapshot.keyframes.len(),
        grid.width as f64 * resolution,
        grid.height as f64 * resolution
    );
    println!("  ms of processor time a scan: {}", times(ms));
    println!("  layers take {:.1} MB", snapshot.memory.map.layers as f64 * 1e-6);
    pool.install(|| by_layer(&snapshot.params.map, &keyframes));
    let (known, occupied) = beside(&grid, &way, 1.0);
    println!(
        "  within 1 m of the way {known} cells known, {:.2} % occupied",
        100.0 * occupied as f64 / known.max(1) as f64
    );
    let (num_known, num_occupied) = (
        grid.cells.iter().filter(|c| **c >= 0).count() as f64 * resolution * resolution,
        grid.cells.iter().filter(|c| **c >= OCCUPIED).count() as f64 * resolution * resolution,
    );
    println!("  known {num_known:.0} square metres, of which {num_occupied:.0} occupied");
    let mut reasons: BTreeMap<String, usize> = BTreeMap::new();
    for i in 1..=GOALS {
        let goal = way[(way.len() - 1) * i / GOALS];
        let said = match plan_dense(&grid, way[0], goal, &snapshot.params.planning)? {
            PlanOutcome::Path(_) => "reached".to_owned(),
            PlanOutcome::NoPath { reason, .. } => {
                let (at, away) = nearest_occupied(&grid, &goal);
                println!(
                    "  not reached: {:.1} {:.1}, {reason:?}; {away:.2} m from what stands at {:.2} {:.2}",
                    goal.x, goal.y, at.x, at.y
                );
                format!("{reason:?}")
            }
        };
        *reasons.entry(said).or_default() += 1;
    }
    println!("  goals on the way: {reasons:?}");
    let labels = labels(Path::new(path.as_str()))?;
    if !labels.is_empty() {
        for (class, (shown, all, missed)) in shown(&grid, &labels, &t_map_lidars, &way) {
            println!(
                "  {class}: {shown} of {all} shown{}",
                if missed.is_empty() { String::new() } else { format!(", not {missed:?}") }
            );
        }
    }
    let there = snapshot.objects.iter().filter(|o| o.state != percept_scene::ObjectState::Gone);
    let there: Vec<_> = there.map(|o| (Point2::from(o.bbox.center().coords.xy()), o.class.name().to_owned())).collect();
    let objects: Vec<_> = there.iter().map(|(at, class)| (*at, class.as_str())).collect();
    let mut counts = BTreeMap::<&str, usize>::new();
    objects.iter().for_each(|(_, class)| *counts.entry(class).or_default() += 1);
    println!("  objects: {counts:?}");
    for (class, (found, by_name, all)) in told(&objects, &labels, &t_map_lidars, &way) {
        println!("  {class}: {found} of {all} among them, {by_name} by that name");
    }
    let mut points = cells::Points::default();
    for (number, frame) in recording.frames(None).enumerate() {
        if let (SensorData::Cloud(cloud), Some(t)) = (frame?.data, t_map_lidars.get(&number)) {
            points.add(number, t, &cloud.positions);
        }
    }
    cells::judge(&grid, &points, &labels, &t_map_lidars, &way);
    if let Some(out) = after("--out") {
        picture(&grid, &way, Path::new(out))?;
    }
    Ok(())
}

/// Prints what keyframes take in each layer.
fn by_layer(params: &MapParams, keyframes: &Seen) {
    println!("  ms of processor time a keyframe:");
    layer::<percept_mapping::OccupancyGrid>("occupancy", &params.occupancy, keyframes);
    layer::<percept_mapping::FusedCloud>("cloud", &params.cloud, keyframes);
    if params.voxels.enabled {
        layer::<percept_mapping::VoxelGrid>("voxels", &params.voxels, keyframes);
    }
    if params.height.enabled {
        layer::<percept_mapping::HeightGrid>("height", &params.height, keyframes);
    }
    if params.surface.enabled {
        layer::<percept_mapping::SurfaceGrid>("surface", &params.surface, keyframes);
    }
}

fn layer<L: Layer>(name: &str, params: &L::Params, keyframes: &Seen) {
    let (mut part, mut ms) = (L::new(params), vec![]);
    for (t_map_base, scan) in keyframes {
        let before = processor_ms();
        let update = L::prepare(params, &KeyframeView::new(t_map_base, scan));
        part.add(&update);
        ms.push(processor_ms() - before);
    }
    println!("    {name}: {}", times(ms));
}

/// The centre of the occupied cell nearest to a place, and how far that is.
fn nearest_occupied(grid: &DenseGrid, p: &Point2<f64>) -> (Point2<f64>, f64) {
    let center = |i: usize| grid.geometry.center(Cell::new((i % grid.width) as i32, (i / grid.width) as i32));
    let occupied = grid.cells.iter().enumerate().filter(|(_, c)| **c >= OCCUPIED).map(|(i, _)| center(i));
    let nearest = occupied.map(|at| (at, (at - p).norm())).min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.unwrap_or((*p, f64::INFINITY))
}

/// Known cells within a distance of the way, and those of them that are occupied.
fn beside(grid: &DenseGrid, way: &[Point2<f64>], within_m: f64) -> (usize, usize) {
    let mut near = vec![false; grid.cells.len()];
    let reach = (within_m / grid.geometry.resolution_m).ceil() as i32;
    for p in way {
        let Some(cell) = grid.geometry.cell(p) else { continue };
        for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
            let c = Cell::new(cell.x + dx, cell.y + dy);
            if let Some(i) = grid.index(c).filter(|_| (grid.geometry.center(c) - p).norm() <= within_m) {
                near[i] = true;
            }
        }
    }
    let cells = || grid.cells.iter().zip(&near).filter(|(c, near)| **near && **c >= 0);
    (cells().count(), cells().filter(|(c, _)| **c >= OCCUPIED).count())
}

/// The grid, north up: white free, black occupied, the way red.
fn picture(grid: &DenseGrid, way: &[Point2<f64>], out: &Path) -> Result<(), Failure> {
    let mut pixels = vec![[128u8; 3]; grid.width * grid.height];
    for (i, &c) in grid.cells.iter().enumerate().filter(|(_, c)| **c >= 0) {
        let at = (grid.height - 1 - i / grid.width) * grid.width + i % grid.width;
        pixels[at] = [255 - (f32::from(c) * 2.55) as u8; 3];
    }
    for cell in way.iter().filter_map(|p| grid.geometry.cell(p)) {
        if let Some(i) = grid.index(cell) {
            pixels[(grid.height - 1 - i / grid.width) * grid.width + i % grid.width] = [255, 0, 0];
        }
    }
    let image = percept_geometry::RgbImage::new(grid.width, grid.height, pixels.concat())?;
    Ok(std::fs::write(out, percept_formats::images::encode_rgb_png(&image)?)?)
}

/// Of this thread so far, milliseconds.
fn processor_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

fn times(mut ms: Vec<f64>) -> String {
    ms.sort_by(f64::total_cmp);
    let at = |q: f64| ms.get((ms.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or(0.0);
    let mean = ms.iter().sum::<f64>() / ms.len().max(1) as f64;
    format!("mean {mean:.1}  p50 {:.1}  p99 {:.1}  max {:.1}", at(0.5), at(0.99), at(1.0))
}

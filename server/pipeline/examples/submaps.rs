//! A map of submaps beside the one that is built at once from the same keyframes at the same poses: how far they agree right
//! after a correction and at the end, how far either is from the truth, what that costs, what it takes in memory.
//!
//! `submaps carmen LOG [SECONDS]` (a CARMEN log with FLASER rows), or
//! `submaps sim lidar2d|lidar3d|rgbd ROOMS SECONDS [SEED [BUDGET_MB]]`; with a budget the rest goes to a store in memory.

use nalgebra::{Point2, Point3};
use percept_evaluation::{score_cloud, score_occupancy};
use percept_geometry::{
    KeyframeId, KeyframeScan, LaserScan, PointCloud, Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec,
    Timestamp, se3, sensor::OdometrySample,
};
use percept_mapping::{BlobId, FusedCloud, MapStore, MappingError, Occupancy, OccupancyGrid};
use percept_pipeline::{Executor, Pipeline, PipelineParams, Snapshot};
use percept_scene::{Object, ObjectState};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use std::collections::{BTreeMap, HashSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    // One thread, whose time is counted: other work on the machine does not show.
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| measure().map_err(|e| e.to_string()))?;
    Ok(())
}

/// Does what is done beside frames, on a thread of its own.
struct Beside;

impl Executor for Beside {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        std::thread::spawn(work);
    }
}

/// Time that this thread has computed, milliseconds.
fn cpu_ms() -> f64 {
    // A nap brings the count up to date.
    std::thread::sleep(std::time::Duration::from_micros(1));
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) / 1e6
}

fn measure() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    let arg = |i: usize| args.get(i).map(String::as_str);
    let mut run = Run::new(Pipeline::new(PipelineParams::default())?);
    run.pipeline.work_beside_frames(Arc::new(Beside));
    match arg(1) {
        Some("carmen") => {
            let seconds = arg(3).map_or(Ok(f64::INFINITY), str::parse)?;
            let (sensors, frames) = carmen(&std::fs::read_to_string(arg(2).ok_or("which log?")?)?, seconds);
            sensors.into_iter().for_each(|s| run.pipeline.declare_sensor(s));
            frames.iter().for_each(|f| run.frame(f));
        }
        Some("sim") => {
            let sensors = match arg(2).unwrap_or("lidar2d") {
                "lidar3d" => SensorSuite::only_lidar3d(),
                "rgbd" => SensorSuite::default(),
                _ => SensorSuite { odometry: SensorSuite::default().odometry, ..SensorSuite::only_lidar2d() },
            };
            let (rooms, seconds) = (arg(3).unwrap_or("4").parse()?, arg(4).unwrap_or("120").parse()?);
            let seed = arg(5).unwrap_or("1").parse()?;
            let world = WorldParams { seed, rooms, ..WorldParams::default() };
            let params = SimParams { world, sensors, duration_s: Some(seconds), seed, ..SimParams::default() };
            let simulation = Simulation::new(params)?;
            if let Some(megabytes) = arg(6) {
                run.shelf.max_bytes.store(megabytes.parse::<usize>()? * 1_000_000, Ordering::Relaxed);
                run.pipeline.set_map_store(Arc::clone(&run.shelf) as Arc<dyn MapStore>);
            }
            simulation.sensors().into_iter().for_each(|s| run.pipeline.declare_sensor(s));
            simulation.frames().for_each(|f| run.frame(&f.frame));
            run.finish();
            return run.against_truth(&simulation);
        }
        _ => return Err("usage: submaps carmen LOG [SECONDS] | sim lidar2d|lidar3d|rgbd ROOMS SECONDS [SEED]".into()),
    }
    run.finish();
    Ok(())
}

/// Keeps in memory what the map has no room for.
#[derive(Debug, Default)]
struct Shelf {
    blobs: Mutex<BTreeMap<BlobId, Vec<u8>>>,
    scans: Mutex<BTreeMap<KeyframeId, Arc<KeyframeScan>>>,
    max_bytes: AtomicUsize,
}

impl MapStore for Shelf {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let mut blobs = self.blobs.lock().ok()?;
        let mut id = BlobId([0; 32]);
        id.0[..8].copy_from_slice(&(blobs.len() as u64).to_le_bytes());
        blobs.insert(id, bytes.to_vec());
        Some(id)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        self.blobs.lock().ok()?.get(id).cloned()
    }

    fn max_bytes(&self) -> usize {
        self.max_bytes.load(Ordering::Relaxed)
    }
}

impl Shelf {
    fn scan(&self, id: KeyframeId) -> Option<Arc<KeyframeScan>> {
        self.scans.lock().ok()?.get(&id).cloned()
    }
}

/// Corrections whose maps are compared with the one built at once: that takes a while.
const COMPARED: usize = 6;

struct Run {
    pipeline: Pipeline,
    shelf: Arc<Shelf>,
    milliseconds: Vec<f64>,
    /// The most that the map took in memory after a frame.
    most_bytes: usize,
    num_corrections: usize,
    compared: Vec<(f64, String)>,
}

impl Run {
    fn new(pipeline: Pipeline) -> Self {
        Self {
            pipeline,
            shelf: Arc::default(),
            milliseconds: vec![],
            most_bytes: 0,
            num_corrections: 0,
            compared: vec![],
        }
    }

    fn frame(&mut self, frame: &SensorFrame) {
        let before = self.pipeline.snapshot();
        let start = cpu_ms();
        let Ok(report) = self.pipeline.process(frame) else { return };
        if report.pose.is_some() {
            self.milliseconds.push(cpu_ms() - start);
        }
        if let Ok(mut scans) = self.shelf.scans.lock() {
            scans.extend(report.keyframe.iter().chain(&report.joined).map(|k| (k.info.id, Arc::clone(&k.scan))));
        }
        if report.keyframe.is_some() {
            self.most_bytes = self.most_bytes.max(self.pipeline.memory().map.total());
        }
        if report.map.corrected.is_empty() {
            return;
        }
        self.num_corrections += 1;
        let moved = |(id, t): (&KeyframeId, &Pose)| {
            let was = before.keyframes.get(id.0 as usize)?.t_map_base;
            Some((was.translation.vector - t.translation.vector).norm())
        };
        let most = report.map.corrected.iter().filter_map(moved).fold(0.0, f64::max);
        // The largest are told.
        let least = self.compared.iter().map(|c| c.0).fold(f64::INFINITY, f64::min);
        if self.compared.len() < COMPARED || most > 1.5 * least {
            let told = format!(
                "moved by {most:.3} m in {:6.1} ms: {}",
                self.milliseconds.last().unwrap_or(&0.0),
                self.compare()
            );
            self.compared.push((most, told));
            self.compared.sort_by(|a, b| b.0.total_cmp(&a.0));
            self.compared.truncate(COMPARED);
        }
    }

    /// What is shown now beside what would be built at once.
    fn compare(&self) -> String {
        let shown = self.pipeline.snapshot();
        let start = cpu_ms();
        let (known, points) = (shown.layers.occupancy.num_known(), shown.layers.cloud.len());
        let composing = cpu_ms() - start;
        let start = cpu_ms();
        let Ok((grid, cloud)) = self.at_once(&shown) else { return "not built".into() };
        let building = cpu_ms() - start;
        format!(
            "composed in {composing:.0} ms (built in {building:.0}); {known} cells of {}: {}; points {points} of {}",
            grid.num_known(),
            agreement(&shown.layers.occupancy, &grid),
            cloud.len()
        )
    }

    fn at_once(&self, shown: &Snapshot) -> Result<(OccupancyGrid, FusedCloud), MappingError> {
        let params = shown.params.map;
        let (mut grid, mut cloud) = (OccupancyGrid::new(params.occupancy)?, FusedCloud::new(params.cloud)?);
        for k in shown.living_keyframes() {
            if let Some(scan) = self.shelf.scan(k.id) {
                grid.integrate(&k.t_map_base, &scan)?;
                cloud.integrate(&k.t_map_base, &scan)?;
            }
        }
        Ok((grid, cloud))
    }

    /// Both maps beside the world that was seen.
    fn against_truth(&self, simulation: &Simulation) -> Result<(), Failure> {
        let shown = self.pipeline.snapshot();
        let truth = simulation.objects_at(shown.pose.as_ref().map(|p| p.stamp).unwrap_or_default());
        let is_right = |o: &&Object| {
            let center = simulation.t_world_start() * o.bbox.center();
            truth.iter().any(|t| t.class == o.class && (t.bbox.center() - center).norm() < 0.5)
        };
        let found = || shown.objects.iter().filter(|o| o.state != ObjectState::Gone);
        println!("{} objects, {} of a true one's class and place", found().count(), found().filter(is_right).count());
        let (grid, cloud) = self.at_once(&shown)?;
        println!("shown:       {}", scores(simulation, &shown.layers.occupancy, &shown.layers.cloud.to_cloud())?);
        println!("at once:     {}", scores(simulation, &grid, &cloud.to_cloud())?);
        Ok(())
    }

    fn finish(&mut self) {
        for (_, told) in &self.compared {
            println!("{told}");
        }
        println!("at the end:  {}", self.compare());
        let start = cpu_ms();
        self.pipeline.settle();
        println!("settling took {:.0} ms", cpu_ms() - start);
        println!("settled:     {}", self.compare());
        self.milliseconds.sort_by(f64::total_cmp);
        let at =
            |q: f64| self.milliseconds.get(((self.milliseconds.len() - 1) as f64 * q) as usize).copied().unwrap_or(0.0);
        let (snapshot, memory) = (self.pipeline.snapshot(), self.pipeline.memory().map);
        println!(
            "{} frames, ms p50 {:.1} p99 {:.1} max {:.1}; {} keyframes in {} submaps, {} corrections; MB: scans {:.1} layers {:.1} tiles {:.1}, at most {:.1} together",
            self.milliseconds.len(),
            at(0.5),
            at(0.99),
            at(1.0),
            snapshot.living_keyframes().count(),
            self.pipeline.submaps().len(),
            self.num_corrections,
            memory.scans as f64 / 1e6,
            memory.layers as f64 / 1e6,
            memory.tiles as f64 / 1e6,
            self.most_bytes as f64 / 1e6
        );
    }
}

/// Beside the true world: occupied cells to within 0.1 m (walls that nobody saw count as missed), points within 0.05 m.
fn scores(simulation: &Simulation, grid: &impl Occupancy, cloud: &PointCloud) -> Result<String, Failure> {
    let truth = simulation.world().occupancy(0.05, (0.1, 1.8))?;
    let t_world_map = simulation.t_world_start();
    let t_map_world = t_world_map.inverse();
    let Some((min, max)) = grid.bounds() else { return Ok("nothing".into()) };
    let dense = grid.region(min, max, 1 << 28)?;
    let state = |x: usize, y: usize| {
        let center = truth.geometry.center(percept_geometry::Cell::new(x as i32, y as i32));
        let p = (t_map_world * Point3::new(center.x, center.y, 0.0)).xy();
        let cell = dense.geometry.cell(&Point2::new(p.x, p.y))?;
        dense.value(cell)?.map(|percent| percent >= 60)
    };
    let cells = || (0..truth.height).flat_map(|y| (0..truth.width).map(move |x| (x, y)));
    let estimate: Vec<Option<bool>> = cells().map(|(x, y)| state(x, y)).collect();
    let is_known: Vec<Option<bool>> = truth.cells.iter().map(|c| Some(*c)).collect();
    let g = score_occupancy(truth.width, &is_known, &estimate, 2)?;
    let distance = |p: &Point3<f32>| simulation.world().surface_distance(&(t_world_map * p.cast::<f64>()));
    let distances: Vec<f64> = cloud.positions.iter().map(distance).collect();
    let c = score_cloud(&distances, &[], 0.05)?;
    let f = |p: Option<f64>, r: Option<f64>| p.zip(r).map(|(p, r)| 2.0 * p * r / (p + r)).unwrap_or(0.0);
    let share = |v: Option<f64>| v.unwrap_or(f64::NAN);
    Ok(format!(
        "cells right {:.4} found {:.4} F {:.4}, free right {:.4}, unknown {:.4}; {} points, right {:.4}, rms {:.4} m",
        share(g.precision),
        share(g.recall),
        f(g.precision, g.recall),
        share(g.free_accuracy),
        share(g.unknown_share),
        cloud.positions.len(),
        share(c.precision),
        c.accuracy_m.map_or(f64::NAN, |s| s.rmse)
    ))
}

/// Of the cells known in `b`: the share on which `a` agrees whether they are occupied, free or neither; of the occupied ones
/// of each the share that is occupied there and, in brackets, there or in a cell beside.
fn agreement(a: &impl Occupancy, b: &OccupancyGrid) -> String {
    let Some((min, max)) = b.bounds() else { return "nothing".into() };
    let (Ok(ours), Ok(theirs)) = (a.region(min, max, 1 << 28), b.region(min, max, 1 << 28)) else {
        return "too large".into();
    };
    let state = |v: i8| if v < 0 { -1 } else { i32::from(v >= 60) * 2 + i32::from(v > 40 && v < 60) };
    let pairs: Vec<(i32, i32)> = ours.cells.iter().zip(&theirs.cells).map(|(a, b)| (state(*a), state(*b))).collect();
    let known = pairs.iter().filter(|p| p.1 >= 0).count();
    let same = pairs.iter().filter(|p| p.1 >= 0 && p.0 == p.1).count();
    let occupied = |of: &dyn Fn(&(i32, i32)) -> i32| -> HashSet<usize> {
        (0..pairs.len()).filter(|i| of(&pairs[*i]) == 2).collect()
    };
    let (ours_on, theirs_on) = (occupied(&|p| p.0), occupied(&|p| p.1));
    let width = theirs.width as i64;
    let beside = |i: usize, on: &HashSet<usize>| {
        (-1..=1).flat_map(|y| (-1..=1).map(move |x| i as i64 + y * width + x)).any(|j| on.contains(&(j as usize)))
    };
    let share = |from: &HashSet<usize>, on: &HashSet<usize>| {
        let n = from.len().max(1) as f64;
        let exact = from.iter().filter(|i| on.contains(i)).count() as f64 / n;
        (exact, from.iter().filter(|i| beside(**i, on)).count() as f64 / n)
    };
    let (recall, precision) = (share(&theirs_on, &ours_on), share(&ours_on, &theirs_on));
    // Free here and occupied there: what a planner would drive through.
    let lost = pairs.iter().filter(|p| p.1 == 2 && p.0 == 0).count();
    format!(
        "same {:.4}, occupied {} of {}: found {:.3} ({:.4}), right {:.3} ({:.4}), freed {lost}",
        same as f64 / known.max(1) as f64,
        ours_on.len(),
        theirs_on.len(),
        recall.0,
        recall.1,
        precision.0,
        precision.1
    )
}

/// Scans with the wheels' poses. Rows follow the motion; their stamps are dealt out again in rising order.
fn carmen(text: &str, seconds: f64) -> (Vec<SensorSpec>, Vec<SensorFrame>) {
    let rows = text.lines().filter(|l| l.starts_with("FLASER"));
    let rows: Vec<Vec<f64>> =
        rows.map(|l| l.split_whitespace().skip(1).map(|w| w.parse().unwrap_or(0.0)).collect()).collect();
    let mut stamps: Vec<f64> = rows.iter().filter_map(|f| f.get(f[0] as usize + 7).copied()).collect();
    stamps.sort_by(f64::total_cmp);
    let first = stamps.first().copied().unwrap_or(0.0);
    let spec = |id: &str, kind| SensorSpec {
        id: id.into(),
        kind,
        t_base_sensor: Pose::identity(),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let sensors = vec![spec("lidar", SensorKind::Lidar2d), spec("wheels", SensorKind::Odometry)];
    let mut frames = vec![];
    for (f, stamp) in rows.iter().zip(stamps).take_while(|(_, s)| s - first <= seconds) {
        let n = f[0] as usize;
        let increment = if n <= 181 { 1f64 } else { 0.5 };
        let scan = LaserScan {
            angle_min_rad: -std::f64::consts::FRAC_PI_2,
            angle_increment_rad: increment.to_radians(),
            range_min_m: 0.05,
            range_max_m: 80.0,
            time_increment_s: 0.0,
            ranges_m: f[1..=n].iter().map(|r| *r as f32).collect(),
            intensities: None,
            later_echoes_m: vec![],
        };
        let sample = OdometrySample { t_odom_base: se3::from_xy_yaw(f[n + 4], f[n + 5], f[n + 6]), covariance: None };
        let stamp = Timestamp::from_secs_f64(stamp);
        frames.push(SensorFrame { sensor: SensorId::from("wheels"), stamp, data: SensorData::Odometry(sample) });
        frames.push(SensorFrame { sensor: SensorId::from("lidar"), stamp, data: SensorData::Scan(scan) });
    }
    (sensors, frames)
}

//! A long session in many rooms: what a frame takes at the end as at the start, what memory, whether what is decided about all
//! of the map is shown soon, how far the trajectory is off, and which loops are false.
//!
//! `scale lidar2d|lidar3d|rgbd ROOMS MINUTES [--seed N] [--room-m M] [--speed MPS] [--turn RADPS] [--budget-mb N] [--no-objects] [--alone] [--layers] [--paced]`
//!
//! Rooms are 4.4 to 6 m wide, or within a tenth of `--room-m`. With a budget, what the map has no room for goes into a file. `--layers` keeps voxels, surface and heights, too. Each
//! tenth of the session is a row; times of frames are those that their thread computes, and with them the clock's in
//! brackets, which hold what frames wait for: frames come here faster than a robot's, unless they are `--paced`.

use percept_evaluation::{Alignment, PosePair, absolute_error};
use percept_geometry::{KeyframeId, Pose, SensorData, SensorFrame, Timestamp};
use percept_mapping::{BlobId, MapStore, Occupancy};
use percept_pipeline::{Executor, FrameReport, Loop, LoopId, LoopState, Pipeline, PipelineParams, Snapshot};
use percept_sim::{MainSensor, Scenario, SimFrame, Simulation};
use rustix::time::{ClockId, clock_gettime};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The server's: with the system's, memory that was given back stays with the process.
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

type Failure = Box<dyn std::error::Error>;

/// A loop is right if it is this near to the truth, metres and radians.
const RIGHT: (f64, f64) = (0.5, 0.35);
/// Corrections of all the map after which it is read as a whole, at most.
const READ: usize = 8;

fn main() -> Result<(), Failure> {
    let args = Args::parse(std::env::args().skip(1))?;
    // One thread, whose time is counted: other work on the machine does not show.
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| run(&args).map_err(|e| e.to_string()))?;
    Ok(())
}

struct Args {
    sensor: MainSensor,
    rooms: usize,
    minutes: f64,
    seed: u64,
    room_m: Option<f64>,
    speed: Option<f64>,
    turn: Option<f64>,
    budget_mb: Option<usize>,
    no_objects: bool,
    alone: bool,
    layers: bool,
    paced: bool,
}

impl Args {
    fn parse(mut args: impl Iterator<Item = String>) -> Result<Self, Failure> {
        let usage = "usage: scale lidar2d|lidar3d|rgbd ROOMS MINUTES [--seed N] [--room-m M] [--speed MPS] [--turn RADPS] [--budget-mb N] [--no-objects] [--alone] [--layers] [--paced]";
        let mut next = || args.next().ok_or(usage);
        let sensor = match next()?.as_str() {
            "lidar2d" => MainSensor::Lidar2d,
            "lidar3d" => MainSensor::Lidar3d,
            "rgbd" => MainSensor::Rgbd,
            _ => return Err(usage.into()),
        };
        let (rooms, minutes) = (next()?.parse()?, next()?.parse()?);
        let mut out = Self {
            sensor,
            rooms,
            minutes,
            seed: 1,
            room_m: None,
            speed: None,
            turn: None,
            budget_mb: None,
            no_objects: false,
            alone: false,
            layers: false,
            paced: false,
        };
        while let Ok(flag) = next() {
            match flag.as_str() {
                "--seed" => out.seed = next()?.parse()?,
                "--room-m" => out.room_m = Some(next()?.parse()?),
                "--speed" => out.speed = Some(next()?.parse()?),
                "--turn" => out.turn = Some(next()?.parse()?),
                "--budget-mb" => out.budget_mb = Some(next()?.parse()?),
                "--no-objects" => out.no_objects = true,
                "--alone" => out.alone = true,
                "--layers" => out.layers = true,
                "--paced" => out.paced = true,
                _ => return Err(usage.into()),
            }
        }
        Ok(out)
    }

    fn simulation(&self) -> Result<Simulation, Failure> {
        let mut params = Scenario::Loops.params(self.sensor, self.rooms, 60.0 * self.minutes, self.seed)?;
        if let Some(room_m) = self.room_m {
            (params.world.room_min_m, params.world.room_max_m) = (0.9 * room_m, 1.1 * room_m);
        }
        if let Some(speed) = self.speed {
            params.robot.speed_m_per_s = speed;
        }
        if let Some(turn) = self.turn {
            (params.robot.turn_rate_rad_per_s, params.robot.turn_acceleration_rad_per_s2) = (turn, 2.0 * turn);
        }
        if self.alone {
            (params.sensors.odometry, params.sensors.imu) = (None, None);
        }
        Ok(Simulation::new(params)?)
    }
}

/// Time that this thread has computed, milliseconds.
fn cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

/// Resident memory of this process, megabytes (Linux; pages of 4 KiB).
fn rss_mb() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split_whitespace().nth(1).and_then(|pages| pages.parse::<f64>().ok()).unwrap_or(0.0) * 4096.0 / 1e6
}

/// Does what is done beside frames, on threads of its own, and counts its time. Frames come here faster than a robot's, so that
/// they would do it themselves before a thread has woken: it has begun when it is told to, while a thread is free.
struct Beside {
    pool: rayon::ThreadPool,
    /// Batches that are not done.
    open: Arc<AtomicUsize>,
    /// What each batch took, milliseconds, and how many keyframes there were.
    batches: Arc<Mutex<Vec<(f64, usize)>>>,
    num_keyframes: Arc<AtomicUsize>,
}

impl Executor for Beside {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        let (batches, num_keyframes) = (Arc::clone(&self.batches), Arc::clone(&self.num_keyframes));
        let (begun, begins) = std::sync::mpsc::sync_channel(1);
        let open = Arc::clone(&self.open);
        let is_free = open.fetch_add(1, Ordering::Relaxed) < self.pool.current_num_threads();
        self.pool.spawn(move || {
            let _ = begun.send(());
            let start = cpu_ms();
            work();
            open.fetch_sub(1, Ordering::Relaxed);
            if let Ok(mut batches) = batches.lock() {
                batches.push((cpu_ms() - start, num_keyframes.load(Ordering::Relaxed)));
            }
        });
        if is_free {
            let _ = begins.recv();
        }
    }
}

/// A file for what the map has no room for.
#[derive(Debug)]
struct Shelf {
    file: File,
    /// Offset and length by name, and the end.
    places: Mutex<(Vec<(u64, usize)>, u64)>,
    max_bytes: usize,
}

impl Shelf {
    fn new(max_bytes: usize) -> Result<Self, Failure> {
        let path = std::env::temp_dir().join(format!("percept-scale-{}", std::process::id()));
        let file = File::options().read(true).write(true).create_new(true).open(&path)?;
        std::fs::remove_file(&path)?;
        Ok(Self { file, max_bytes, places: Mutex::default() })
    }
}

impl MapStore for Shelf {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let mut places = self.places.lock().ok()?;
        let (all, end) = &mut *places;
        self.file.write_all_at(bytes, *end).ok()?;
        let mut id = BlobId([0; 32]);
        id.0[..8].copy_from_slice(&(all.len() as u64).to_le_bytes());
        all.push((*end, bytes.len()));
        *end += bytes.len() as u64;
        Some(id)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        let number = u64::from_le_bytes(id.0[..8].try_into().ok()?) as usize;
        let (offset, length) = *self.places.lock().ok()?.0.get(number)?;
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, offset).ok()?;
        Some(bytes)
    }

    fn max_bytes(&self) -> usize {
        self.max_bytes
    }
}

/// What was measured.
struct Session {
    pipeline: Pipeline,
    batches: Arc<Mutex<Vec<(f64, usize)>>>,
    num_keyframes: Arc<AtomicUsize>,
    t_start_world: Pose,
    truth: Vec<(Timestamp, Pose)>,
    /// Of registered frames of this tenth: computed and by the clock, milliseconds.
    times: Vec<(f64, f64)>,
    first_batch: usize,
    worst: (f64, f64),
    num_tracked: usize,
    believed: BTreeMap<LoopId, Loop>,
    /// How far the most of the map was moved, and what it took to read all of it afterwards.
    corrections: Vec<(f64, String)>,
    num_corrections: usize,
}

fn run(args: &Args) -> Result<(), Failure> {
    let simulation = args.simulation()?;
    let extent = simulation.world().extent();
    println!(
        "{} rooms, {:.0} x {:.0} m, a lap takes {:.0} s and {:.0} m; {:.0} s; MB {:.0} before the first frame",
        args.rooms,
        extent.x,
        extent.y,
        simulation.path().lap_duration_s(),
        simulation.path().lap_length_m(),
        simulation.duration_s(),
        rss_mb()
    );
    let mut params = PipelineParams::default();
    params.detection.enabled &= !args.no_objects;
    let map = &mut params.map;
    for layer in [&mut map.voxels.enabled, &mut map.surface.enabled, &mut map.height.enabled] {
        *layer |= args.layers;
    }
    let mut pipeline = Pipeline::new(params)?;
    let (batches, num_keyframes) = (Arc::default(), Arc::default());
    pipeline.work_beside_frames(Arc::new(Beside {
        // One for the graph, one for objects.
        pool: rayon::ThreadPoolBuilder::new().num_threads(2).build()?,
        open: Arc::default(),
        batches: Arc::clone(&batches),
        num_keyframes: Arc::clone(&num_keyframes),
    }));
    if let Some(megabytes) = args.budget_mb {
        pipeline.set_map_store(Arc::new(Shelf::new(megabytes * 1_000_000)?));
    }
    simulation.sensors().into_iter().for_each(|s| pipeline.declare_sensor(s));
    let mut session = Session {
        pipeline,
        batches,
        num_keyframes,
        t_start_world: simulation.t_world_start().inverse(),
        truth: vec![],
        times: vec![],
        first_batch: 0,
        worst: (0.0, 0.0),
        num_tracked: 0,
        believed: BTreeMap::new(),
        corrections: vec![],
        num_corrections: 0,
    };
    let (mut tenth, begun) = (1, Instant::now());
    for frame in simulation.frames() {
        if frame.measured_s >= simulation.duration_s() * f64::from(tenth) / 10.0 {
            session.tell(tenth);
            tenth += 1;
        }
        if args.paced {
            let due = Duration::from_secs_f64(frame.measured_s);
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
        }
        session.frame(&frame);
    }
    session.tell(tenth);
    session.finish();
    Ok(())
}

impl Session {
    fn frame(&mut self, sim: &SimFrame) {
        let Some((report, computed, clock)) = self.process(&sim.frame) else { return };
        let active = report.map.loops.iter().filter(|l| l.state == LoopState::Active);
        self.believed.extend(active.map(|l| (l.id, l.clone())));
        if report.pose.is_some() {
            self.times.push((computed, clock));
            self.worst = (self.worst.0.max(computed), self.worst.1.max(clock));
            self.truth.push((sim.frame.stamp, self.t_start_world * sim.t_world_base));
        }
        self.num_tracked += usize::from(report.trajectory.is_some_and(|t| t.tracked));
    }

    fn process(&mut self, frame: &SensorFrame) -> Option<(FrameReport, f64, f64)> {
        if !matches!(frame.data, SensorData::Scan(_) | SensorData::Cloud(_) | SensorData::Rgbd(..)) {
            return self.pipeline.process(frame).ok().map(|report| (report, 0.0, 0.0));
        }
        // Readers hold the moment before, as in a server.
        let before = self.pipeline.snapshot();
        let (start, at) = (cpu_ms(), Instant::now());
        let report = self.pipeline.process(frame).ok()?;
        let clock = at.elapsed().as_secs_f64() * 1e3;
        let computed = cpu_ms() - start;
        if report.keyframe.is_some() {
            self.num_keyframes.store(self.pipeline.snapshot().living_keyframes().count(), Ordering::Relaxed);
        }
        self.note_correction(&before, &report, computed);
        Some((report, computed, clock))
    }

    /// Reads all of the map after corrections of most of it.
    fn note_correction(&mut self, before: &Snapshot, report: &FrameReport, computed: f64) {
        let corrected = &report.map.corrected;
        self.num_corrections += usize::from(!corrected.is_empty());
        if 2 * corrected.len() < before.living_keyframes().count() {
            return;
        }
        let moved = |(id, t): (&KeyframeId, &Pose)| {
            let was = before.keyframes.get(id.0 as usize)?.t_map_base;
            Some((was.translation.vector - t.translation.vector).norm())
        };
        let most = corrected.iter().filter_map(moved).fold(0.0, f64::max);
        let least = self.corrections.iter().map(|c| c.0).fold(f64::INFINITY, f64::min);
        if self.corrections.len() >= READ && most < 1.2 * least {
            return;
        }
        let shown = self.pipeline.snapshot();
        let start = cpu_ms();
        let known = shown.layers.occupancy.num_known();
        let of_grid = cpu_ms() - start;
        let points = shown.layers.cloud.len();
        let told = format!(
            "{most:.3} m, {} keyframes: the frame {computed:.1} ms; {known} cells in {of_grid:.0} ms, {points} points in {:.0} ms",
            corrected.len(),
            cpu_ms() - start - of_grid
        );
        self.corrections.push((most, told));
        self.corrections.sort_by(|a, b| b.0.total_cmp(&a.0));
        self.corrections.truncate(READ);
    }

    fn tell(&mut self, tenth: u32) {
        let of = |pick: fn(&(f64, f64)) -> f64| {
            let mut all: Vec<f64> = self.times.iter().map(pick).collect();
            all.sort_by(f64::total_cmp);
            move |share: f64| all.get(((all.len().max(1) - 1) as f64 * share).round() as usize).copied().unwrap_or(0.0)
        };
        let (computed, clock) = (of(|t| t.0), of(|t| t.1));
        let batches: Vec<(f64, usize)> =
            self.batches.lock().map(|b| b[self.first_batch.min(b.len())..].to_vec()).unwrap_or_default();
        self.first_batch += batches.len();
        let took = batches.iter().map(|b| b.0).sum::<f64>();
        let worst = batches.iter().copied().fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
        let (snapshot, memory) = (self.pipeline.snapshot(), self.pipeline.memory());
        let [found, active, wrong] = self.loops(&snapshot);
        println!(
            "{tenth:2}: frame ms p50 {:.1} p99 {:.1} worst {:.1} ({:.1} {:.1} {:.1}); beside: {:.0} ms in {} batches, worst {:.0} at {} keyframes; MB {:.0}: scans {:.1} layers {:.1} tiles {:.1} places {:.1} graph {:.1} odometry {:.1}; keyframes {} submaps {}; loops {found} active {active} false {wrong}; ATE {:.3} m, worst {:.3}",
            computed(0.5),
            computed(0.99),
            computed(1.0),
            clock(0.5),
            clock(0.99),
            clock(1.0),
            took,
            batches.len(),
            worst.0,
            worst.1,
            rss_mb(),
            memory.map.scans as f64 / 1e6,
            memory.map.layers as f64 / 1e6,
            memory.map.tiles as f64 / 1e6,
            memory.places as f64 / 1e6,
            memory.graph as f64 / 1e6,
            memory.odometry as f64 / 1e6,
            snapshot.living_keyframes().count(),
            self.pipeline.submaps().len(),
            self.error(&snapshot).0,
            self.error(&snapshot).1,
        );
        self.times.clear();
    }

    /// Absolute error of the trajectory, corrected until now: root mean square and worst, metres.
    fn error(&self, snapshot: &Snapshot) -> (f64, f64) {
        let truth: HashMap<Timestamp, &Pose> = self.truth.iter().map(|(stamp, pose)| (*stamp, pose)).collect();
        let pairs: Vec<PosePair> = snapshot
            .trajectory_in_one_unit()
            .filter(|(_, e)| e.tracked)
            .filter_map(|(estimate, e)| Some(PosePair { stamp: e.stamp, reference: **truth.get(&e.stamp)?, estimate }))
            .collect();
        absolute_error(&pairs, Alignment::Se3)
            .map_or((f64::NAN, f64::NAN), |a| (a.translation_m.rmse, a.translation_m.max))
    }

    /// Loops found, believed now, and of all that ever were believed those that contradict the truth.
    fn loops(&self, snapshot: &Snapshot) -> [usize; 3] {
        let by_stamp: HashMap<Timestamp, &Pose> = self.truth.iter().map(|(stamp, pose)| (*stamp, pose)).collect();
        let truth = |id: KeyframeId| by_stamp.get(&snapshot.keyframes.get(usize::try_from(id.0).ok()?)?.stamp);
        let is_false = |l: &&Loop| {
            let (Some(from), Some(to)) = (truth(l.closure.from), truth(l.closure.to)) else { return false };
            let error = l.closure.t_from_to.inverse() * (from.inverse() * **to);
            error.translation.vector.norm() > RIGHT.0 || error.rotation.angle() > RIGHT.1
        };
        let active = snapshot.loops.iter().filter(|l| l.state == LoopState::Active).count();
        [snapshot.loops.len(), active, self.believed.values().filter(is_false).count()]
    }

    fn finish(&mut self) {
        println!(
            "{} frames, {} tracked; worst frame {:.1} ms ({:.1}); {} corrections, those of most of the map that moved it most:",
            self.truth.len(),
            self.num_tracked,
            self.worst.0,
            self.worst.1,
            self.num_corrections
        );
        self.corrections.iter().for_each(|(_, told)| println!("  {told}"));
        let start = cpu_ms();
        self.pipeline.settle();
        let snapshot = self.pipeline.snapshot();
        let (ate, worst) = self.error(&snapshot);
        // FNV-1a over all poses: two runs with the same trajectory say the same.
        let bytes = snapshot.trajectory().flat_map(|(t, _)| {
            let (p, q) = (t.translation.vector, t.rotation.coords);
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w].into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>()
        });
        let hash = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
        println!(
            "settled in {:.0} ms: ATE {ate:.4} m, worst {worst:.4}; trajectory {hash:016x}; MB {:.0}",
            cpu_ms() - start,
            rss_mb()
        );
    }
}

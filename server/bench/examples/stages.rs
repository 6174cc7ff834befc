//! What a frame takes in the pipeline, by stage: `stages lidar2d|lidar3d|rgbd|PATH ...`, a simulated minute or a recording each.
//!
//! Stages are told apart by switching off what comes after them. Times are those of one thread, milliseconds of its processor: of
//! frames, without what was done beside them; of that, a row for the graph and one for objects. The last column is what the
//! stage takes for each second of the recording.

use percept_formats::dataset;
use percept_geometry::{SensorData, SensorFrame, SensorSpec};
use percept_pipeline::{Executor, Pipeline, PipelineParams};
use percept_sim::{MainSensor, Scenario, Simulation};
use std::path::Path;
use std::sync::{Arc, Mutex};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Of a simulated session.
const SECONDS: f64 = 60.0;
const ROOMS: usize = 4;

fn main() -> Result<(), Failure> {
    let sources: Vec<String> = std::env::args().skip(1).collect();
    if sources.is_empty() {
        return Err("usage: stages lidar2d|lidar3d|rgbd|PATH ...".into());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    sources.iter().try_for_each(|source| pool.install(|| measure(source)))
}

/// What is fed to a pipeline.
struct Session {
    sensors: Vec<SensorSpec>,
    frames: Vec<SensorFrame>,
    seconds: f64,
}

impl Session {
    fn of(source: &str) -> Result<Self, Failure> {
        let sensor = match source {
            "lidar2d" => MainSensor::Lidar2d,
            "lidar3d" => MainSensor::Lidar3d,
            "rgbd" => MainSensor::Rgbd,
            path => {
                let recording = dataset::open(Path::new(path))?;
                let frames = recording.frames(None).collect::<Result<Vec<_>, _>>()?;
                return Ok(Self { sensors: recording.sensors.clone(), frames, seconds: recording.duration_s() });
            }
        };
        let simulation = Simulation::new(Scenario::Loops.params(sensor, ROOMS, SECONDS, 1)?)?;
        let frames = simulation.frames().map(|f| f.frame).collect();
        Ok(Self { sensors: simulation.sensors(), frames, seconds: SECONDS })
    }
}

fn measure(source: &str) -> Result<(), Failure> {
    let session = Session::of(source)?;
    println!("{source}: {:.0} s", session.seconds);
    println!("  {:<34} {:>6} {:>8} {:>8} {:>8} {:>10}", "", "count", "p50", "p99", "worst", "a second");
    let tell = |stage: &str, mut ms: Vec<f64>| {
        ms.sort_by(f64::total_cmp);
        let at =
            |share: f64| ms.get((ms.len().saturating_sub(1) as f64 * share).round() as usize).copied().unwrap_or(0.0);
        let each_s = ms.iter().sum::<f64>() / session.seconds;
        println!("  {stage:<34} {:>6} {:>8.2} {:>8.2} {:>8.2} {each_s:>10.2}", ms.len(), at(0.5), at(0.99), at(1.0));
    };
    let mut bare = PipelineParams::default();
    (bare.detection.enabled, bare.slam.back_end.enabled) = (false, false);
    let mut placed = bare.clone();
    let keyframe = &mut placed.slam.odometry.keyframe;
    (keyframe.distance_m, keyframe.angle_rad) = (100.0, std::f64::consts::PI);
    let run = |params: &PipelineParams| run(&session, params);
    tell("frames placed", run(&placed)?.frames);
    let mapped = run(&bare)?;
    tell("the same with keyframes mapped", mapped.frames);
    tell("of these, those that are keyframes", mapped.keyframes);
    let mut graph = bare.clone();
    graph.slam.back_end.enabled = true;
    let with_graph = run(&graph)?;
    tell("frames with loops, corrections", with_graph.frames);
    tell("beside: the graph, batches", with_graph.beside);
    let mut objects = bare.clone();
    objects.detection.enabled = true;
    tell("beside: objects, searches", run(&objects)?.beside);
    tell("frames with everything", run(&PipelineParams::default())?.frames);
    Ok(())
}

/// Milliseconds.
struct Times {
    frames: Vec<f64>,
    keyframes: Vec<f64>,
    beside: Vec<f64>,
}

fn run(session: &Session, params: &PipelineParams) -> Result<Times, Failure> {
    let mut pipeline = Pipeline::new(params.clone())?;
    let beside = Arc::new(AtOnce::default());
    pipeline.work_beside_frames(beside.clone());
    session.sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let (mut frames, mut keyframes) = (vec![], vec![]);
    for frame in &session.frames {
        let (start, before) = (cpu_ms(), beside.sum());
        let report = pipeline.process(frame)?;
        let ms = cpu_ms() - start - (beside.sum() - before);
        if matches!(frame.data, SensorData::Odometry(_) | SensorData::Imu(_)) {
            continue;
        }
        frames.push(ms);
        keyframes.extend(report.keyframe.map(|_| ms));
    }
    let beside = beside.0.lock().map(|b| b.clone()).unwrap_or_default();
    Ok(Times { frames, keyframes, beside })
}

/// Does what is done beside frames at once, and counts its time.
#[derive(Default)]
struct AtOnce(Mutex<Vec<f64>>);

impl AtOnce {
    fn sum(&self) -> f64 {
        self.0.lock().map(|b| b.iter().sum()).unwrap_or(0.0)
    }
}

impl Executor for AtOnce {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        let start = cpu_ms();
        work();
        if let Ok(mut ms) = self.0.lock() {
            ms.push(cpu_ms() - start);
        }
    }
}

/// Time that this thread has computed, milliseconds.
fn cpu_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

//! A planar log through the whole pipeline, made harder: `planar_log PATH [--max-range M] [--blind SHARE,SECONDS] [--no-odometry]
//! [--no-loops] [--first N] [--every N] [--frames CSV] [--trajectory CSV]`.
//!
//! `--max-range` cuts what the lidar sees, and `--blind` covers it from a share of the log on for so many seconds: scans come,
//! without a return; frames of cameras and 3D lidars do not come. Printed are the frames that were placed when they came, those in the map at the end, how often the robot
//! was lost, how far the trajectory is off, and the processor time of a frame on one thread, of those while lost apart. `--frames` writes
//! each frame as it was answered: number, stamp in seconds, x, y, yaw, milliseconds, whether it was placed, state.

use percept_evaluation::{ErrorStatistics, Trajectory, TrueRelation, score_relations};
use percept_formats::dataset::{self, Dataset};
use percept_geometry::{Pose, SensorData, SensorFrame, SensorKind, Stamped, se3};
use percept_pipeline::{Pipeline, PipelineParams};
use percept_slam::{LostReason, TrackingState};
use std::error::Error;
use std::io::Write;
use std::path::Path;

type Failure = Box<dyn Error + Send + Sync>;

/// Poses of a reference that are compared with each other, where no relations were checked by hand: so many apart.
const APART: [usize; 3] = [1, 10, 100];

/// What is done to a log.
struct Harder {
    max_range_m: f32,
    /// Share of the log at which the lidar is covered, and seconds.
    blind: Option<(f64, f64)>,
    with_odometry: bool,
    first: usize,
    /// Of so many scans one comes.
    every: usize,
}

impl Harder {
    fn parse(args: &[String]) -> Result<Self, Failure> {
        let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
        let blind = value("--blind").map(|text| -> Result<(f64, f64), Failure> {
            let (share, seconds) = text.split_once(',').ok_or("--blind: write SHARE,SECONDS")?;
            Ok((share.parse()?, seconds.parse()?))
        });
        Ok(Self {
            max_range_m: value("--max-range").map_or(Ok(f32::INFINITY), |v| v.parse())?,
            blind: blind.transpose()?,
            with_odometry: !args.iter().any(|a| a == "--no-odometry"),
            first: value("--first").map_or(Ok(usize::MAX), |v| v.parse())?,
            every: value("--every").map_or(Ok(1), |v| v.parse::<usize>())?.max(1),
        })
    }

    /// The frame as it arrives; none if it does not.
    fn pass(&self, mut frame: SensorFrame, since_start_s: f64, whole_s: f64) -> Option<SensorFrame> {
        let is_blind = self.blind.is_some_and(|(share, seconds)| {
            let since = since_start_s - share * whole_s;
            (0.0..seconds).contains(&since)
        });
        match &mut frame.data {
            SensorData::Odometry(_) if !self.with_odometry => return None,
            SensorData::Depth(_) | SensorData::Rgbd(..) | SensorData::Camera(_) | SensorData::Cloud(_) if is_blind => {
                return None;
            }
            SensorData::Scan(scan) => {
                let cut = |r: &mut f32| {
                    if is_blind || *r > self.max_range_m {
                        *r = f32::INFINITY;
                    }
                };
                scan.ranges_m.iter_mut().for_each(cut);
                scan.range_max_m = scan.range_max_m.min(self.max_range_m.into());
            }
            _ => {}
        }
        Some(frame)
    }
}

/// A registered frame as it was answered.
struct Answer {
    state: TrackingState,
    is_placed: bool,
    ms: f64,
    /// When it was taken, and base to map as it was answered.
    at: Stamped<Pose>,
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let path = args.first().ok_or("usage: planar_log PATH [options]")?;
    let harder = Harder::parse(&args)?;
    let recording = dataset::open(Path::new(path.as_str()))?;
    let mut params = PipelineParams::default();
    params.slam.back_end.enabled = !args.iter().any(|a| a == "--no-loops");
    let mut pipeline = Pipeline::new(params)?;
    for sensor in recording.sensors.iter().filter(|s| harder.with_odometry || s.kind != SensorKind::Odometry) {
        pipeline.declare_sensor(sensor.clone());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let answers = pool.install(|| run(&mut pipeline, &recording, &harder))?;
    pipeline.settle();
    let snapshot = pipeline.snapshot();
    let in_map: Vec<Stamped<Pose>> =
        snapshot.trajectory().filter(|(_, e)| e.tracked).map(|(value, e)| Stamped { stamp: e.stamp, value }).collect();
    let num = answers.len().max(1) as f64;
    let lost: Vec<f64> = answers.iter().filter(|a| !a.is_placed).map(|a| a.ms).collect();
    let begins = |is: &dyn Fn(&Answer) -> bool| answers.windows(2).filter(|w| !is(&w[0]) && is(&w[1])).count();
    let adrift = TrackingState::Lost { reason: LostReason::Adrift };
    let placed = answers.iter().filter(|a| a.is_placed).count();
    println!("{path} {}", args[1..].join(" "));
    println!(
        "  frames {}  placed at once {:.4}  in the map {:.4}  losses {} ({} frames)  adrift {} times",
        answers.len(),
        placed as f64 / num,
        in_map.len() as f64 / num,
        begins(&|a| !a.is_placed),
        lost.len(),
        begins(&|a| a.state == adrift),
    );
    println!("  ms of processor time: all {}", times(answers.iter().map(|a| a.ms).collect()));
    println!("  ms of processor time: while lost {}", times(lost));
    println!("  keyframes {}  loops {}", snapshot.keyframes.len(), snapshot.loops.len());
    if let Some(out) = args.iter().position(|a| a == "--frames").and_then(|i| args.get(i + 1)) {
        let mut file = std::io::BufWriter::new(std::fs::File::create(out)?);
        for (i, a) in answers.iter().enumerate() {
            let (stamp_s, t) = (a.at.stamp.as_secs_f64(), a.at.value.translation);
            let yaw = se3::yaw(&a.at.value);
            writeln!(
                file,
                "{i},{stamp_s:.6},{:.4},{:.4},{yaw:.5},{:.2},{},{:?}",
                t.x, t.y, a.ms, a.is_placed, a.state
            )?;
        }
        file.flush()?;
    }
    if let Some(out) = args.iter().position(|a| a == "--trajectory").and_then(|i| args.get(i + 1)) {
        write_trajectory(Path::new(out), &in_map)?;
    }
    let relations = relations(&recording);
    if !relations.is_empty() {
        let score = score_relations(&Trajectory::new(in_map)?, &relations, 2.0)?;
        let of = |s: &ErrorStatistics| format!("mean {:.4} median {:.4} max {:.4}", s.mean, s.median, s.max);
        println!(
            "  relations {}  missed {}  m: {}  deg: {}",
            score.translation_m.count,
            score.num_missed,
            of(&score.translation_m),
            of(&score.rotation_deg)
        );
    }
    Ok(())
}

/// A line a pose: stamp in seconds, x and y in metres, yaw in radians.
fn write_trajectory(out: &Path, poses: &[Stamped<Pose>]) -> Result<(), Failure> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(out)?);
    for Stamped { stamp, value } in poses {
        let t = value.translation;
        writeln!(file, "{:.6},{:.4},{:.4},{:.5}", stamp.as_secs_f64(), t.x, t.y, se3::yaw(value))?;
    }
    Ok(file.flush()?)
}

fn run(pipeline: &mut Pipeline, recording: &Dataset, harder: &Harder) -> Result<Vec<Answer>, Failure> {
    let mut answers = vec![];
    let Some(start) = recording.stamps().first() else { return Ok(answers) };
    let whole_s = recording.duration_s();
    let range = 0..harder.first.min(recording.len());
    let mut num_scans = 0;
    for frame in recording.frames(Some(range)) {
        let frame = frame?;
        if matches!(frame.data, SensorData::Scan(_)) {
            num_scans += 1;
            if (num_scans - 1) % harder.every != 0 {
                continue;
            }
        }
        let since_s = frame.stamp.seconds_since(*start);
        let Some(frame) = harder.pass(frame, since_s, whole_s) else { continue };
        let before = processor_ms();
        let report = pipeline.process(&frame)?;
        let ms = processor_ms() - before;
        let Some(pose) = report.pose else { continue };
        let is_placed = report.trajectory.is_some_and(|t| t.tracked);
        let at = Stamped { stamp: pose.stamp, value: pose.t_map_base };
        answers.push(Answer { state: pose.state, is_placed, ms, at });
    }
    Ok(answers)
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
    format!("mean {mean:.2}  p50 {:.2}  p99 {:.2}  max {:.2}", at(0.5), at(0.99), at(1.0))
}

/// Relations that were checked, or those between poses of the reference.
fn relations(recording: &Dataset) -> Vec<TrueRelation> {
    if let Some(checked) = &recording.relations {
        return checked
            .iter()
            .map(|r| TrueRelation { stamp_1: r.stamp_1, stamp_2: r.stamp_2, t_1_2: r.t_1_2 })
            .collect();
    }
    let Some(reference) = &recording.reference else { return vec![] };
    let between = |(a, b): (&Stamped<Pose>, &Stamped<Pose>)| TrueRelation {
        stamp_1: a.stamp,
        stamp_2: b.stamp,
        t_1_2: a.value.inv_mul(&b.value),
    };
    APART.iter().flat_map(|&apart| reference.iter().zip(reference.iter().skip(apart)).map(between)).collect()
}

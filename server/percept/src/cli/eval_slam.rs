//! `percept eval slam`: the whole pipeline in simulated sessions, judged by exact truth.

use super::slam_run::{FrameRecord, RIGHT_M, RIGHT_RAD, SlamRun, run_session};
use super::{Failure, files, plot};
use percept_evaluation::{Alignment, ErrorStatistics, PosePair, Similarity, absolute_error, align};
use percept_geometry::Pose;
use percept_pipeline::PipelineParams;
use percept_sim::{Kidnap, MainSensor, Scenario, SimParams, Simulation};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Sensor {
    Lidar2d,
    Lidar3d,
    /// Lidar with a rosette pattern, which sees ahead only.
    Rosette,
    Rgbd,
    Depth,
    /// Camera without depth; with `--alone` its scale stays unknown.
    Camera,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Name {
    /// Laps through all rooms.
    Loops,
    /// Carried elsewhere, blind on the way, `--trials` times.
    Kidnap,
    /// Blind for 5 s in every minute.
    Blackout,
    /// The clock jumps 30 s ahead.
    Jump,
    /// A corridor without features.
    Corridor,
    /// Standing still for a third of the time.
    Still,
    Drop10,
    Drop30,
    Drop50,
    /// A tenth of the frames out of order.
    Disorder,
    /// Stamps off by 10 ms.
    Jitter,
    /// A second sensor with a wrong mount.
    Extrinsics,
}

#[derive(Debug, clap::Args)]
pub(crate) struct SlamArgs {
    /// The sensor that finds the poses.
    #[arg(long, value_enum, default_value = "lidar2d")]
    sensor: Sensor,
    /// What is put to the test.
    #[arg(long, value_enum, default_value = "loops")]
    scenario: Name,
    /// Length of the session, minutes.
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// Rooms of the world, 1 to 256; a lap takes 30 to 40 s a room.
    #[arg(long, default_value_t = 6)]
    rooms: usize,
    /// World and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Kidnaps, with `--scenario kidnap`.
    #[arg(long, default_value_t = 10)]
    trials: usize,
    /// Leave wheels and IMU out.
    #[arg(long)]
    alone: bool,
    /// Look for no objects: what is left is the time of SLAM and mapping.
    #[arg(long)]
    no_objects: bool,
    /// Do not run a second time without closing loops.
    #[arg(long)]
    once: bool,
    /// Threads for computing; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Configuration file whose session parameters are used.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Write a row a frame: second, milliseconds, resident megabytes, tracked, error.
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Draw trajectories, error, time and memory into this PNG.
    #[arg(long)]
    plot: Option<PathBuf>,
    /// Write truth and estimate into this folder, TUM text.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

impl SlamArgs {
    fn session(&self) -> Result<SimParams, Failure> {
        let sensor = match self.sensor {
            Sensor::Lidar2d => MainSensor::Lidar2d,
            Sensor::Lidar3d => MainSensor::Lidar3d,
            Sensor::Rosette => MainSensor::Rosette,
            Sensor::Rgbd => MainSensor::Rgbd,
            Sensor::Depth => MainSensor::Depth,
            Sensor::Camera => MainSensor::Camera,
        };
        let scenario = match self.scenario {
            Name::Loops => Scenario::Loops,
            Name::Kidnap => Scenario::Kidnap { trials: self.trials },
            Name::Blackout => Scenario::Blackout,
            Name::Jump => Scenario::Jump,
            Name::Corridor => Scenario::Corridor,
            Name::Still => Scenario::Still,
            Name::Drop10 => Scenario::Drop { percent: 10 },
            Name::Drop30 => Scenario::Drop { percent: 30 },
            Name::Drop50 => Scenario::Drop { percent: 50 },
            Name::Disorder => Scenario::Disorder,
            Name::Jitter => Scenario::Jitter,
            Name::Extrinsics => Scenario::Extrinsics,
        };
        let mut params = scenario.params(sensor, self.rooms, 60.0 * self.minutes, self.seed)?;
        if self.alone {
            (params.sensors.odometry, params.sensors.imu) = (None, None);
        }
        Ok(params)
    }

    fn pipeline(&self) -> Result<PipelineParams, Failure> {
        let mut params = match &self.config {
            Some(file) => crate::config::Config::load(Some(file))?.params,
            None => PipelineParams::default(),
        };
        if self.no_objects {
            params.detection.enabled = false;
        }
        Ok(params)
    }
}

/// The parameters with loop closing off.
fn without_loops(mut params: PipelineParams) -> PipelineParams {
    params.slam.back_end.enabled = false;
    params.slam.odometry.mono.close_loops = false;
    params
}

pub(crate) fn run(args: &SlamArgs) -> Result<(), Failure> {
    let pool = super::compute_pool(args.threads, 0)?;
    let simulation = Simulation::new(args.session()?)?;
    let params = args.pipeline()?;
    let with = run_session(&pool, &simulation, params.clone(), "with loops")?;
    let open = if args.once || !params.slam.back_end.enabled {
        None
    } else {
        Some(run_session(&pool, &simulation, without_loops(params), "without loops")?)
    };
    let mut report = figures(&with);
    let mut add = |key: &str, value: Value| report.as_object_mut().map(|o| o.insert(key.to_owned(), value));
    add("sensor", json!(format!("{:?}", args.sensor).to_lowercase()));
    add("scenario", json!(format!("{:?}", args.scenario).to_lowercase()));
    add("rooms", json!(simulation.world().rooms().len()));
    add("seed", json!(args.seed));
    add("seconds", json!(simulation.duration_s()));
    add("without_loops", open.as_ref().map_or(Value::Null, figures));
    let kidnaps = &simulation.params().disturbances.kidnaps;
    if !kidnaps.is_empty() {
        add("relocalisation", relocalisation(&with, kidnaps));
    }
    if let Some(path) = &args.csv {
        write_csv(path, &with)?;
    }
    if let Some(path) = &args.plot {
        files::write(path, plot::session(&with, open.as_ref())?)?;
    }
    if let Some(dir) = &args.out {
        write_trajectories(dir, &with)?;
    }
    if args.json {
        println!("{report}");
    } else {
        print(&report, "");
    }
    Ok(())
}

/// The figures of one run.
fn figures(run: &SlamRun) -> Value {
    let pairs = run.final_pairs();
    let alignment = if run.is_metric { Alignment::Se3 } else { Alignment::Sim3 };
    let of = |pairs: &[PosePair]| absolute_error(pairs, alignment).ok();
    let (last, online) = (of(&pairs), of(&run.online_pairs()));
    let kept = of(&run.keyframe_pairs());
    let mut ms: Vec<f64> = run.frames.iter().map(|f| f64::from(f.ms)).collect();
    let third = ms.len() / 3;
    let mean = |of: &[f64]| ErrorStatistics::of(of).map(|s| s.mean);
    let (first_ms, last_ms) = (mean(&ms[..third]), mean(&ms[ms.len() - third..]));
    ms.sort_by(f64::total_cmp);
    let at = |share: f64| ms.get(((ms.len().max(1) - 1) as f64 * share).round() as usize);
    let rss = |share: f64| run.frames.get(((run.frames.len().max(1) - 1) as f64 * share) as usize).map(|f| f.rss_mb);
    json!({
        "frames": run.frames.len(),
        "refused": run.num_refused,
        "tracked": run.num_tracked(),
        "tracked_share": run.num_tracked() as f64 / run.num_sent.max(1) as f64,
        "states": run.states,
        "degenerate_frames": run.num_degenerate,
        "metric": run.is_metric,
        "metres_by_unit": metres_by_unit(&pairs),
        "path_length_m": run.path_length_m(),
        "ate_rmse_m": last.as_ref().map(|a| a.translation_m.rmse),
        "ate_max_m": last.as_ref().map(|a| a.translation_m.max),
        "ate_rot_rmse_deg": last.as_ref().map(|a| a.rotation_deg.rmse),
        "ate_online_rmse_m": online.as_ref().map(|a| a.translation_m.rmse),
        "end_drift_percent": percept_evaluation::end_drift_percent(&pairs),
        "keyframes": run.num_keyframes,
        "keyframes_ate_rmse_m": kept.as_ref().map(|a| a.translation_m.rmse),
        "keyframes_ate_max_m": kept.as_ref().map(|a| a.translation_m.max),
        "keyframes_ate_rot_rmse_deg": kept.as_ref().map(|a| a.rotation_deg.rmse),
        "corrections": run.num_corrections,
        "loops_found": run.num_loops[0],
        "loops_believed": run.num_loops[1],
        "loops_false": run.num_loops[2],
        "mounts_off_deg": run.mounts_off_deg,
        "frame_ms_mean": mean(&ms),
        "frame_ms_p50": at(0.5),
        "frame_ms_p99": at(0.99),
        "frame_ms_max": at(1.0),
        "frame_ms_first_third": first_ms,
        "frame_ms_last_third": last_ms,
        "rss_mb_tenth": rss(0.1),
        "rss_mb_half": rss(0.5),
        "rss_mb_end": rss(1.0),
    })
}

/// True metres by the estimate's unit in each fifth of the way: all 1 where scale is right, all alike where it does not drift.
fn metres_by_unit(pairs: &[PosePair]) -> Vec<Option<f64>> {
    let fifths = pairs.chunks(pairs.len().div_ceil(5).max(1));
    fifths.map(|fifth| align(fifth, Alignment::Sim3).ok().map(|s| s.scale)).collect()
}

/// Kidnap by kidnap: was the robot found, when, and was it ever said to be where it is not.
///
/// Poses as they were said at the time, laid over the truth by those before the first kidnap.
fn relocalisation(run: &SlamRun, kidnaps: &[Kidnap]) -> Value {
    let first_s = kidnaps.first().map_or(0.0, |k| k.at_s);
    let before: Vec<PosePair> = run.online_pairs_until(first_s);
    let Ok(similarity) = align(&before, Alignment::Se3) else { return Value::Null };
    let (mut times, mut num_false) = (Vec::new(), 0);
    for (i, kidnap) in kidnaps.iter().enumerate() {
        let begin_s = kidnap.at_s + kidnap.carried_s;
        let end_s = kidnaps.get(i + 1).map_or(f64::INFINITY, |next| next.at_s);
        let placed: Vec<&FrameRecord> =
            run.frames.iter().filter(|f| f.tracked && f.second >= begin_s && f.second < end_s).collect();
        let right = |f: &FrameRecord| is_right(&similarity, &f.truth, &f.online);
        num_false += usize::from(placed.iter().any(|f| !right(f)));
        times.extend(placed.iter().find(|f| right(f)).map(|f| f.second - begin_s));
    }
    let statistics = ErrorStatistics::of(&times);
    json!({
        "kidnaps": kidnaps.len(),
        "found": times.len(),
        "false": num_false,
        "time_median_s": statistics.map(|s| s.median),
        "time_mean_s": statistics.map(|s| s.mean),
        "time_max_s": statistics.map(|s| s.max),
    })
}

fn is_right(similarity: &Similarity, truth: &Pose, estimate: &Pose) -> bool {
    let error = truth.inverse() * similarity.apply(estimate);
    error.translation.vector.norm() <= RIGHT_M && error.rotation.angle() <= RIGHT_RAD
}

fn write_csv(path: &Path, run: &SlamRun) -> Result<(), Failure> {
    let mut out = std::io::BufWriter::new(std::fs::File::create(path)?);
    writeln!(out, "second,frame_ms,rss_mb,tracked,error_m")?;
    let errors = run.online_errors();
    for (f, error) in run.frames.iter().zip(errors) {
        let tracked = u8::from(f.tracked);
        writeln!(out, "{:.3},{:.3},{:.2},{tracked},{error:.4}", f.second, f.ms, f.rss_mb)?;
    }
    Ok(out.flush()?)
}

fn write_trajectories(dir: &Path, run: &SlamRun) -> Result<(), Failure> {
    files::make_folder(dir)?;
    let pairs = run.final_pairs();
    let tum = |name: &str, pose: &dyn Fn(&PosePair) -> Pose| -> Result<(), Failure> {
        let poses: Vec<_> =
            pairs.iter().map(|p| percept_geometry::Stamped { stamp: p.stamp, value: pose(p) }).collect();
        let mut out = std::io::BufWriter::new(std::fs::File::create(dir.join(name))?);
        percept_formats::trajectory::write_tum(&mut out, &poses)?;
        Ok(out.flush()?)
    };
    tum("truth.tum", &|p| p.reference)?;
    tum("estimate.tum", &|p| p.estimate)
}

/// Names and numbers, nested ones indented.
fn print(report: &Value, indent: &str) {
    let Value::Object(fields) = report else { return };
    for (name, value) in fields.iter().filter(|(_, v)| !v.is_null()) {
        match value {
            Value::Object(_) => {
                println!("{indent}{name}:");
                print(value, &format!("{indent}    "));
            }
            Value::Number(n) if n.is_f64() => {
                println!("{indent}{name:>22}  {:.4}", n.as_f64().unwrap_or_default());
            }
            _ => println!("{indent}{name:>22}  {}", value.to_string().trim_matches('"')),
        }
    }
}

//! `percept eval wheels`: a recording whose wheels lie, against the same with honest wheels and with none.

use super::corrupt::{Corrupted, Corruption, places, samples};
use super::{Failure, local};
use clap::ValueEnum;
use percept_evaluation::{Trajectory, TrueRelation, score_relations};
use percept_formats::dataset::{self, Dataset};
use percept_geometry::{Pose, SensorData, SensorFrame, SensorKind, Stamped, Timestamp};
use percept_pipeline::PipelineParams;
use serde::Serialize;
use std::collections::HashMap;
use std::path::PathBuf;

/// Poses of a reference that are compared with each other, where no relations were checked by hand: so many apart.
const APART: [usize; 3] = [1, 10, 100];
/// A pose is off if it was said so many metres from where the clean run's trajectory has it in the end.
const OFF_M: f64 = 0.5;

#[derive(Debug, clap::Args)]
pub(crate) struct WheelsArgs {
    /// A recording with wheel odometry, and with relations checked by hand or a reference.
    path: PathBuf,
    /// What goes wrong; none: each in turn.
    #[arg(long, value_enum, value_delimiter = ',')]
    faults: Vec<Corruption>,
    /// At how many places.
    #[arg(long, default_value_t = 20)]
    places: usize,
    /// What the places are drawn by.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Configuration file whose session parameters are used.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Print JSON objects, one a run, instead of a table.
    #[arg(long)]
    json: bool,
}

/// What wheels do in a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Wheels {
    Honest,
    None,
    #[serde(untagged)]
    Lying(Corruption),
}

/// A run's figures.
#[derive(Debug, Serialize)]
struct Figures {
    wheels: Wheels,
    /// Places of the fault.
    places: usize,
    /// Mean error of the relations.
    trans_mean_m: f64,
    rot_mean_deg: f64,
    relations: usize,
    missed: usize,
    /// Share of the frames that were said to be tracked.
    tracked: f64,
    /// Longest time during which tracking was said while the pose was off, seconds.
    off_s: f64,
    /// Frames a second.
    frames_per_s: f64,
}

pub(crate) fn run(args: &WheelsArgs) -> Result<(), Failure> {
    let recording = dataset::open(&args.path)?;
    let told = samples(recording.frames(None).map(|frame| Ok(frame?)));
    if told.is_empty() {
        return Err(format!("{}: has no wheel odometry to spoil", args.path.display()).into());
    }
    let relations = relations(&recording)?;
    let params = match &args.config {
        Some(file) => crate::config::Config::load(Some(file))?.params,
        None => PipelineParams::default(),
    };
    let pool = super::compute_pool(0, 0)?;
    let every = Corruption::value_variants();
    let faults = if args.faults.is_empty() { every.to_vec() } else { args.faults.clone() };
    let runs = [Wheels::Honest, Wheels::None].into_iter().chain(faults.into_iter().map(Wheels::Lying));
    if !args.json {
        println!(
            "{:12} {:>6} {:>9} {:>9} {:>8} {:>7} {:>8}",
            "wheels", "places", "trans m", "rot deg", "tracked", "off s", "frames/s"
        );
    }
    let mut clean: Option<HashMap<Timestamp, Pose>> = None;
    for wheels in runs {
        let begins = match wheels {
            Wheels::Lying(kind) => places(&told, kind, args.places, args.seed),
            Wheels::Honest | Wheels::None => vec![],
        };
        let num_places = begins.len();
        let mut corrupted = match wheels {
            Wheels::Lying(kind) => Some(Corrupted::new(kind, begins)),
            Wheels::Honest | Wheels::None => None,
        };
        let pass = |frame: Result<SensorFrame, Failure>| match frame {
            Ok(frame) if wheels == Wheels::None && matches!(frame.data, SensorData::Odometry(_)) => None,
            Ok(frame) => match &mut corrupted {
                Some(corrupted) => corrupted.pass(frame).map(Ok),
                None => Some(Ok(frame)),
            },
            error => Some(error),
        };
        let read = super::input::read_ahead(recording.frames(None));
        let sensors: Vec<_> = recording
            .sensors
            .iter()
            .filter(|s| wheels != Wheels::None || s.kind != SensorKind::Odometry)
            .cloned()
            .collect();
        let mut online: Vec<(Timestamp, Pose, bool)> = vec![];
        let found =
            local::run(&pool, params.clone(), &sensors, read.into_iter().filter_map(pass), |frame, snapshot| {
                let pose = snapshot.pose.as_ref().filter(|p| p.stamp == frame.stamp);
                online.extend(pose.map(|p| (p.stamp, p.t_map_base, p.state.is_tracking())));
            })?;
        let poses = found.trajectory();
        let truth = clean.get_or_insert_with(|| poses.iter().map(|p| (p.stamp, p.value)).collect());
        let score = score_relations(&Trajectory::new(poses)?, &relations, 2.0)?;
        let figures = Figures {
            wheels,
            places: num_places,
            trans_mean_m: score.translation_m.mean,
            rot_mean_deg: score.rotation_deg.mean,
            relations: score.translation_m.count,
            missed: score.num_missed,
            tracked: found.tracked as f64 / recording.len() as f64,
            off_s: longest_off(&online, truth),
            frames_per_s: recording.len() as f64 / found.wall_s,
        };
        print(&figures, args.json)?;
    }
    Ok(())
}

/// Relations that were checked, or those between poses of the reference.
fn relations(recording: &Dataset) -> Result<Vec<TrueRelation>, Failure> {
    if let Some(checked) = &recording.relations {
        let relation = |r: &percept_formats::carmen::Relation| TrueRelation {
            stamp_1: r.stamp_1,
            stamp_2: r.stamp_2,
            t_1_2: r.t_1_2,
        };
        return Ok(checked.iter().map(relation).collect());
    }
    let Some(reference) = &recording.reference else {
        return Err("the recording has neither relations nor a reference to judge by".into());
    };
    let relation = |a: &Stamped<Pose>, b: &Stamped<Pose>| TrueRelation {
        stamp_1: a.stamp,
        stamp_2: b.stamp,
        t_1_2: a.value.inv_mul(&b.value),
    };
    let of = |apart: usize| reference.iter().zip(reference.iter().skip(apart)).map(move |(a, b)| relation(a, b));
    Ok(APART.into_iter().flat_map(of).collect())
}

/// The longest time, seconds, during which each pose was said to be tracked and was off.
fn longest_off(online: &[(Timestamp, Pose, bool)], truth: &HashMap<Timestamp, Pose>) -> f64 {
    let (mut since, mut longest) = (None::<Timestamp>, 0.0f64);
    for (stamp, pose, tracked) in online {
        let Some(true_pose) = truth.get(stamp) else { continue };
        let off = (pose.translation.vector - true_pose.translation.vector).norm();
        if !*tracked || off <= OFF_M {
            since = None;
            continue;
        }
        longest = longest.max(stamp.seconds_since(*since.get_or_insert(*stamp)));
    }
    longest
}

fn print(figures: &Figures, json: bool) -> Result<(), Failure> {
    if json {
        println!("{}", serde_json::to_string(figures)?);
        return Ok(());
    }
    let Figures { places, trans_mean_m, rot_mean_deg, tracked, off_s, frames_per_s, .. } = figures;
    let name = serde_json::to_value(figures.wheels)?;
    let name = name.as_str().unwrap_or_default();
    println!("{name:12} {places:6} {trans_mean_m:9.4} {rot_mean_deg:9.4} {tracked:8.3} {off_s:7.1} {frames_per_s:8.0}");
    Ok(())
}

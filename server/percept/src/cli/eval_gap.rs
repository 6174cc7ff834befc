//! `percept eval gap`: a recording with a part cut out, after which the robot has to find itself again.

use super::slam_run::{RIGHT_M, RIGHT_RAD};
use super::{Failure, input, local};
use percept_evaluation::{Alignment, ErrorStatistics, PosePair, absolute_error, align};
use percept_formats::dataset::{self, Dataset};
use percept_geometry::{Pose, SensorFrame, Stamped, Timestamp};
use percept_pipeline::PipelineParams;
use serde::Serialize;
use std::ops::Range;
use std::path::PathBuf;

/// Poses of estimate and reference that are at most so far apart in time belong together, seconds.
const MAX_DIFFERENCE_S: f64 = 0.02;

#[derive(Debug, clap::Args)]
pub(crate) struct GapArgs {
    /// A recording with a reference.
    path: PathBuf,
    /// Parts that are cut out, one a run, as frames `FIRST:LAST`, LAST excluded; none: `--cuts` of them, evenly placed.
    #[arg(long, value_parser = input::parse_range)]
    cut: Vec<Range<usize>>,
    /// How many parts are tried, a tenth of the frames each, where none is named.
    #[arg(long, default_value_t = 7)]
    cuts: usize,
    /// Seconds of silence in place of the part.
    #[arg(long, default_value_t = 10.0)]
    silence_s: f64,
    /// Configuration file whose session parameters are used.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Print JSON objects, one a run, instead of a table.
    #[arg(long)]
    json: bool,
}

/// A run's figures.
#[derive(Debug, Serialize)]
struct Figures {
    cut: Range<usize>,
    /// How far the robot was carried meanwhile.
    carried_m: f64,
    carried_deg: f64,
    /// Seconds after the silence until a frame was placed rightly; none if that never happened.
    found_after_s: Option<f64>,
    /// Frames after the silence that were said to be tracked, when they came, and were somewhere else.
    num_false: usize,
    /// Frames after the silence, and those of them that have a pose in the end.
    frames: usize,
    placed: usize,
    /// Of all frames that have a pose in the end, laid over the reference as one trajectory.
    ate_rmse_m: Option<f64>,
    /// Of those after the silence, laid over it by those before.
    after_max_m: Option<f64>,
}

pub(crate) fn run(args: &GapArgs) -> Result<(), Failure> {
    let recording = dataset::open(&args.path)?;
    let Some(reference) = &recording.reference else {
        return Err(format!("{}: has no reference to judge by", args.path.display()).into());
    };
    let params = match &args.config {
        Some(file) => crate::config::Config::load(Some(file))?.params,
        None => PipelineParams::default(),
    };
    if !(args.silence_s > 0.0 && args.silence_s <= 1e6) {
        return Err(format!("silence_s: {} is not within 0 to 1e6; use 10", args.silence_s).into());
    }
    let length = recording.len() / 10;
    let places = (1..=args.cuts).map(|k| k * recording.len() / (args.cuts + 1));
    let evenly = || places.clone().map(|at| at.saturating_sub(length / 2)..at + length.div_ceil(2)).collect();
    let cuts: Vec<Range<usize>> = if args.cut.is_empty() { evenly() } else { args.cut.clone() };
    let pool = super::compute_pool(0, 0)?;
    if !args.json {
        println!(
            "{:>12} {:>9} {:>11} {:>7} {:>6} {:>13} {:>8} {:>8}",
            "cut", "carried m", "carried deg", "found s", "false", "placed", "ate m", "after m"
        );
    }
    for cut in cuts {
        let figures = with_cut(&pool, &params, &recording, reference, cut, args.silence_s)?;
        print(&figures, args.json)?;
    }
    Ok(())
}

fn with_cut(
    pool: &rayon::ThreadPool,
    params: &PipelineParams,
    recording: &Dataset,
    reference: &[Stamped<Pose>],
    cut: Range<usize>,
    silence_s: f64,
) -> Result<Figures, Failure> {
    let stamps = recording.stamps();
    let (Some(before), Some(after)) = (cut.start.checked_sub(1).and_then(|k| stamps.get(k)), stamps.get(cut.end))
    else {
        return Err(format!("cut: {}:{} leaves no frames on one side; use a part within", cut.start, cut.end).into());
    };
    let (before, after) = (*before, *after);
    let earlier_s = after.seconds_since(before) - silence_s;
    let shown = move |frame: Result<SensorFrame, _>| match frame {
        Ok(frame) if frame.stamp > before && frame.stamp < after => None,
        Ok(mut frame) => {
            if frame.stamp >= after {
                frame.stamp = frame.stamp.plus_seconds(-earlier_s);
            }
            Some(Ok(frame))
        }
        error => Some(error),
    };
    let shown = input::read_ahead(recording.frames(None).filter_map(shown));
    let resumed = after.plus_seconds(-earlier_s);
    let truth = |stamp: Timestamp| {
        let stamp = if stamp >= resumed { stamp.plus_seconds(earlier_s) } else { stamp };
        let next = reference.partition_point(|r| r.stamp < stamp);
        let near = [next.checked_sub(1), Some(next)].into_iter().flatten().filter_map(|k| reference.get(k));
        let nearest =
            near.min_by(|a, b| a.stamp.seconds_since(stamp).abs().total_cmp(&b.stamp.seconds_since(stamp).abs()));
        nearest.filter(|r| r.stamp.seconds_since(stamp).abs() <= MAX_DIFFERENCE_S).map(|r| r.value)
    };
    let mut online: Vec<(Timestamp, Pose, bool)> = vec![];
    let found = local::run(pool, params.clone(), &recording.sensors, shown.into_iter(), |frame, snapshot| {
        let pose = snapshot.pose.as_ref().filter(|p| p.stamp == frame.stamp);
        online.extend(pose.map(|p| (p.stamp, p.t_map_base, p.state.is_tracking())));
    })?;
    let pair = |stamp: Timestamp, estimate: Pose| Some(PosePair { stamp, reference: truth(stamp)?, estimate });
    let placed = found.snapshot.trajectory_in_one_unit().filter(|(_, e)| e.tracked);
    let placed: Vec<PosePair> = placed.filter_map(|(pose, e)| pair(e.stamp, pose)).collect();
    let said: Vec<PosePair> = online.iter().filter(|o| o.2).filter_map(|o| pair(o.0, o.1)).collect();
    let split = |pairs: &[PosePair]| {
        let first = pairs.partition_point(|p| p.stamp < resumed);
        (pairs[..first].to_vec(), pairs[first..].to_vec())
    };
    let ((said_before, said_after), (kept_before, kept_after)) = (split(&said), split(&placed));
    let said_over = align(&said_before, Alignment::Se3)?;
    let is_right = |p: &&PosePair| {
        let error = p.reference.inverse() * said_over.apply(&p.estimate);
        error.translation.vector.norm() <= RIGHT_M && error.rotation.angle() <= RIGHT_RAD
    };
    let kept_over = align(&kept_before, Alignment::Se3)?;
    let off = |p: &PosePair| (kept_over.apply(&p.estimate).translation.vector - p.reference.translation.vector).norm();
    let carried = truth(before).zip(truth(resumed)).map(|(a, b)| a.inv_mul(&b)).unwrap_or_else(Pose::identity);
    Ok(Figures {
        cut,
        carried_m: carried.translation.vector.norm(),
        carried_deg: carried.rotation.angle().to_degrees(),
        found_after_s: said_after.iter().find(is_right).map(|p| p.stamp.seconds_since(resumed)),
        num_false: said_after.iter().filter(|p| !is_right(p)).count(),
        frames: online.iter().filter(|o| o.0 >= resumed).count(),
        placed: kept_after.len(),
        ate_rmse_m: absolute_error(&placed, Alignment::Se3).ok().map(|e| e.translation_m.rmse),
        after_max_m: ErrorStatistics::of(&kept_after.iter().map(off).collect::<Vec<_>>()).map(|s| s.max),
    })
}

fn print(figures: &Figures, json: bool) -> Result<(), Failure> {
    if json {
        println!("{}", serde_json::to_string(figures)?);
        return Ok(());
    }
    let Figures { cut, carried_m, carried_deg, num_false, frames, placed, .. } = figures;
    let number = |v: Option<f64>, digits: usize| v.map_or("never".to_owned(), |v| format!("{v:.digits$}"));
    let (cut, placed) = (format!("{}:{}", cut.start, cut.end), format!("{placed} of {frames}"));
    let (found, ate) = (number(figures.found_after_s, 2), number(figures.ate_rmse_m, 4));
    let after = number(figures.after_max_m, 3);
    println!("{cut:>12} {carried_m:9.2} {carried_deg:11.1} {found:>7} {num_false:6} {placed:>13} {ate:>8} {after:>8}");
    Ok(())
}

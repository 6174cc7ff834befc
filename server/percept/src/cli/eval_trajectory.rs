//! `percept eval trajectory`: ATE, RPE and drift of a trajectory file.

use super::{Failure, files, plot};
use percept_evaluation::{
    Alignment, Delta, ErrorStatistics, SegmentParams, Trajectory, TrajectoryParams, TrajectoryScore, aligned_pairs,
    score_trajectory,
};
use percept_formats::{Limits, read_file, trajectory};
use percept_geometry::{Pose, Stamped, Timestamp};
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Align {
    /// Rotation and translation by least squares.
    Se3,
    /// Rotation, translation and scale.
    Sim3,
    /// The first poses onto each other.
    Origin,
    /// As they are.
    None,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Unit {
    /// Poses.
    Frames,
    /// Metres travelled.
    M,
    /// Seconds.
    S,
    /// Degrees turned.
    Deg,
}

#[derive(Debug, clap::Args)]
pub(crate) struct TrajectoryArgs {
    /// Truth: TUM (stamp x y z qx qy qz qw), EuRoC (csv) or KITTI (3 x 4 rows) text.
    reference: PathBuf,
    /// Estimate, in any of these formats.
    estimate: PathBuf,
    /// How the estimate is laid over the reference.
    #[arg(long, value_enum, default_value = "se3")]
    align: Align,
    /// Stretch of the relative error.
    #[arg(long, default_value_t = 1.0)]
    delta: f64,
    /// Unit of the stretch.
    #[arg(long, value_enum, default_value = "frames")]
    delta_unit: Unit,
    /// Begin a stretch at every pose instead of where the one before ended.
    #[arg(long)]
    all_pairs: bool,
    /// Stamps match within this, seconds.
    #[arg(long, default_value_t = 0.01)]
    max_difference_s: f64,
    /// Added to the estimate's stamps, seconds.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    offset_s: f64,
    /// Lengths of the segments of KITTI's drift, metres.
    #[arg(long, value_delimiter = ',', default_value = "100,200,300,400,500,600,700,800")]
    segments_m: Vec<f64>,
    /// Draw both trajectories over each other and the error over time into this PNG.
    #[arg(long)]
    plot: Option<PathBuf>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

impl TrajectoryArgs {
    fn params(&self) -> Result<TrajectoryParams, Failure> {
        let alignment = match self.align {
            Align::Se3 => Alignment::Se3,
            Align::Sim3 => Alignment::Sim3,
            Align::Origin => Alignment::Origin,
            Align::None => Alignment::None,
        };
        let delta = match self.delta_unit {
            Unit::Frames if self.delta.fract() == 0.0 && (1.0..=1e9).contains(&self.delta) => {
                Delta::Frames(self.delta as usize)
            }
            Unit::Frames => {
                return Err(format!("--delta: {} is not a whole number of frames above 0", self.delta).into());
            }
            Unit::M => Delta::Metres(self.delta),
            Unit::S => Delta::Seconds(self.delta),
            Unit::Deg => Delta::Degrees(self.delta),
        };
        Ok(TrajectoryParams {
            max_difference_s: self.max_difference_s,
            estimate_offset_s: self.offset_s,
            alignment,
            delta,
            all_pairs: self.all_pairs,
            segments: SegmentParams { lengths_m: self.segments_m.clone(), ..SegmentParams::default() },
        })
    }
}

/// A trajectory file: EuRoC if its first row has commas, KITTI if it has 12 numbers (poses are numbered by their
/// rows), else TUM. In the order of time.
pub(crate) fn read(path: &Path) -> Result<Vec<Stamped<Pose>>, Failure> {
    let bytes = read_file(path, &Limits::default())?;
    let text = String::from_utf8_lossy(&bytes);
    let first = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#')).unwrap_or_default();
    let in_file = |e: percept_formats::FormatError| format!("{}: {e}", path.display());
    if first.split_whitespace().count() == 12 {
        let poses = trajectory::parse_kitti(&bytes).map_err(in_file)?;
        let numbered = poses.into_iter().enumerate();
        return Ok(numbered.map(|(i, value)| Stamped { stamp: Timestamp(i as i64 * 1_000_000_000), value }).collect());
    }
    let parse = if first.contains(',') { trajectory::parse_euroc } else { trajectory::parse_tum };
    let mut poses = parse(&bytes).map_err(in_file)?;
    poses.sort_by_key(|p| p.stamp);
    Ok(poses)
}

pub(crate) fn run(args: &TrajectoryArgs) -> Result<(), Failure> {
    let params = args.params()?;
    let (reference, estimate) = (Trajectory::new(read(&args.reference)?)?, Trajectory::new(read(&args.estimate)?)?);
    let score = score_trajectory(&reference, &estimate, &params)?;
    if let Some(path) = &args.plot {
        let (pairs, _) = aligned_pairs(&reference, &estimate, &params)?;
        files::write(path, plot::trajectories(&pairs)?)?;
    }
    if args.json {
        println!("{}", to_json(&score));
    } else {
        print(&score, &params);
    }
    Ok(())
}

fn to_json(score: &TrajectoryScore) -> serde_json::Value {
    let rpe = score.relative.as_ref();
    json!({
        "pairs": score.num_pairs,
        "ate_rmse_m": score.absolute.translation_m.rmse,
        "ate_m": score.absolute.translation_m,
        "ate_rot_deg": score.absolute.rotation_deg,
        "rpe_trans_rmse_m": rpe.map(|r| r.translation_m.rmse),
        "rpe_rot_rmse_deg": rpe.map(|r| r.rotation_deg.rmse),
        "rpe_trans_m": rpe.map(|r| r.translation_m),
        "rpe_rot_deg": rpe.map(|r| r.rotation_deg),
        "path_length_m": score.reference_length_m,
        "drift_percent": score.end_drift_percent,
        "segment_trans_percent": score.segment_drift.map(|d| d.translation_percent),
        "segment_rot_deg_per_m": score.segment_drift.map(|d| d.rotation_deg_per_m),
        "segments": score.segment_drift.map_or(0, |d| d.num_segments),
        "scale": score.absolute.similarity.scale,
    })
}

fn print(score: &TrajectoryScore, params: &TrajectoryParams) {
    println!(
        "{} pairs over {:.3} m, scale {:.6}",
        score.num_pairs, score.reference_length_m, score.absolute.similarity.scale
    );
    println!("{:22} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10}", "", "rmse", "mean", "median", "std", "min", "max");
    let row = |name: &str, s: &ErrorStatistics| {
        println!(
            "{name:22} {:10.6} {:10.6} {:10.6} {:10.6} {:10.6} {:10.6}",
            s.rmse, s.mean, s.median, s.std, s.min, s.max
        );
    };
    row("ATE m", &score.absolute.translation_m);
    row("ATE rotation deg", &score.absolute.rotation_deg);
    let (length, unit) = params.delta.parts();
    if let Some(rpe) = &score.relative {
        row(&format!("RPE {length} {unit}, m"), &rpe.translation_m);
        row(&format!("RPE {length} {unit}, deg"), &rpe.rotation_deg);
    } else {
        println!("no RPE: no two poses are {length} {unit} apart");
    }
    if let Some(drift) = score.end_drift_percent {
        println!("drift at the end {drift:.4} %");
    }
    if let Some(d) = score.segment_drift {
        let (percent, turn) = (d.translation_percent, d.rotation_deg_per_m);
        println!("segments as KITTI: {percent:.4} %, {turn:.6} deg/m over {} segments", d.num_segments);
    }
}

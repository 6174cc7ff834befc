//! `percept eval`: metrics against ground truth.

use super::{Failure, eval_graph, eval_sim};
use percept_evaluation::{Alignment, Trajectory, TrajectoryParams, score_trajectory};
use percept_formats::{Limits, read_file, trajectory};
use percept_geometry::{Pose, Stamped, Timestamp};
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum EvalCommand {
    /// ATE and RPE of a trajectory file, as evo computes them.
    Trajectory(TrajectoryArgs),
    /// A pose graph in a g2o file, optimised from its poses or from its measurements alone, whichever start is better.
    Graph(eval_graph::GraphArgs),
    /// Objects found in simulated worlds: precision and recall.
    Objects(eval_sim::ObjectsArgs),
    /// Paths planned in simulated worlds, checked against the true occupancy.
    Planning(eval_sim::PlanningArgs),
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Align {
    Se3,
    Sim3,
    None,
}

#[derive(Debug, clap::Args)]
pub(crate) struct TrajectoryArgs {
    /// Truth: TUM (stamp x y z qx qy qz qw) or KITTI (3 x 4 rows) text.
    reference: PathBuf,
    /// Estimate, in the same format.
    estimate: PathBuf,
    /// How the estimate is laid over the reference.
    #[arg(long, value_enum, default_value = "se3")]
    align: Align,
    /// Stamps match within this, seconds.
    #[arg(long, default_value_t = 0.01)]
    max_difference_s: f64,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(command: EvalCommand) -> Result<(), Failure> {
    match command {
        EvalCommand::Trajectory(args) => run_trajectory(&args),
        EvalCommand::Graph(args) => eval_graph::run(&args),
        EvalCommand::Objects(args) => eval_sim::objects(&args),
        EvalCommand::Planning(args) => eval_sim::planning(&args),
    }
}

/// A trajectory file: KITTI if its first row has 12 numbers (poses are numbered by their rows), else TUM.
fn read(path: &Path) -> Result<Vec<Stamped<Pose>>, Failure> {
    let bytes = read_file(path, &Limits::default())?;
    let text = String::from_utf8_lossy(&bytes);
    let first = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#')).unwrap_or_default();
    let in_file = |e: percept_formats::FormatError| format!("{}: {e}", path.display());
    if first.split_whitespace().count() == 12 {
        let poses = trajectory::parse_kitti(&bytes).map_err(in_file)?;
        let numbered = poses.into_iter().enumerate();
        return Ok(numbered.map(|(i, value)| Stamped { stamp: Timestamp(i as i64 * 1_000_000_000), value }).collect());
    }
    let mut poses = trajectory::parse_tum(&bytes).map_err(in_file)?;
    poses.sort_by_key(|p| p.stamp);
    Ok(poses)
}

fn run_trajectory(args: &TrajectoryArgs) -> Result<(), Failure> {
    let alignment = match args.align {
        Align::Se3 => Alignment::Se3,
        Align::Sim3 => Alignment::Sim3,
        Align::None => Alignment::None,
    };
    let params = TrajectoryParams { alignment, max_difference_s: args.max_difference_s, ..TrajectoryParams::default() };
    let score =
        score_trajectory(&Trajectory::new(read(&args.reference)?)?, &Trajectory::new(read(&args.estimate)?)?, &params)?;
    let rpe = score.relative.as_ref();
    if args.json {
        let object = json!({
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
            "scale": score.absolute.similarity.scale,
        });
        println!("{object}");
        return Ok(());
    }
    println!(
        "{} pairs over {:.3} m, scale {:.6}",
        score.num_pairs, score.reference_length_m, score.absolute.similarity.scale
    );
    println!("{:22} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10}", "", "rmse", "mean", "median", "std", "min", "max");
    let row = |name: &str, s: &percept_evaluation::ErrorStatistics| {
        println!(
            "{name:22} {:10.6} {:10.6} {:10.6} {:10.6} {:10.6} {:10.6}",
            s.rmse, s.mean, s.median, s.std, s.min, s.max
        );
    };
    row("ATE m", &score.absolute.translation_m);
    row("ATE rotation deg", &score.absolute.rotation_deg);
    if let Some(rpe) = rpe {
        row("RPE 1 frame m", &rpe.translation_m);
        row("RPE 1 frame deg", &rpe.rotation_deg);
    }
    if let Some(drift) = score.end_drift_percent {
        println!("drift at the end {drift:.4} %");
    }
    Ok(())
}

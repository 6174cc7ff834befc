//! `percept eval relations`: a trajectory judged by checked relative poses.

use super::{Failure, eval_trajectory::read};
use percept_evaluation::{Trajectory, TrueRelation, score_relations};
use percept_formats::{Limits, carmen, read_file};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct RelationsArgs {
    /// Estimate: TUM (stamp x y z qx qy qz qw), EuRoC or KITTI text.
    trajectory: PathBuf,
    /// Rows `t1 t2 x y z roll pitch yaw`: the pose at t2 seen from that at t1; t1 may be later.
    relations: PathBuf,
    /// Poses are interpolated between two that are at most this far apart, seconds; else the relation is missed.
    #[arg(long, default_value_t = 2.0)]
    max_gap_s: f64,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &RelationsArgs) -> Result<(), Failure> {
    let trajectory = Trajectory::new(read(&args.trajectory)?)?;
    let bytes = read_file(&args.relations, &Limits::default())?;
    let rows = carmen::parse_relations(&bytes).map_err(|e| format!("{}: {e}", args.relations.display()))?;
    let relation = |r: carmen::Relation| TrueRelation { stamp_1: r.stamp_1, stamp_2: r.stamp_2, t_1_2: r.t_1_2 };
    let relations: Vec<TrueRelation> = rows.into_iter().map(relation).collect();
    let score = score_relations(&trajectory, &relations, args.max_gap_s)?;
    let (t, r) = (&score.translation_m, &score.rotation_deg);
    if args.json {
        let object = json!({
            "trans_mean_m": t.mean,
            "trans_std_m": t.std,
            "rot_mean_deg": r.mean,
            "rot_std_deg": r.std,
            "relations": t.count,
            "missed": score.num_missed,
            "trans_m": t,
            "rot_deg": r,
            "loops": score.loops.map(|l| l.0.count),
            "loop_trans_mean_m": score.loops.map(|l| l.0.mean),
            "loop_trans_median_m": score.loops.map(|l| l.0.median),
            "loop_rot_mean_deg": score.loops.map(|l| l.1.mean),
        });
        println!("{object}");
        return Ok(());
    }
    println!("{} relations, {} missed", t.count, score.num_missed);
    println!("{:18} {:>9} {:>9} {:>9} {:>9}", "", "mean", "std", "median", "max");
    let row = |name: &str, s: &percept_evaluation::ErrorStatistics| {
        println!("{name:18} {:9.4} {:9.4} {:9.4} {:9.4}", s.mean, s.std, s.median, s.max);
    };
    row("translation m", t);
    row("rotation deg", r);
    if let Some((translation, rotation)) = &score.loops {
        println!("of these {} over more than a minute:", translation.count);
        row("translation m", translation);
        row("rotation deg", rotation);
    }
    Ok(())
}

//! `percept eval`: metrics against ground truth.

use super::{
    Failure, eval_gap, eval_graph, eval_objects, eval_planning, eval_relations, eval_slam, eval_trajectory, eval_wheels,
};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum EvalCommand {
    /// ATE, RPE and drift of a trajectory file, as evo and KITTI compute them.
    Trajectory(eval_trajectory::TrajectoryArgs),
    /// A trajectory judged by relative poses that were checked by hand (Kuemmerle et al. 2009).
    Relations(eval_relations::RelationsArgs),
    /// A pose graph in a g2o file, optimised from its poses or from its measurements alone, whichever start is better.
    Graph(eval_graph::GraphArgs),
    /// The whole pipeline in simulated sessions with loops, kidnaps and other trouble, against exact truth.
    Slam(eval_slam::SlamArgs),
    /// A recording whose wheels lie at chosen places, beside the same with honest wheels and with none.
    Wheels(eval_wheels::WheelsArgs),
    /// A recording with a part cut out, after which the robot has to find itself again.
    Gap(eval_gap::GapArgs),
    /// Objects found in simulated worlds, and what is told of how they lie: precision and recall, calibration, ghosts.
    Objects(eval_objects::ObjectsArgs),
    /// Paths planned in simulated worlds, checked against the true occupancy.
    Planning(eval_planning::PlanningArgs),
}

pub(crate) fn run(command: EvalCommand) -> Result<(), Failure> {
    match command {
        EvalCommand::Trajectory(args) => eval_trajectory::run(&args),
        EvalCommand::Relations(args) => eval_relations::run(&args),
        EvalCommand::Graph(args) => eval_graph::run(&args),
        EvalCommand::Slam(args) => eval_slam::run(&args),
        EvalCommand::Wheels(args) => eval_wheels::run(&args),
        EvalCommand::Gap(args) => eval_gap::run(&args),
        EvalCommand::Objects(args) => eval_objects::objects(&args),
        EvalCommand::Planning(args) => eval_planning::planning(&args),
    }
}

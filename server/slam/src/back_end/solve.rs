//! The graph of a chain and its loops, solved robustly.

use super::chain::Chain;
use super::consistency::{AGREE, Constraint, chi2};
use crate::pose_graph::{Edge, Equations, OptimiseParams, PoseGraph, Structure, information_of};
use nalgebra::Matrix6;
use percept_geometry::{Covariance6, Pose};

/// How thoroughly a graph is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Effort {
    /// The poses explain the loops: those are weighed by how they fit, and solved once.
    Routine,
    /// Loops have come that the poses do not know of: all loops have their full weight at first, and lose it in rounds of
    /// solving and weighing.
    Thorough,
}

/// Rounds of solving and weighing, in a thorough solution. Halved and doubled as it is ([`crate::loops::planar`]).
const ROUNDS: usize = 3;
/// Steps of the solver in a round. Halved and doubled as it is ([`crate::loops::planar`]).
const STEPS: usize = 8;

/// Where the keyframes are.
pub(super) struct Solved {
    pub(super) poses: Vec<Pose>,
    /// Of the last one in the map, right perturbation in base.
    pub(super) covariance_of_newest: Covariance6,
}

/// Least squares over the steps, and Geman and McClure's weights on the loops: one that contradicts the rest fades out.
pub(super) fn solve(chain: &Chain, constraints: &[Constraint<'_>], poses: &[Pose], effort: Effort) -> Option<Solved> {
    let mut graph = PoseGraph::<Pose, 6> { poses: poses.to_vec(), edges: vec![], fixed: vec![0] };
    for step in chain.steps() {
        let information = information_of(&step.covariance)?;
        graph.edges.push(Edge { from: step.from, to: step.to, t_from_to: step.t_from_to, information });
    }
    let steps = graph.edges.len();
    for constraint in constraints {
        let information = information_of(&constraint.closure.covariance)?;
        graph.edges.push(Edge {
            from: constraint.from,
            to: constraint.to,
            t_from_to: constraint.closure.t_from_to,
            information,
        });
    }
    let full: Vec<Matrix6<f64>> = graph.edges[steps..].iter().map(|e| e.information).collect();
    let params = OptimiseParams { max_iterations: STEPS, tolerance: 1e-4 };
    let structure = Structure::of(&graph).ok()?;
    let mut equations = Equations::of(&graph, &structure).ok()?;
    let weigh = |graph: &mut PoseGraph<Pose, 6>| {
        for (k, constraint) in constraints.iter().enumerate() {
            let off =
                chi2(constraint.closure, &graph.poses[constraint.from as usize], &graph.poses[constraint.to as usize]);
            let weight = (AGREE / (AGREE + off)).powi(2);
            graph.edges[steps + k].information = full[k] * weight.max(1e-6);
        }
    };
    match effort {
        Effort::Routine => {
            weigh(&mut graph);
            equations.optimise(&mut graph, &params).ok()?;
        }
        Effort::Thorough => {
            equations.optimise(&mut graph, &params).ok()?;
            for _ in 1..ROUNDS {
                weigh(&mut graph);
                equations.optimise(&mut graph, &params).ok()?;
            }
        }
    }
    let newest = graph.poses.len() as u32 - 1;
    let covariance_of_newest = equations.covariance_of(&graph, newest).ok()?;
    Some(Solved { poses: graph.poses, covariance_of_newest })
}

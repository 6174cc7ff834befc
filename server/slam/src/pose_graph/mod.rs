//! Pose graphs: poses, what was measured between them, and the poses that explain that best.
//!
//! Comes in: a [`PoseGraph`] of poses in the plane ([`PlanarPose`]) or in space. [`chordal`] finds poses from the
//! measurements alone, [`optimise()`] improves those that are there, [`solve`] does what a user wants: from whichever start
//! is better, and a planar graph from others as long as nothing proves that no poses are better. Errors and their weights
//! are g2o's, so that chi2 can be compared.

mod certificate;
mod cholesky;
mod covariance;
mod lifted;
mod manifold;
mod minorant;
mod normal;
mod optimise;
mod pattern;
mod sparse;
mod start;

#[cfg(test)]
mod tests;

pub use covariance::covariance_of;
pub(crate) use manifold::information_of;
pub use manifold::{Linearised, Manifold, PlanarPose};
pub use minorant::Minorant;
pub(crate) use normal::Equations;
pub use optimise::{OptimiseParams, OptimiseReport, optimise};
pub use start::chordal;

use nalgebra::{SMatrix, SVector};
use pattern::Pattern;
use percept_geometry::information::is_information;

/// Lifts into space at most. Halved and doubled, the same minima are found (`evaluate graph MIT.g2o noise=0.2 seeds=4`
/// and `intel.g2o noise=0.1 seeds=2`).
const MOST_LIFTS: u64 = 4;
/// Minima whose chi2 differ by less than this share are one that was not reached exactly. As a minimum in space is
/// known (see `lifted`).
const SAME: f64 = 1e-5;

/// A measured pose of one node seen from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge<P, const D: usize> {
    /// Index of the node that the measurement is seen from.
    pub from: u32,
    /// Index of the node that is measured.
    pub to: u32,
    /// The measurement.
    pub t_from_to: P,
    /// Inverse covariance of its error, symmetric: per square metre, then per square radian (in space: of half the
    /// radians, the vector part of a quaternion).
    pub information: SMatrix<f64, D, D>,
}

/// Poses and what was measured between them.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseGraph<P, const D: usize> {
    /// Poses of the nodes, metres.
    pub poses: Vec<P>,
    /// Measurements.
    pub edges: Vec<Edge<P, D>>,
    /// Nodes that stay where they are. With none, nothing says where the graph is: name at least one of each connected part.
    pub fixed: Vec<u32>,
}

/// Why a graph cannot be solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseGraphError {
    /// An edge or a fixed node names a node that is not there.
    #[error("{field}: node {node} is not one of {num_nodes}")]
    NoSuchNode {
        /// What names it, e.g. `edges[3].to`.
        field: String,
        /// The node.
        node: u32,
        /// Nodes that are there.
        num_nodes: usize,
    },
    /// An edge that cannot be used.
    #[error("edges[{edge}].{field} is not {requirement}")]
    BadEdge {
        /// Its index.
        edge: usize,
        /// The field.
        field: &'static str,
        /// What it has to be.
        requirement: &'static str,
    },
    /// No chain of edges leads from a fixed node to this one.
    #[error("node {node} is not connected with a fixed node; fix one of its part, or leave it out")]
    Unconnected {
        /// The first of them.
        node: u32,
    },
    /// The equations are not positive definite, or do not fit the memory.
    #[error(
        "the equations cannot be solved: an edge's information leaves something open, or so many edges tie far nodes that they do not fit the memory"
    )]
    NotSolvable,
}

impl From<pattern::NotSolvable> for PoseGraphError {
    fn from(_: pattern::NotSolvable) -> Self {
        Self::NotSolvable
    }
}

impl<P: Manifold<D>, const D: usize> PoseGraph<P, D> {
    /// Sum of squared errors weighted by their information, with these poses instead of the graph's.
    pub fn chi2_of(&self, poses: &[P]) -> f64 {
        let one = |e: &Edge<P, D>| {
            let r = P::error(&e.t_from_to, &poses[e.from as usize], &poses[e.to as usize]);
            r.dot(&(e.information * r))
        };
        self.edges.iter().map(one).sum()
    }

    /// Sum of squared errors weighted by their information.
    pub fn chi2(&self) -> f64 {
        self.chi2_of(&self.poses)
    }

    /// Checks that every name is that of a node, every number is finite, and every node hangs on a fixed one.
    ///
    /// # Errors
    /// `NoSuchNode`, `BadEdge`, `Unconnected`.
    pub fn validate(&self) -> Result<(), PoseGraphError> {
        let num_nodes = self.poses.len();
        let known = |field: &dyn Fn() -> String, node: u32| match (node as usize) < num_nodes {
            true => Ok(()),
            false => Err(PoseGraphError::NoSuchNode { field: field(), node, num_nodes }),
        };
        for (k, &node) in self.fixed.iter().enumerate() {
            known(&|| format!("fixed[{k}]"), node)?;
        }
        // Union of connected nodes; the root of every part is fixed if one of the part is.
        let mut parent: Vec<u32> = (0..num_nodes as u32).collect();
        fn root(parent: &mut [u32], mut node: u32) -> u32 {
            while parent[node as usize] != node {
                parent[node as usize] = parent[parent[node as usize] as usize];
                node = parent[node as usize];
            }
            node
        }
        for (edge, e) in self.edges.iter().enumerate() {
            known(&|| format!("edges[{edge}].from"), e.from)?;
            known(&|| format!("edges[{edge}].to"), e.to)?;
            let bad = |field, requirement| Err(PoseGraphError::BadEdge { edge, field, requirement });
            if e.from == e.to {
                return bad("to", "another node than the edge's first");
            }
            if !e.t_from_to.position().iter().chain(e.t_from_to.rotation().iter()).all(|v| v.is_finite()) {
                return bad("t_from_to", "finite");
            }
            let information = &e.information;
            let asymmetry = (information - information.transpose()).amax();
            if asymmetry > 1e-9 * information.amax() || !is_information(information) {
                return bad("information", "finite, symmetric and positive semi-definite");
            }
            let (a, b) = (root(&mut parent, e.from), root(&mut parent, e.to));
            parent[a.max(b) as usize] = a.min(b);
        }
        let mut is_held = vec![false; num_nodes];
        self.fixed.iter().for_each(|&node| is_held[root(&mut parent, node) as usize] = true);
        let loose = (0..num_nodes as u32).find(|&node| !is_held[root(&mut parent, node) as usize]);
        loose.map_or(Ok(()), |node| Err(PoseGraphError::Unconnected { node }))
    }
}

/// Places of the nodes that may move among the unknowns.
struct Unknowns {
    place: Vec<Option<u32>>,
    nodes: Vec<u32>,
}

impl Unknowns {
    fn of<P, const D: usize>(graph: &PoseGraph<P, D>) -> Self {
        let mut is_fixed = vec![false; graph.poses.len()];
        graph.fixed.iter().for_each(|&node| is_fixed[node as usize] = true);
        let nodes: Vec<u32> = (0..graph.poses.len() as u32).filter(|&n| !is_fixed[n as usize]).collect();
        let mut place = vec![None; graph.poses.len()];
        nodes.iter().enumerate().for_each(|(k, &n)| place[n as usize] = Some(k as u32));
        Self { place, nodes }
    }

    /// Places of an edge's ends.
    fn ends<P, const D: usize>(&self, e: &Edge<P, D>) -> (Option<u32>, Option<u32>) {
        (self.place[e.from as usize], self.place[e.to as usize])
    }

    /// The poses after a step back by this much of each that may move.
    fn moved<P: Manifold<D>, const D: usize>(&self, poses: &[P], step: &[SVector<f64, D>]) -> Vec<P> {
        let mut moved = poses.to_vec();
        self.nodes.iter().zip(step).for_each(|(&n, d)| moved[n as usize] = moved[n as usize].step(&-d));
        moved
    }
}

/// What all equations of a graph have in common.
pub(crate) struct Structure {
    unknowns: Unknowns,
    pattern: Pattern,
}

impl Structure {
    /// Of a graph, which is checked.
    ///
    /// # Errors
    /// As [`PoseGraph::validate`]; `NotSolvable` if it does not fit the memory.
    pub(crate) fn of<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>) -> Result<Self, PoseGraphError> {
        graph.validate()?;
        let unknowns = Unknowns::of(graph);
        let both = |e| match unknowns.ends(e) {
            (Some(a), Some(b)) => Some((a, b)),
            _ => None,
        };
        let coupled: Vec<(u32, u32)> = graph.edges.iter().filter_map(both).collect();
        let pattern = Pattern::new(unknowns.nodes.len(), &coupled)?;
        Ok(Self { unknowns, pattern })
    }
}

/// Optimises from the graph's poses or from [`chordal`]'s, whichever explain the measurements better; `has_poses` is
/// false if the graph's say nothing.
///
/// A start that is far off ends in a minimum that is not the least one: the measurements alone often know better. Where
/// nothing proves that the minimum is the least, a planar graph with one fixed node is optimised again from where space
/// leads to, and the best is kept; this takes some 50 times as long. `max_iterations` is of each optimisation.
///
/// # Errors
/// As [`PoseGraph::validate`]; `NotSolvable`.
pub fn solve<P: Manifold<D>, const D: usize>(
    graph: &mut PoseGraph<P, D>,
    has_poses: bool,
    params: &OptimiseParams,
) -> Result<OptimiseReport, PoseGraphError> {
    let structure = Structure::of(graph)?;
    let given = if has_poses { graph.chi2() } else { f64::INFINITY };
    let found = start::chordal_of(graph, &structure)?;
    // A start that is nearly as good is the user's own.
    if graph.chi2_of(&found) < given {
        graph.poses = found;
    }
    let mut equations = Equations::of(graph, &structure)?;
    let report = equations.optimise(graph, params)?;
    let is_certified = report.converged && certificate::is_certified(graph, &structure);
    let chi2_start = if has_poses { given } else { report.chi2_start };
    let report = OptimiseReport { chi2_start, is_certified, ..report };
    match is_certified || !report.converged {
        true => Ok(report),
        false => leave_minimum(graph, &structure, &mut equations, params, report),
    }
}

/// Optimises again from where space leads to, as long as that lowers chi2 and nothing proves that no poses are better.
fn leave_minimum<P: Manifold<D>, const D: usize>(
    graph: &mut PoseGraph<P, D>,
    structure: &Structure,
    equations: &mut Equations<'_, D>,
    params: &OptimiseParams,
    mut report: OptimiseReport,
) -> Result<OptimiseReport, PoseGraphError> {
    for seed in 0..MOST_LIFTS {
        let before = report.chi2;
        for poses in lifted::from_space(graph, structure, seed)? {
            let best = std::mem::replace(&mut graph.poses, poses);
            let OptimiseReport { chi2, iterations, converged, .. } = equations.optimise(graph, params)?;
            report.iterations += iterations;
            if chi2 < report.chi2 {
                let is_certified = converged && certificate::is_certified(graph, structure);
                report = OptimiseReport { chi2, converged, is_certified, ..report };
            } else {
                graph.poses = best;
            }
        }
        if report.is_certified || report.chi2 > (1.0 - SAME) * before {
            break;
        }
    }
    Ok(report)
}

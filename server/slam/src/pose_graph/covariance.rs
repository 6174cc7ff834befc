//! How sure a pose is, given all that was measured.

use super::normal::Normal;
use super::sparse::Solver;
use super::{Manifold, PoseGraph, PoseGraphError, Unknowns};
use nalgebra::SMatrix;

/// Marginal covariance of a node's pose at the graph's poses, by [`Manifold::step`]: zero for a fixed one.
///
/// The block of the inverse of the normal equations that belongs to the node.
///
/// # Errors
/// As [`PoseGraph::validate`]; `NotSolvable`.
pub fn covariance_of<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    node: u32,
) -> Result<SMatrix<f64, D, D>, PoseGraphError> {
    graph.validate()?;
    let num_nodes = graph.poses.len();
    let unknowns = Unknowns::of(graph);
    let place = unknowns.place.get(node as usize).ok_or(PoseGraphError::NoSuchNode {
        field: "node".to_owned(),
        node,
        num_nodes,
    })?;
    let Some(place) = place else { return Ok(SMatrix::zeros()) };
    let pattern = unknowns.pattern(graph)?;
    let mut solver = Solver::<D>::new(&pattern)?;
    let mut normal = Normal::new(graph, &unknowns, &pattern);
    normal.fill(graph);
    solver.factorise(&normal.blocks, 0.0)?;
    Ok(solver.inverse_of(*place))
}

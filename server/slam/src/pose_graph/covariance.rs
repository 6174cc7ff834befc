//! How sure a pose is, given all that was measured.

use super::{Equations, Manifold, PoseGraph, PoseGraphError, Structure};
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
    let structure = Structure::of(graph)?;
    Equations::of(graph, &structure)?.covariance_of(graph, node)
}

impl<const D: usize> Equations<'_, D> {
    /// [`covariance_of()`] in a graph that they were set up for.
    pub(crate) fn covariance_of<P: Manifold<D>>(
        &mut self,
        graph: &PoseGraph<P, D>,
        node: u32,
    ) -> Result<SMatrix<f64, D, D>, PoseGraphError> {
        let num_nodes = graph.poses.len();
        let place = self.unknowns.place.get(node as usize);
        let place = place.ok_or(PoseGraphError::NoSuchNode { field: "node".to_owned(), node, num_nodes })?;
        let Some(place) = *place else { return Ok(SMatrix::zeros()) };
        self.fill(graph, &graph.poses);
        self.factorise(0.0)?;
        Ok(self.solver.inverse_of(place))
    }
}

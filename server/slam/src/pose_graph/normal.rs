//! The normal equations of a pose graph at its poses.

use super::sparse::{NotSolvable, Solver};
use super::{Manifold, PoseGraph, PoseGraphError, Structure, Unknowns};
use nalgebra::{SMatrix, SVector};

/// A graph's normal equations, set up once to be solved again and again: at other poses, with other weights.
pub(crate) struct Equations<'a, const D: usize> {
    pub(super) unknowns: &'a Unknowns,
    pub(super) solver: Solver<'a, D>,
    blocks: Vec<SMatrix<f64, D, D>>,
    pub(super) gradient: Vec<SVector<f64, D>>,
    targets: Vec<Target>,
}

/// Where an edge's blocks go.
struct Target {
    from: Option<(usize, usize)>,
    to: Option<(usize, usize)>,
    coupling: Option<(usize, bool)>,
}

impl<'a, const D: usize> Equations<'a, D> {
    /// For graphs of this structure, such as this one.
    ///
    /// # Errors
    /// `NotSolvable` if they do not fit the memory.
    pub(crate) fn of<P>(graph: &PoseGraph<P, D>, structure: &'a Structure) -> Result<Self, PoseGraphError> {
        let Structure { unknowns, pattern } = structure;
        let target = |e| {
            let (from, to) = unknowns.ends(e);
            let own = |place: u32| (place as usize, pattern.diagonal(place));
            let coupling = from.zip(to).and_then(|(a, b)| pattern.block(a, b));
            Target { from: from.map(own), to: to.map(own), coupling }
        };
        Ok(Self {
            unknowns,
            solver: Solver::new(pattern)?,
            blocks: vec![SMatrix::zeros(); pattern.num_blocks()],
            gradient: vec![SVector::zeros(); pattern.len()],
            targets: graph.edges.iter().map(target).collect(),
        })
    }

    /// Factorises them, the diagonal multiplied by `1 + damping`.
    pub(super) fn factorise(&mut self, damping: f64) -> Result<(), NotSolvable> {
        self.solver.factorise(&self.blocks, damping)
    }

    /// Gradient of what the errors at `next` have beyond those that the linear system expects after this step there.
    pub(super) fn bend<P: Manifold<D>>(
        &self,
        graph: &PoseGraph<P, D>,
        next: &[P],
        step: &[SVector<f64, D>],
    ) -> Vec<SVector<f64, D>> {
        let mut bend = vec![SVector::zeros(); step.len()];
        for (edge, target) in graph.edges.iter().zip(&self.targets) {
            let (from, to) = (edge.from as usize, edge.to as usize);
            let l = P::linearise(&edge.t_from_to, &graph.poses[from], &graph.poses[to]);
            let ends = [(target.from, l.from), (target.to, l.to)];
            let mut beyond = P::error(&edge.t_from_to, &next[from], &next[to]) - l.error;
            for ((place, _), by_end) in ends.iter().filter_map(|(t, m)| t.zip(Some(m))) {
                beyond += by_end * step[place];
            }
            let weighted = edge.information * beyond;
            for ((place, _), by_end) in ends.iter().filter_map(|(t, m)| t.zip(Some(m))) {
                bend[place] += by_end.transpose() * weighted;
            }
        }
        bend
    }

    /// Linearises at the graph's poses.
    pub(super) fn fill<P: Manifold<D>>(&mut self, graph: &PoseGraph<P, D>) {
        self.blocks.iter_mut().for_each(|b| *b = SMatrix::zeros());
        self.gradient.iter_mut().for_each(|g| *g = SVector::zeros());
        for (edge, target) in graph.edges.iter().zip(&self.targets) {
            let (from, to) = (edge.from as usize, edge.to as usize);
            let l = P::linearise(&edge.t_from_to, &graph.poses[from], &graph.poses[to]);
            let weighted_from = l.from.transpose() * edge.information;
            let weighted_to = l.to.transpose() * edge.information;
            if let Some((place, block)) = target.from {
                self.blocks[block] += weighted_from * l.from;
                self.gradient[place] += weighted_from * l.error;
            }
            if let Some((place, block)) = target.to {
                self.blocks[block] += weighted_to * l.to;
                self.gradient[place] += weighted_to * l.error;
            }
            match target.coupling {
                Some((block, true)) => self.blocks[block] += weighted_from * l.to,
                Some((block, false)) => self.blocks[block] += weighted_to * l.from,
                None => {}
            }
        }
    }
}

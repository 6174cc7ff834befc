//! The normal equations of a pose graph at its poses.

use super::pattern::NotSolvable;
use super::sparse::Solver;
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

    /// Poses with the same rotations, and positions where chi2 is least with these: one linear system, as the errors are
    /// linear in the shifts. The equations are those of that system afterwards.
    pub(super) fn with_best_positions<P: Manifold<D>>(
        &mut self,
        graph: &PoseGraph<P, D>,
        poses: &[P],
    ) -> Result<Vec<P>, NotSolvable> {
        self.fill(graph, poses);
        for block in &mut self.blocks {
            *block = SMatrix::from_fn(|r, c| if r.max(c) < P::SHIFTS { block[(r, c)] } else { 0.0 });
        }
        let pattern = self.solver.pattern();
        for (place, gradient) in (0..).zip(&mut self.gradient) {
            let block = &mut self.blocks[pattern.diagonal(place)];
            (P::SHIFTS..D).for_each(|r| (block[(r, r)], gradient[r]) = (1.0, 0.0));
        }
        self.factorise(0.0)?;
        let mut step = self.gradient.clone();
        self.solver.solve(&mut step);
        Ok(self.unknowns.moved(poses, &step))
    }

    /// Linearises at these poses instead of the graph's.
    pub(super) fn fill<P: Manifold<D>>(&mut self, graph: &PoseGraph<P, D>, poses: &[P]) {
        self.blocks.iter_mut().for_each(|b| *b = SMatrix::zeros());
        self.gradient.iter_mut().for_each(|g| *g = SVector::zeros());
        for (edge, target) in graph.edges.iter().zip(&self.targets) {
            let (from, to) = (edge.from as usize, edge.to as usize);
            let l = P::linearise(&edge.t_from_to, &poses[from], &poses[to]);
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

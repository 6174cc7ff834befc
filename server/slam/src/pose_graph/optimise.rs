//! Levenberg-Marquardt on a pose graph.

use super::sparse::{Pattern, Solver};
use super::{Manifold, PoseGraph, PoseGraphError, Unknowns};
use nalgebra::{SMatrix, SVector};

/// Damping beyond this: no step leads down.
const MOST_DAMPING: f64 = 1e6;
/// Damping after a first step that was taken back; less than a hundredth of it is none.
const FIRST_DAMPING: f64 = 1e-6;

/// Parameters of [`optimise()`].
#[derive(Debug, Clone, PartialEq)]
pub struct OptimiseParams {
    /// Steps at most, those that were taken back among them.
    pub max_iterations: usize,
    /// Converged once a step lowers chi2 by less than this share of it.
    pub tolerance: f64,
}

impl Default for OptimiseParams {
    fn default() -> Self {
        Self { max_iterations: 100, tolerance: 1e-6 }
    }
}

/// How an optimisation went.
#[derive(Debug, Clone, PartialEq)]
pub struct OptimiseReport {
    /// Before.
    pub chi2_start: f64,
    /// After.
    pub chi2: f64,
    /// Steps, those that were taken back among them.
    pub iterations: usize,
    /// Whether it ended because nothing more was to be gained.
    pub converged: bool,
}

/// Moves the poses to where chi2 is least, from where they are. Steps start as Gauss-Newton's and are damped, by shares
/// of the diagonal, when they lead up.
///
/// Source: Marquardt 1963; the damping's schedule by gain is that of Madsen, Nielsen and Tingleff, "Methods for
/// non-linear least squares problems", 2004.
///
/// # Errors
/// As [`PoseGraph::validate`]; `NotSolvable` if even a damped system cannot be solved.
pub fn optimise<P: Manifold<D>, const D: usize>(
    graph: &mut PoseGraph<P, D>,
    params: &OptimiseParams,
) -> Result<OptimiseReport, PoseGraphError> {
    graph.validate()?;
    let unknowns = Unknowns::of(graph);
    let chi2 = graph.chi2();
    let mut report = OptimiseReport { chi2_start: chi2, chi2, iterations: 0, converged: true };
    if unknowns.nodes.is_empty() || graph.edges.is_empty() {
        return Ok(report);
    }
    let mut solver = Solver::<D>::new(unknowns.pattern(graph)?, 1)?;
    let mut normal = Normal::new(graph, &unknowns, solver.pattern());
    normal.fill(graph);
    let (mut damping, mut growth) = (0.0, 2.0);
    report.converged = false;
    while report.iterations < params.max_iterations && !report.converged {
        report.iterations += 1;
        let mut step = normal.gradient.clone();
        let is_solved = solver.factorise(&normal.blocks, damping).is_ok();
        let mut next = graph.poses.clone();
        if is_solved {
            solver.solve(&mut step);
            unknowns.nodes.iter().zip(&step).for_each(|(&n, d)| next[n as usize] = next[n as usize].step(&-d));
        }
        let chi2 = graph.chi2_of(&next);
        if is_solved && chi2 <= report.chi2 {
            let lowered = report.chi2 - chi2;
            // What the linear system promised.
            let promised: f64 = normal.gradient.iter().zip(&step).map(|(g, d)| g.dot(d)).sum();
            let gain = lowered / promised.max(f64::MIN_POSITIVE);
            report.converged = lowered <= params.tolerance * report.chi2;
            (graph.poses, report.chi2) = (next, chi2);
            damping = match gain {
                g if g > 0.75 && damping < FIRST_DAMPING / 100.0 => 0.0,
                g if g > 0.75 => damping / 10.0,
                g if g < 0.25 => (damping * 2.0).max(FIRST_DAMPING / 100.0),
                _ => damping,
            };
            growth = 2.0;
            if !report.converged {
                normal.fill(graph);
            }
        } else {
            damping = (damping * growth).max(FIRST_DAMPING);
            growth *= 2.0;
            if damping > MOST_DAMPING {
                if !is_solved {
                    return Err(PoseGraphError::NotSolvable);
                }
                report.converged = true;
            }
        }
    }
    Ok(report)
}

/// The linearised problem.
pub(super) struct Normal<const D: usize> {
    pub(super) blocks: Vec<SMatrix<f64, D, D>>,
    gradient: Vec<SVector<f64, D>>,
    targets: Vec<Target>,
}

/// Where an edge's blocks go.
struct Target {
    from: Option<(usize, usize)>,
    to: Option<(usize, usize)>,
    coupling: Option<(usize, bool)>,
}

impl<const D: usize> Normal<D> {
    pub(super) fn new<P>(graph: &PoseGraph<P, D>, unknowns: &Unknowns, pattern: &Pattern) -> Self {
        let target = |e| {
            let (from, to) = unknowns.ends(e);
            let own = |place: u32| (place as usize, pattern.diagonal(place));
            let coupling = from.zip(to).and_then(|(a, b)| pattern.block(a, b));
            Target { from: from.map(own), to: to.map(own), coupling }
        };
        Self {
            blocks: vec![SMatrix::zeros(); pattern.num_blocks()],
            gradient: vec![SVector::zeros(); pattern.len()],
            targets: graph.edges.iter().map(target).collect(),
        }
    }

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

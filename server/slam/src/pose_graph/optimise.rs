//! Levenberg-Marquardt on a pose graph.

use super::{Equations, Manifold, PoseGraph, PoseGraphError, Structure};

/// Damping beyond this: no step leads down. A millionth of a Newton step.
const MOST_DAMPING: f64 = 1e6;
/// Damping after a first step that was taken back; less than a hundredth of it is none. The slowest motions of graphs of
/// some thousand poses weigh 1e-8 of the diagonal: more damping would hold them.
const FIRST_DAMPING: f64 = 1e-9;
/// Positions are found anew after steps that keep less than this share of what they promise. Nocedal and Wright,
/// "Numerical Optimization", 2006, chapter 4: a step of a trust region that keeps less than a quarter is poor.
const WORST_GAIN: f64 = 0.25;
/// Errors of this many standard deviations are none: they are in the last digits of the poses.
const NO_ERROR: f64 = 1e-10;

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
    /// Whether it is proven that no poses have a lower chi2. False says nothing: there may be no proof, and only
    /// [`solve`](super::solve) looks for one.
    pub is_certified: bool,
}

/// Moves the poses to where chi2 is least, from where they are. Steps start as Gauss-Newton's; where one leads up, or
/// hardly down, positions are found anew for the rotations that it leads to, and where that does not help, it is damped, by
/// shares of the diagonal.
///
/// Source: Marquardt 1963; the damping's schedule by gain is that of Madsen, Nielsen and Tingleff, "Methods for
/// non-linear least squares problems", 2004. Errors are linear in positions, so that those are a function of the
/// rotations: Golub and Pereyra, "Separable nonlinear least squares: the variable projection method and its
/// applications", 2003; after a step of all, as Ruhe and Wedin compare it, "Algorithms for separable nonlinear
/// least squares problems", 1980. A part of the map that turns as a whole would swell in a straight step.
///
/// # Errors
/// As [`PoseGraph::validate`]; `NotSolvable` if even a damped system cannot be solved.
pub fn optimise<P: Manifold<D>, const D: usize>(
    graph: &mut PoseGraph<P, D>,
    params: &OptimiseParams,
) -> Result<OptimiseReport, PoseGraphError> {
    let structure = Structure::of(graph)?;
    Equations::of(graph, &structure)?.optimise(graph, params)
}

impl<const D: usize> Equations<'_, D> {
    /// [`optimise()`] of a graph that they were set up for: other poses and weights may be in it, not other edges.
    pub(crate) fn optimise<P: Manifold<D>>(
        &mut self,
        graph: &mut PoseGraph<P, D>,
        params: &OptimiseParams,
    ) -> Result<OptimiseReport, PoseGraphError> {
        let chi2 = graph.chi2();
        let mut report = OptimiseReport { chi2_start: chi2, chi2, iterations: 0, converged: true, is_certified: false };
        if self.unknowns.nodes.is_empty() || graph.edges.is_empty() {
            return Ok(report);
        }
        self.fill(graph, &graph.poses);
        let (mut damping, mut growth) = (0.0, 2.0);
        let nothing = NO_ERROR.powi(2) * graph.edges.len() as f64;
        report.converged = chi2 <= nothing;
        while report.iterations < params.max_iterations && !report.converged {
            report.iterations += 1;
            let is_solved = self.factorise(damping).is_ok();
            let step = is_solved.then(|| Step::of(graph, self, report.chi2));
            match step {
                Some(step) if step.chi2 <= report.chi2 => {
                    let lowered = report.chi2 - step.chi2;
                    report.converged = lowered <= params.tolerance * report.chi2 || step.chi2 <= nothing;
                    damping = relaxed(damping, lowered / step.promised.max(f64::MIN_POSITIVE));
                    (graph.poses, report.chi2, growth) = (step.poses, step.chi2, 2.0);
                    if !report.converged {
                        self.fill(graph, &graph.poses);
                    }
                }
                // What is left to gain is lost in the last digits.
                Some(step) if step.promised <= params.tolerance * report.chi2 => report.converged = true,
                _ => {
                    self.fill(graph, &graph.poses);
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
        }
        Ok(report)
    }
}

/// Damping after a step that led down, by the share of what was promised that came true.
fn relaxed(damping: f64, gain: f64) -> f64 {
    match gain {
        g if g > 0.75 && damping < FIRST_DAMPING / 100.0 => 0.0,
        g if g > 0.75 => damping / 10.0,
        g if g < 0.25 => (damping * 2.0).max(FIRST_DAMPING / 100.0),
        _ => damping,
    }
}

/// Where a step leads.
struct Step<P> {
    poses: Vec<P>,
    chi2: f64,
    /// By how much the linear system says that chi2 falls.
    promised: f64,
}

impl<P> Step<P> {
    /// From the graph's poses, whose chi2 is `before`, by the equations last factorised; they may be others afterwards.
    fn of<const D: usize>(graph: &PoseGraph<P, D>, equations: &mut Equations<'_, D>, before: f64) -> Self
    where
        P: Manifold<D>,
    {
        let mut step = equations.gradient.clone();
        equations.solver.solve(&mut step);
        let promised: f64 = equations.gradient.iter().zip(&step).map(|(g, d)| g.dot(d)).sum();
        let poses = equations.unknowns.moved(&graph.poses, &step);
        let straight = Self { chi2: graph.chi2_of(&poses), poses, promised };
        if straight.chi2 <= before - WORST_GAIN * promised {
            return straight;
        }
        let better = equations.with_best_positions(graph, &straight.poses);
        let better = better.map(|poses| Self { chi2: graph.chi2_of(&poses), poses, promised });
        better.ok().filter(|b| b.chi2 < straight.chi2).unwrap_or(straight)
    }
}

//! 6x6 normal equations, summed in fixed chunks so that the number of threads changes nothing.

use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

/// Sums of `J' w J`, `J' w r`, `w r^2` and `w` over residuals of one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations {
    // Upper triangle, row by row.
    hessian: [f64; 21],
    gradient: [f64; 6],
    /// Sum of `w r^2`.
    pub cost: f64,
    /// Sum of the weights given with [`NormalEquations::add`].
    pub weight: f64,
    /// Residuals added.
    pub num_residuals: usize,
}

impl Default for NormalEquations {
    fn default() -> Self {
        Self { hessian: [0.0; 21], gradient: [0.0; 6], cost: 0.0, weight: 0.0, num_residuals: 0 }
    }
}

impl NormalEquations {
    /// Adds a scalar residual with its Jacobian row and weight.
    #[inline]
    pub fn add(&mut self, jacobian: &[f64; 6], residual: f64, weight: f64) {
        let mut k = 0;
        for i in 0..6 {
            let wj = weight * jacobian[i];
            self.gradient[i] += wj * residual;
            for j in jacobian.iter().skip(i) {
                self.hessian[k] += wj * j;
                k += 1;
            }
        }
        self.cost += weight * residual * residual;
        self.weight += weight;
        self.num_residuals += 1;
    }

    /// From sums made elsewhere: upper triangle of the Hessian row by row, gradient, cost. `weight` stays 0.
    pub(super) fn from_sums(sums: &[f64; 28], num_residuals: usize) -> Self {
        let mut out = Self { cost: sums[27], num_residuals, ..Self::default() };
        out.hessian.copy_from_slice(&sums[..21]);
        out.gradient.copy_from_slice(&sums[21..27]);
        out
    }

    /// Adds the sums of another.
    pub fn merge(&mut self, other: &Self) {
        for (a, b) in self.hessian.iter_mut().zip(&other.hessian) {
            *a += b;
        }
        for (a, b) in self.gradient.iter_mut().zip(&other.gradient) {
            *a += b;
        }
        self.cost += other.cost;
        self.weight += other.weight;
        self.num_residuals += other.num_residuals;
    }

    /// `J' w J`: the information of the residuals if the weights are inverse variances.
    pub fn hessian(&self) -> Matrix6<f64> {
        let mut out = Matrix6::zeros();
        let mut k = 0;
        for i in 0..6 {
            for j in i..6 {
                out[(i, j)] = self.hessian[k];
                out[(j, i)] = self.hessian[k];
                k += 1;
            }
        }
        out
    }

    /// `J' w r`.
    pub fn gradient(&self) -> Vector6<f64> {
        Vector6::from(self.gradient)
    }

    /// The Gauss-Newton step `-H^-1 g`, with Levenberg's damping as a share of the diagonal; none if
    /// the equations are singular.
    pub fn step(&self, damping: f64) -> Option<Vector6<f64>> {
        let mut h = self.hessian();
        for i in 0..6 {
            h[(i, i)] += damping * h[(i, i)];
        }
        let step = -h.cholesky()?.solve(&self.gradient());
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    /// Weighted root mean square of the residuals; 0 if there are none.
    pub fn rmse(&self) -> f64 {
        if self.weight > 0.0 { (self.cost / self.weight).sqrt() } else { 0.0 }
    }
}

/// Sums the residuals of items `0..num_items`: `add(i, equations)` adds those of item i.
///
/// Items are summed in chunks of `chunk` and the chunks in order, on rayon's current pool, so that the
/// result is the same to the last bit whatever the number of threads.
pub fn accumulate(num_items: usize, chunk: usize, add: impl Fn(usize, &mut NormalEquations) + Sync) -> NormalEquations {
    let one = |c: usize| {
        let mut equations = NormalEquations::default();
        for i in c * chunk..((c + 1) * chunk).min(num_items) {
            add(i, &mut equations);
        }
        equations
    };
    let parts: Vec<NormalEquations> = (0..num_items.div_ceil(chunk.max(1))).into_par_iter().map(one).collect();
    let mut total = NormalEquations::default();
    for part in &parts {
        total.merge(part);
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_do_not_depend_on_the_number_of_threads() {
        let run = |threads| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
                accumulate(10_000, 256, |i, e| {
                    let x = (i as f64 * 0.37).sin();
                    e.add(&[x, x * x, 1.0, 0.1 * x, x.cos(), -x], x / 3.0, 1.0 + x.abs());
                })
            })
        };
        assert_eq!(run(1), run(3));
        assert_eq!(run(1).num_residuals, 10_000);
    }

    #[test]
    fn the_step_solves_a_linear_problem_at_once() {
        let truth = [0.1, -0.2, 0.3, 0.05, -0.06, 0.07];
        let mut e = NormalEquations::default();
        for i in 0..20 {
            let j: [f64; 6] = std::array::from_fn(|k| ((i * i * (k + 2) + 3 * k) as f64).sin());
            let r: f64 = -j.iter().zip(&truth).map(|(a, b)| a * b).sum::<f64>();
            e.add(&j, r, 2.0);
        }
        assert!((e.step(0.0).unwrap() - Vector6::from(truth)).norm() < 1e-9);
        assert_eq!(NormalEquations::default().step(0.0), None);
    }
}

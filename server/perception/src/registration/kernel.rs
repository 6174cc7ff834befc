//! Robust kernels: how much a residual counts.

use serde::{Deserialize, Serialize};

/// Weight functions of iteratively reweighted least squares; `scale` is in the residual's unit.
///
/// Source: Zhang, "Parameter estimation techniques: a tutorial with application to conic fitting",
/// 1997, table 1; Geman-McClure scaled as in Vizzo et al., "KISS-ICP", 2023, eq. 9.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustKernel {
    /// Every residual counts fully.
    None,
    /// Quadratic to `scale`, linear beyond.
    Huber(f64),
    /// `(1 + (r / scale)^2)^-1`.
    Cauchy(f64),
    /// `(1 + (r / scale)^2)^-2`: outliers fade with the fourth power.
    GemanMcClure(f64),
    /// `(1 - (r / scale)^2)^2` to `scale`, nothing beyond.
    Tukey(f64),
}

impl RobustKernel {
    /// Weight of a residual, in [0, 1].
    pub fn weight(&self, residual: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Huber(scale) => {
                let r = residual.abs();
                if r <= scale { 1.0 } else { scale / r }
            }
            Self::Cauchy(scale) => 1.0 / (1.0 + (residual / scale).powi(2)),
            Self::GemanMcClure(scale) => 1.0 / (1.0 + (residual / scale).powi(2)).powi(2),
            Self::Tukey(scale) => {
                let x = residual / scale;
                if x.abs() < 1.0 { (1.0 - x * x).powi(2) } else { 0.0 }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_start_at_one_and_never_grow_with_the_residual() {
        for kernel in [
            RobustKernel::None,
            RobustKernel::Huber(0.5),
            RobustKernel::Cauchy(0.5),
            RobustKernel::GemanMcClure(0.5),
            RobustKernel::Tukey(0.5),
        ] {
            assert_eq!(kernel.weight(0.0), 1.0);
            let mut last = 1.0;
            for i in 1..50 {
                let w = kernel.weight(0.05 * f64::from(i));
                assert!((0.0..=last).contains(&w) && w == kernel.weight(-0.05 * f64::from(i)));
                last = w;
            }
        }
    }
}

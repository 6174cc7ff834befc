//! Covariances of poses.

use nalgebra::Vector6;
use percept_geometry::Covariance6;

/// Independent axes with these standard deviations (m, rad).
pub(crate) fn diagonal(sigma_t: f64, sigma_r: f64) -> Covariance6 {
    let (t, r) = (sigma_t * sigma_t, sigma_r * sigma_r);
    Covariance6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
}

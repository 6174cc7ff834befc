//! How strong gravity is.

/// Standard gravity rounded as is usual in robotics, m/s^2.
pub(super) const GRAVITY: f64 = 9.81;

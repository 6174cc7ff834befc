//! What is known of the motion between two frames before the second is looked at.

use percept_geometry::{Covariance6, Pose};

/// A prior whose position has a larger variance than this leaves the translation open, m^2. A hundred metres: nobody
/// who measured a way is that unsure of it.
pub(crate) const UNKNOWN_VARIANCE: f64 = 1e4;

/// What another source (wheels, an IMU) says about the motion since the frame before.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionPrior {
    /// Base now, seen from base at the frame before.
    pub t_prev_now: Pose,
    /// Of that motion, right perturbation in base now. Axes with standard deviations above 100 m are open, and prediction takes
    /// them from the velocity.
    pub covariance: Covariance6,
}

impl MotionPrior {
    /// Whether it says how far base moved, not only how it turned.
    pub(crate) fn tells_the_way(&self) -> bool {
        (0..3).all(|i| self.covariance[(i, i)] <= UNKNOWN_VARIANCE)
    }

    /// Whether it says nothing but how base turned, as a gyro does.
    pub(crate) fn is_turn_only(&self) -> bool {
        (0..3).all(|i| self.covariance[(i, i)] > UNKNOWN_VARIANCE)
    }
}

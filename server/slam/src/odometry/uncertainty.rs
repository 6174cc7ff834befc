//! Covariance of the pose since the start of odom.
//!
//! A frame placed in a local model is as sure as the model plus one measurement: standing still, the
//! error does not grow. It grows as the model is renewed: every half metre or 0.35 rad of motion replaces
//! about one model's worth of surfaces and adds one measurement's covariance. While lost, predictions
//! add up; placed again in the same model, what they added is gone.

use percept_geometry::{Covariance6, Pose, se3};

/// Motion after which the local model's errors are independent of what they were, metres and radians.
const RENEWAL: (f64, f64) = (0.5, 0.35);

#[derive(Debug, Clone, Default)]
pub(crate) struct Uncertainty {
    /// Of the local model where base is now.
    model: Covariance6,
    /// Of the predictions since the last placed frame.
    predicted: Covariance6,
    /// Motion since the last placed frame.
    since_placed: Pose,
    last: Covariance6,
}

impl Uncertainty {
    pub(crate) fn covariance(&self) -> Covariance6 {
        symmetric(&self.last)
    }

    /// A frame was placed `t_last_now` from the last estimate, with this covariance against the model.
    pub(crate) fn measured(&mut self, t_last_now: &Pose, covariance: &Covariance6) -> Covariance6 {
        let t_placed_now = self.since_placed * t_last_now;
        let share = t_placed_now.translation.vector.norm() / RENEWAL.0 + t_placed_now.rotation.angle() / RENEWAL.1;
        self.model = se3::compose_covariance(&self.model, &t_placed_now, &(covariance * share.min(1.0)));
        self.last = self.model + covariance;
        self.predicted = Covariance6::zeros();
        self.since_placed = Pose::identity();
        self.covariance()
    }

    /// A frame was not placed; its pose is a prediction.
    pub(crate) fn predicted(&mut self, t_last_now: &Pose, covariance: &Covariance6) {
        self.last = se3::compose_covariance(&self.last, t_last_now, covariance);
        self.predicted = se3::compose_covariance(&self.predicted, t_last_now, covariance);
        self.since_placed *= t_last_now;
    }

    /// A new local model starts where base is believed to be.
    pub(crate) fn restarted(&mut self) {
        self.model = se3::compose_covariance(&self.model, &self.since_placed, &self.predicted);
        self.last = self.model;
        self.predicted = Covariance6::zeros();
        self.since_placed = Pose::identity();
    }
}

fn symmetric(c: &Covariance6) -> Covariance6 {
    (c + c.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::diagonal;

    #[test]
    fn error_grows_with_motion_and_loss_but_not_with_time() {
        let mut u = Uncertainty::default();
        let one = diagonal(0.01, 0.01);
        let still = u.measured(&Pose::identity(), &one);
        for _ in 0..1000 {
            u.measured(&Pose::identity(), &one);
        }
        assert!((u.covariance() - still).norm() < 1e-12);
        for _ in 0..100 {
            u.measured(&se3::from_xy_yaw(0.1, 0.0, 0.0), &one);
        }
        // 10 m are 20 renewals: 21 measurements along x, more across it.
        let moved = u.covariance();
        assert!((moved[(0, 0)] / 1e-4 - 21.0).abs() < 1e-6 && moved[(1, 1)] > moved[(0, 0)]);
        u.predicted(&Pose::identity(), &diagonal(0.5, 0.5));
        assert!(u.covariance()[(0, 0)] > 0.25);
        assert!((u.measured(&Pose::identity(), &one) - moved).norm() < 1e-9);
        u.predicted(&Pose::identity(), &diagonal(0.5, 0.5));
        u.restarted();
        assert!(u.measured(&Pose::identity(), &one)[(0, 0)] > 0.25);
    }
}

//! What several sources say of one motion, each as far as it is sure.

use super::track::At;
use percept_geometry::{Covariance6, Pose, se3};
use percept_slam::MotionPrior;

/// Sources that differ by so many standard deviations do not both tell the truth.
const CONTRADICTS: f64 = 5.0;

/// The motion by wheels (and gyro) and by a second sensor, weighted by their information. Where they contradict each other the
/// second sensor is believed: it sees the surroundings, and wheels slip.
pub(in crate::frontend) fn fused(wheels: Option<MotionPrior>, second: Option<MotionPrior>) -> Option<MotionPrior> {
    let (Some(wheels), Some(second)) = (&wheels, &second) else { return second.or(wheels) };
    let off = se3::log(&second.t_prev_now.inv_mul(&wheels.t_prev_now));
    let both = || -> Option<MotionPrior> {
        let apart = (wheels.covariance + second.covariance).try_inverse()?;
        if (off.transpose() * apart * off)[0] > CONTRADICTS * CONTRADICTS {
            return None;
        }
        let (a, b) = (second.covariance.try_inverse()?, wheels.covariance.try_inverse()?);
        let covariance = (a + b).try_inverse()?;
        let t_prev_now = second.t_prev_now * se3::exp(&(covariance * b * off));
        Some(MotionPrior { t_prev_now, covariance: (covariance + covariance.transpose()) * 0.5 })
    };
    both().or_else(|| Some(second.clone()))
}

/// A motion to `to`, which the pose sensor has measured, or led on to.
pub(super) fn extrapolated(t_prev_now: Pose, to: &At) -> MotionPrior {
    let (way, turn) = (t_prev_now.translation.vector.norm(), t_prev_now.rotation.angle());
    // A mount that is a little off shows in the way; what lies ahead is a guess.
    let (t, r) = (0.01 + 0.1 * way + 0.1 * turn + 0.5 * to.ahead_s.powi(2), 0.005 + 0.05 * turn + to.ahead_s.powi(2));
    let covariance = Covariance6::from_diagonal(&[t * t, t * t, t * t, r * r, r * r, r * r].into());
    MotionPrior { t_prev_now, covariance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn prior(x: f64, y: f64, sigmas: [f64; 6]) -> MotionPrior {
        let covariance = Covariance6::from_diagonal(&Vector6::from(sigmas.map(|s| s * s)));
        MotionPrior { t_prev_now: se3::from_xy_yaw(x, y, 0.0), covariance }
    }

    #[test]
    fn each_is_believed_along_the_axes_of_which_it_is_sure() {
        let wheels = prior(0.2, 0.02, [0.02, 0.02, 0.02, 0.01, 0.01, 0.01]);
        // It has not seen how far base moved along x.
        let second = prior(0.5, 0.0, [1e3, 0.002, 0.002, 0.002, 0.002, 0.002]);
        let both = fused(Some(wheels.clone()), Some(second.clone())).unwrap();
        assert!((both.t_prev_now.translation.x - 0.2).abs() < 1e-3 && both.t_prev_now.translation.y.abs() < 1e-3);
        assert!(both.covariance[(0, 0)] < 5e-4 && both.covariance[(1, 1)] < 5e-6);
        assert_eq!(fused(Some(wheels.clone()), None), Some(wheels));
        assert_eq!(fused(None, Some(second.clone())), Some(second));
    }

    #[test]
    fn wheels_that_slip_are_not_averaged_in() {
        let wheels = prior(0.5, 0.0, [0.02, 0.02, 0.02, 0.01, 0.01, 0.01]);
        let second = prior(0.2, 0.0, [0.01; 6]);
        assert_eq!(fused(Some(wheels), Some(second.clone())), Some(second));
    }
}

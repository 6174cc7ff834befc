//! Where a thing on its way is, and how fast: a Kalman filter over its centre.
//!
//! Source: the discrete white noise acceleration model of constant velocity (Bar-Shalom, Li, Kirubarajan, Estimation with Applications
//! to Tracking and Navigation, section 6.3), along x and y alike and apart from each other; z is measured.

use nalgebra::{Matrix2, Point3, Vector2, Vector3};
use percept_geometry::Timestamp;

/// Deviation of the acceleration that is not known, m/s²: people set off and stop at about 1, cars brake at 2 to 3.
const ACCELERATION: f64 = 1.5;
/// Deviation of a measured centre, metres: a side that was not seen, legs that swing.
const MEASURED_M: f64 = 0.1;
/// Deviation of the velocity before there is a second look, m/s: a quick walk.
const FIRST_SPEED: f64 = 2.0;
/// Squared Mahalanobis distance within which 99.9 % of the measurements of a thing lie: chi-squared of two degrees of freedom.
const GATE: f64 = 13.8;

/// State of the filter at a stamp, map frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Motion {
    stamp: Timestamp,
    position: Point3<f64>,
    velocity: Vector3<f64>,
    /// Of position and velocity along one axis.
    covariance: Matrix2<f64>,
}

impl Motion {
    /// Seen once.
    pub(crate) fn at(stamp: Timestamp, position: Point3<f64>) -> Self {
        let covariance = Matrix2::from_diagonal(&Vector2::new(MEASURED_M.powi(2), FIRST_SPEED.powi(2)));
        Self { stamp, position, velocity: Vector3::zeros(), covariance }
    }

    /// With a velocity that was known before.
    pub(crate) fn with_velocity(self, velocity: Vector3<f64>) -> Self {
        Self { velocity, ..self }
    }

    /// Metres a second, map frame.
    pub(crate) fn velocity(&self) -> Vector3<f64> {
        self.velocity
    }

    /// Variance of the velocity along x, and along y, (m/s)².
    pub(crate) fn velocity_variance(&self) -> f64 {
        self.covariance[(1, 1)]
    }

    /// Goes on for at most so long, seconds. What is asked of the past is as it is now.
    pub(crate) fn predicted(&self, stamp: Timestamp, at_most_s: f64) -> Self {
        let elapsed = stamp.seconds_since(self.stamp).clamp(0.0, at_most_s);
        let step = Matrix2::new(1.0, elapsed, 0.0, 1.0);
        let push = Vector2::new(0.5 * elapsed * elapsed, elapsed) * ACCELERATION;
        Self {
            stamp: self.stamp.max(stamp),
            position: self.position + elapsed * self.velocity,
            velocity: self.velocity,
            covariance: step * self.covariance * step.transpose() + push * push.transpose(),
        }
    }

    /// Takes a measured centre in.
    pub(crate) fn observe(&mut self, stamp: Timestamp, measured: &Point3<f64>) {
        let before = self.predicted(stamp, f64::INFINITY);
        let gain = before.covariance.column(0) / (before.covariance[(0, 0)] + MEASURED_M.powi(2));
        let mut off = measured - before.position;
        off.z = 0.0;
        let mut position = before.position + gain[0] * off;
        position.z = measured.z;
        let covariance = before.covariance - gain * before.covariance.row(0);
        *self = Self { stamp: before.stamp, position, velocity: before.velocity + gain[1] * off, covariance };
    }

    /// Whether a centre may be that of the thing, here and now.
    pub(crate) fn may_be_at(&self, measured: &Point3<f64>) -> bool {
        (measured - self.position).xy().norm_squared() <= GATE * (self.covariance[(0, 0)] + MEASURED_M.powi(2))
    }

    /// Moves it with the map.
    pub(crate) fn transform(&mut self, t_new_old: &percept_geometry::Pose) {
        self.position = t_new_old * self.position;
        self.velocity = t_new_old.rotation * self.velocity;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(tenths: i64) -> Timestamp {
        Timestamp(tenths * 100_000_000)
    }

    #[test]
    fn a_walk_is_learned_and_foreseen() {
        let mut motion = Motion::at(at(0), Point3::origin());
        for i in 1..20 {
            // A fifth of a second apart, 1.2 m/s, 5 cm to either side.
            let side = if i % 2 == 0 { 0.05 } else { -0.05 };
            motion.observe(at(2 * i), &Point3::new(0.24 * i as f64, side, 0.8));
        }
        assert!((motion.velocity() - Vector3::new(1.2, 0.0, 0.0)).norm() < 0.15, "{:?}", motion.velocity());
        let ahead = motion.predicted(at(38 + 5), 1.0);
        assert!((ahead.position.x - (0.24 * 19.0 + 0.6)).abs() < 0.1);
        assert!(ahead.may_be_at(&Point3::new(5.3, 0.2, 0.8)) && !ahead.may_be_at(&Point3::new(5.3, 2.5, 0.8)));
        assert!(ahead.velocity_variance() > motion.velocity_variance());
        assert!(motion.velocity_variance().sqrt() < 0.5);
    }

    #[test]
    fn the_gate_grows_with_the_time_that_nobody_looked() {
        let mut motion = Motion::at(at(0), Point3::origin());
        for i in 1..10 {
            motion.observe(at(2 * i), &Point3::origin());
        }
        let aside = Point3::new(0.0, 1.0, 0.0);
        assert!(!motion.predicted(at(20), 9.0).may_be_at(&aside));
        assert!(motion.predicted(at(38), 9.0).may_be_at(&aside));
        // The past is as it is now.
        assert_eq!(motion.predicted(at(0), 9.0), motion);
    }
}

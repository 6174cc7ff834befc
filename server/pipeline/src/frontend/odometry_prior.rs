//! Wheel odometry between two frames, as a prior on the motion.

use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Covariance6, Pose, Timestamp, se3};
use percept_slam::MotionPrior;
use std::collections::VecDeque;

/// Samples older than this behind the newest are forgotten, seconds.
const KEPT_S: f64 = 10.0;
/// A stamp may lie this far beyond the newest sample and still be extrapolated to, seconds.
const REACH_S: f64 = 0.2;

#[derive(Debug, Clone, Default)]
pub(crate) struct OdometryBuffer {
    samples: VecDeque<(Timestamp, Pose, Option<Covariance6>)>,
}

impl OdometryBuffer {
    /// Adds a sample, unless it is not newer than the last; the stamp of the one before, and the angle turned since.
    pub(crate) fn push(&mut self, stamp: Timestamp, sample: &OdometrySample) -> Option<(Timestamp, f64)> {
        let newest = self.samples.back();
        if newest.is_some_and(|s| s.0 >= stamp) {
            return None;
        }
        let before = newest;
        let turned = before.map(|s| (s.0, s.1.rotation.angle_to(&sample.t_odom_base.rotation)));
        self.samples.push_back((stamp, sample.t_odom_base, sample.covariance));
        while self.samples.front().is_some_and(|s| stamp.seconds_since(s.0) > KEPT_S) {
            self.samples.pop_front();
        }
        turned
    }

    /// Motion from one stamp to another, if samples surround both (or end shortly before).
    pub(crate) fn between(&self, from: Timestamp, to: Timestamp) -> Option<MotionPrior> {
        let t_prev_now = self.at(from)?.inverse() * self.at(to)?;
        let stated: Option<Covariance6> =
            self.samples.iter().filter(|s| s.0 > from && s.0 <= to).filter_map(|s| s.2).reduce(|a, b| a + b);
        Some(MotionPrior { t_prev_now, covariance: stated.unwrap_or_else(|| default_covariance(&t_prev_now)) })
    }

    fn at(&self, stamp: Timestamp) -> Option<Pose> {
        let after = self.samples.partition_point(|s| s.0 < stamp);
        if let Some(next) = self.samples.get(after) {
            if next.0 == stamp {
                return Some(next.1);
            }
            let before = self.samples.get(after.checked_sub(1)?)?;
            let share = stamp.seconds_since(before.0) / next.0.seconds_since(before.0);
            return Some(se3::interpolate(&before.1, &next.1, share));
        }
        let newest = self.samples.back()?;
        let ahead = stamp.seconds_since(newest.0);
        if ahead > REACH_S {
            return None;
        }
        let Some(before) = self.samples.len().checked_sub(2).and_then(|i| self.samples.get(i)) else {
            return Some(newest.1);
        };
        let share = 1.0 + ahead / newest.0.seconds_since(before.0);
        Some(se3::interpolate(&before.1, &newest.1, share))
    }
}

/// Wheels unknown to us: 2 cm and 10 % of the way, 10 mrad, 10 % of the turn and 50 mrad a metre.
/// Wide enough for skid-steered robots; the scans decide within it.
fn default_covariance(t: &Pose) -> Covariance6 {
    let way = t.translation.vector.norm();
    let s = 0.02 + 0.1 * way;
    let r = 0.01 + 0.1 * t.rotation.angle() + 0.05 * way;
    Covariance6::from_diagonal(&nalgebra::Vector6::new(s * s, s * s, s * s, r * r, r * r, r * r))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(x: f64) -> OdometrySample {
        OdometrySample { t_odom_base: se3::from_xy_yaw(x, 0.0, 0.0), covariance: None }
    }

    #[test]
    fn motion_is_interpolated_between_samples_and_not_invented_far_from_them() {
        let mut buffer = OdometryBuffer::default();
        let at = |s: f64| Timestamp::from_secs_f64(s);
        for i in 0..=10 {
            buffer.push(at(0.1 * f64::from(i)), &sample(f64::from(i) * 0.05));
        }
        let motion = buffer.between(at(0.25), at(0.75)).unwrap();
        assert!((motion.t_prev_now.translation.x - 0.25).abs() < 1e-9);
        assert!((buffer.between(at(0.5), at(1.1)).unwrap().t_prev_now.translation.x - 0.3).abs() < 1e-9);
        assert!(buffer.between(at(0.5), at(2.0)).is_none());
        assert!(buffer.between(at(-1.0), at(0.5)).is_none());
    }
}

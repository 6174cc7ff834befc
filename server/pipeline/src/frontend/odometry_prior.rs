//! Wheel odometry between two frames, as a prior on the motion.

use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Covariance6, Pose, Timestamp, se3};
use percept_slam::MotionPrior;
use percept_slam::motion_noise::unknown_wheels;
use std::collections::VecDeque;

/// Samples older than this behind the newest are forgotten, seconds: logs exist that have no scan for a third of that, and wheels
/// lead over it.
const KEPT_S: f64 = 60.0;
/// Samples older than the first are kept this far apart at least, seconds.
const THINNED: (f64, f64) = (2.0, 0.1);
/// A stamp may lie this far beyond the newest sample and still be extrapolated to, seconds.
const REACH_S: f64 = 0.2;

#[derive(Debug, Clone, Default)]
pub(crate) struct OdometryBuffer {
    samples: VecDeque<(Timestamp, Pose, Option<Covariance6>)>,
    /// So many of the oldest have been thinned.
    num_thinned: usize,
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
        self.thin(stamp);
        while self.samples.front().is_some_and(|s| stamp.seconds_since(s.0) > KEPT_S) {
            self.samples.pop_front();
            self.num_thinned = self.num_thinned.saturating_sub(1);
        }
        turned
    }

    /// Takes out old samples that are near to the one before; the next one says what they said of the error.
    fn thin(&mut self, newest: Timestamp) {
        while let Some(&(stamp, _, covariance)) = self.samples.get(self.num_thinned) {
            if newest.seconds_since(stamp) < THINNED.0 {
                break;
            }
            let before = self.num_thinned.checked_sub(1).and_then(|i| self.samples.get(i));
            if before.is_none_or(|before| stamp.seconds_since(before.0) >= THINNED.1) {
                self.num_thinned += 1;
                continue;
            }
            self.samples.remove(self.num_thinned);
            if let (Some(next), Some(covariance)) = (self.samples.get_mut(self.num_thinned), covariance) {
                next.2 = Some(next.2.map_or(covariance, |own| own + covariance));
            }
        }
    }

    /// Motion from one stamp to another, if samples surround both (or end shortly before).
    pub(crate) fn between(&self, from: Timestamp, to: Timestamp) -> Option<MotionPrior> {
        let t_prev_now = self.at(from)?.inverse() * self.at(to)?;
        let stated: Option<Covariance6> =
            self.samples.iter().filter(|s| s.0 > from && s.0 <= to).filter_map(|s| s.2).reduce(|a, b| a + b);
        let covariance = stated.unwrap_or_else(|| {
            let between = self.samples.iter().filter(|s| s.0 > from && s.0 < to).map(|s| s.1);
            let stations: Vec<Pose> = self.at(from).into_iter().chain(between).chain(self.at(to)).collect();
            of_unknown_wheels(stations.windows(2).map(|pair| pair[0].inv_mul(&pair[1])))
        });
        Some(MotionPrior { t_prev_now, covariance })
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

/// Of wheels that say nothing of themselves: all that was driven and turned counts.
fn of_unknown_wheels(steps: impl Iterator<Item = Pose>) -> Covariance6 {
    let add =
        |(way, turn): (f64, f64), step: Pose| (way + step.translation.vector.norm(), turn + step.rotation.angle());
    let (way_m, turned_rad) = steps.fold((0.0, 0.0), add);
    unknown_wheels(way_m, turned_rad)
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

    #[test]
    fn the_motion_over_a_long_pause_is_that_of_all_that_was_driven() {
        // Forth and back, 50 samples a second for half a minute: nothing is left of the way but what it makes unsure.
        let at = |s: f64| Timestamp::from_secs_f64(s);
        let mut buffer = OdometryBuffer::default();
        for i in 0..=1500 {
            let s = f64::from(i) * 0.02;
            buffer.push(at(s), &sample(if s < 15.0 { 0.5 * s } else { 15.0 - 0.5 * s }));
        }
        assert!(buffer.samples.len() < 500, "{}", buffer.samples.len());
        let motion = buffer.between(at(0.05), at(29.95)).unwrap();
        assert!(motion.t_prev_now.translation.vector.norm() < 1e-9);
        let sigma_m = motion.covariance[(0, 0)].sqrt();
        assert!((sigma_m - 0.02 - 0.1 * 14.95).abs() < 0.01, "{sigma_m}");
    }

    #[test]
    fn what_samples_say_of_their_error_is_kept_of_those_that_are_not() {
        let mut buffer = OdometryBuffer::default();
        let covariance = Some(Covariance6::identity() * 1e-6);
        for i in 0..=1000 {
            let sample = OdometrySample { covariance, ..sample(0.01 * f64::from(i)) };
            buffer.push(Timestamp::from_secs_f64(0.02 * f64::from(i)), &sample);
        }
        let motion = buffer.between(Timestamp::from_secs_f64(0.0), Timestamp::from_secs_f64(20.0)).unwrap();
        assert!((motion.covariance[(0, 0)] - 1000.0 * 1e-6).abs() < 1e-5, "{}", motion.covariance[(0, 0)]);
    }
}

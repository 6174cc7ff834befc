//! Gyro samples between two frames, as a prior on the turn; the gyro's bias is learned from the frames that were placed.
//! At rest the accelerometer says which way is up.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{Covariance6, Pose, Timestamp};
use percept_slam::MotionPrior;
use std::collections::VecDeque;

/// Samples older than this behind the newest are forgotten, seconds.
const KEPT_S: f64 = 10.0;
/// Samples farther apart than this say nothing about the turn between them, seconds.
const MOST_GAP_S: f64 = 0.1;
/// Standard deviation of a bias before anything is known, and of one that is learned, rad/s.
const BIAS_SIGMA: (f64, f64) = (0.02, 0.002);
/// Placed frames whose mean the bias is, at most: it wanders.
const BIAS_MEMORY: f64 = 300.0;
/// Errors of a turn that do not come from the bias: radians, and share of the turn (scale, alignment).
const TURN_SIGMA: (f64, f64) = (0.002, 0.02);
/// At rest: so many samples over so long (seconds), in which forces vary by no more (standard deviation, m/s^2), are as
/// large as gravity within this (m/s^2), and turning is slower than this (rad/s).
const REST_SAMPLES: usize = 15;
const REST_S: (f64, f64) = (0.2, 1.5);
const REST_SPREAD: f64 = 0.4;
const GRAVITY: (f64, f64) = (9.81, 0.4);
const REST_RATE: f64 = 0.1;
/// Standard deviation that says nothing about a translation, metres.
const UNKNOWN_M: f64 = 1e3;

/// Samples of one IMU.
#[derive(Debug, Clone, Default)]
pub(crate) struct ImuBuffer {
    /// Angular velocity in base, rad/s, as measured.
    samples: VecDeque<(Timestamp, Vector3<f64>)>,
    /// Specific force in base, m/s^2, of the same samples.
    forces: VecDeque<Vector3<f64>>,
    bias: Vector3<f64>,
    num_learned: f64,
}

impl ImuBuffer {
    pub(crate) fn push(&mut self, stamp: Timestamp, sample: &ImuSample, t_base_sensor: &Pose) {
        self.samples.push_back((stamp, t_base_sensor.rotation * sample.angular_velocity));
        self.forces.push_back(t_base_sensor.rotation * sample.linear_acceleration);
        while self.samples.front().is_some_and(|s| stamp.seconds_since(s.0) > KEPT_S) {
            self.samples.pop_front();
            self.forces.pop_front();
        }
    }

    /// The direction against gravity in base, if the IMU was at rest just before a stamp.
    pub(crate) fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        let first = self.samples.partition_point(|s| stamp.seconds_since(s.0) > REST_S.1);
        let end = self.samples.partition_point(|s| s.0 <= stamp);
        let stretch = end.checked_sub(first).filter(|n| *n >= REST_SAMPLES)?;
        let covered = self.samples[end - 1].0.seconds_since(self.samples[first].0);
        let n = stretch as f64;
        let mean = self.forces.range(first..end).sum::<Vector3<f64>>() / n;
        let spread = (self.forces.range(first..end).map(|f| (f - mean).norm_squared()).sum::<f64>() / n).sqrt();
        let rate = self.samples.range(first..end).map(|s| s.1).sum::<Vector3<f64>>() / n;
        let is_gravity = (mean.norm() - GRAVITY.0).abs() < GRAVITY.1;
        let rests = covered >= REST_S.0 && spread < REST_SPREAD && is_gravity && rate.norm() < REST_RATE;
        rests.then(|| Unit::new_normalize(mean))
    }

    /// The turn from one stamp to another, with a translation that is not known.
    pub(crate) fn between(&self, from: Timestamp, to: Timestamp) -> Option<MotionPrior> {
        let (rotation, _) = self.turn(from, to)?;
        let dt = to.seconds_since(from);
        let bias = if self.num_learned >= 20.0 { BIAS_SIGMA.1 } else { BIAS_SIGMA.0 };
        let sigma = TURN_SIGMA.0 + TURN_SIGMA.1 * rotation.angle() + bias * dt;
        let (t, r) = (UNKNOWN_M * UNKNOWN_M, sigma * sigma);
        Some(MotionPrior {
            t_prev_now: Pose::from_parts(Vector3::zeros().into(), rotation),
            covariance: Covariance6::from_diagonal(&nalgebra::Vector6::new(t, t, t, r, r, r)),
        })
    }

    /// Learns the bias from a turn that was measured otherwise.
    pub(crate) fn learn(&mut self, from: Timestamp, to: Timestamp, r_prev_now: &UnitQuaternion<f64>) {
        let dt = to.seconds_since(from);
        let Some((_, mean)) = self.turn(from, to).filter(|_| dt > 1e-3) else { return };
        let off = mean - r_prev_now.scaled_axis() / dt;
        // A frame placed wrongly, or a fast turn with a scale error: no bias.
        if off.norm() > 0.2 {
            return;
        }
        self.num_learned = (self.num_learned + 1.0).min(BIAS_MEMORY);
        self.bias += (off - self.bias) / self.num_learned;
    }

    /// The turn without the bias, and the mean rate with it, if samples cover the time without a gap.
    fn turn(&self, from: Timestamp, to: Timestamp) -> Option<(UnitQuaternion<f64>, Vector3<f64>)> {
        let (mut here, mut rate) = (from, self.rate(from)?);
        let (mut rotation, mut sum) = (UnitQuaternion::identity(), Vector3::zeros());
        let end = self.rate(to)?;
        let first = self.samples.partition_point(|s| s.0 <= from);
        let last = self.samples.partition_point(|s| s.0 < to);
        let inside = self.samples.range(first..last.max(first)).copied();
        for (stamp, next) in inside.chain(std::iter::once((to, end))) {
            let dt = stamp.seconds_since(here);
            if dt > MOST_GAP_S {
                return None;
            }
            let mean = (rate + next) * 0.5;
            rotation *= UnitQuaternion::from_scaled_axis((mean - self.bias) * dt);
            sum += mean * dt;
            (here, rate) = (stamp, next);
        }
        Some((rotation, sum / to.seconds_since(from).max(1e-9)))
    }

    /// The rate at a stamp: between samples, or held for a moment after the newest.
    fn rate(&self, stamp: Timestamp) -> Option<Vector3<f64>> {
        let after = self.samples.partition_point(|s| s.0 < stamp);
        let Some(next) = self.samples.get(after) else {
            return self.samples.back().filter(|s| stamp.seconds_since(s.0) <= MOST_GAP_S).map(|s| s.1);
        };
        if next.0 == stamp {
            return Some(next.1);
        }
        let before = self.samples.get(after.checked_sub(1)?)?;
        let span = next.0.seconds_since(before.0);
        let share = stamp.seconds_since(before.0) / span;
        (span <= MOST_GAP_S).then(|| before.1.lerp(&next.1, share))
    }
}

/// What wheels and gyro say together: the turn from the gyro, the way from the wheels.
pub(crate) fn joined(wheels: Option<MotionPrior>, turn: Option<MotionPrior>) -> Option<MotionPrior> {
    let (Some(wheels), Some(turn)) = (&wheels, &turn) else { return wheels.or(turn) };
    let t_prev_now = Pose::from_parts(wheels.t_prev_now.translation, turn.t_prev_now.rotation);
    let mut covariance = Covariance6::zeros();
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&wheels.covariance.fixed_view::<3, 3>(0, 0));
    covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn.covariance.fixed_view::<3, 3>(3, 3));
    Some(MotionPrior { t_prev_now, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    fn sample(rate: Vector3<f64>) -> ImuSample {
        ImuSample { angular_velocity: rate, linear_acceleration: Vector3::new(0.0, 0.0, 9.81) }
    }

    #[test]
    fn a_turn_is_integrated_between_any_stamps_in_the_frame_of_base() {
        let mut imu = ImuBuffer::default();
        // Mounted upside down: its z is base's -z.
        let mount = Pose::rotation(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        (0..200).for_each(|i| imu.push(at(0.01 * f64::from(i)), &sample(Vector3::new(0.0, 0.0, -0.8)), &mount));
        let prior = imu.between(at(0.503), at(1.257)).unwrap();
        assert!((prior.t_prev_now.rotation.scaled_axis() - Vector3::new(0.0, 0.0, 0.8 * 0.754)).norm() < 1e-9);
        assert!(prior.covariance[(0, 0)] > 1e5 && prior.covariance[(5, 5)] < 1e-2);
        assert!(imu.between(at(1.9), at(2.5)).is_none() && imu.between(at(-0.5), at(0.5)).is_none());
    }

    #[test]
    fn a_gap_in_the_samples_says_nothing() {
        let mut imu = ImuBuffer::default();
        for i in (0..50).chain(80..120) {
            imu.push(at(0.01 * f64::from(i)), &sample(Vector3::z()), &Pose::identity());
        }
        assert!(imu.between(at(0.2), at(0.9)).is_none());
        assert!(imu.between(at(0.85), at(0.95)).is_some());
    }

    #[test]
    fn the_bias_is_learned_from_placed_frames() {
        let mut imu = ImuBuffer::default();
        let (turning, bias) = (Vector3::new(0.0, 0.0, 0.3), Vector3::new(0.01, -0.02, 0.03));
        for i in 0..1000 {
            imu.push(at(0.01 * f64::from(i)), &sample(turning + bias), &Pose::identity());
            if i > 0 && i % 10 == 0 {
                let r = UnitQuaternion::from_scaled_axis(turning * 0.1);
                imu.learn(at(0.01 * f64::from(i - 10)), at(0.01 * f64::from(i)), &r);
            }
        }
        let turn = imu.between(at(8.0), at(9.0)).unwrap().t_prev_now.rotation.scaled_axis();
        assert!((turn - turning).norm() < 1e-6);
    }

    #[test]
    fn up_is_known_at_rest_alone() {
        let mut imu = ImuBuffer::default();
        // Mounted on its side: its y is base's z.
        let mount = Pose::rotation(Vector3::new(std::f64::consts::FRAC_PI_2, 0.0, 0.0));
        let force = |f: Vector3<f64>| ImuSample { angular_velocity: Vector3::zeros(), linear_acceleration: f };
        let wobble = |i: i32| Vector3::new(0.05 * f64::from(i % 3 - 1), 0.0, 0.0);
        (0..100).for_each(|i| imu.push(at(0.01 * f64::from(i)), &force(Vector3::y() * 9.8 + wobble(i)), &mount));
        assert!(imu.up(at(0.1)).is_none(), "too short");
        assert!(imu.up(at(1.0)).unwrap().angle(&Vector3::z_axis()) < 0.01);
        (100..200).for_each(|i| imu.push(at(0.01 * f64::from(i)), &force(Vector3::y() * 12.0), &mount));
        assert!(imu.up(at(2.0)).is_none(), "accelerated");
    }

    #[test]
    fn the_way_is_the_wheels_and_the_turn_the_gyros() {
        let mut imu = ImuBuffer::default();
        (0..20).for_each(|i| imu.push(at(0.01 * f64::from(i)), &sample(Vector3::z()), &Pose::identity()));
        let turn = imu.between(at(0.0), at(0.1));
        let wheels = MotionPrior {
            t_prev_now: percept_geometry::se3::from_xy_yaw(0.2, 0.0, 0.5),
            covariance: Covariance6::identity() * 0.04,
        };
        let both = joined(Some(wheels.clone()), turn.clone()).unwrap();
        assert!((both.t_prev_now.translation.x - 0.2).abs() < 1e-12 && both.covariance[(0, 0)] == 0.04);
        assert!((both.t_prev_now.rotation.angle() - 0.1).abs() < 1e-9 && both.covariance[(5, 5)] < 0.01);
        assert_eq!(joined(Some(wheels.clone()), None), Some(wheels));
        assert_eq!(joined(None, turn.clone()), turn);
    }
}

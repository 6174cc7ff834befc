//! Samples of one IMU: what they say between two stamps, how noisy they are, and where they are not to be trusted.
//!
//! At rest the accelerometer says which way is up; the gyro's bias is learned from the frames that were placed.

use super::faults::{ImuCheck, ImuFault};
use super::gravity::GRAVITY;
use crate::motion_prior::MotionPrior;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{Covariance6, Pose, Timestamp};
use std::collections::VecDeque;

/// Samples older than this behind the newest are forgotten, seconds. Halved and doubled, the trajectory of `inertial
/// spinning seconds=15` of percept-pipeline is the same.
const KEPT_S: f64 = 10.0;
/// Samples farther apart than this say nothing about the motion between them, seconds. A frame at 10 Hz.
const MOST_GAP_S: f64 = 0.1;
/// Standard deviation of a gyro's bias before anything is known, and of one that is learned, rad/s. About one degree a
/// second, and a tenth of it.
const BIAS_SIGMA: (f64, f64) = (0.02, 0.002);
/// Turns from which a bias counts as learned. The mean of as many is 4.5 times as good as one.
const LEARNED: f64 = 20.0;
/// Placed frames whose mean the bias is, at most: it wanders. Half a minute at 10 Hz.
const BIAS_MEMORY: f64 = 300.0;
/// Errors of a turn that do not come from the bias: radians, and share of the turn (scale, alignment). Halved and
/// doubled, the error of `inertial spinning seconds=15` of percept-pipeline is the same, 5.0 mm.
const TURN_SIGMA: (f64, f64) = (0.002, 0.02);
/// At rest: so many samples over so long (seconds), in which forces vary by no more (standard deviation, m/s^2), are as
/// large as gravity within this (m/s^2), and turning is slower than this (rad/s). The number and the times halved and
/// doubled, the error of `inertial spinning seconds=15` of percept-pipeline is the same, 5.0 mm.
const REST_SAMPLES: usize = 15;
const REST_S: (f64, f64) = (0.2, 1.5);
const REST_SPREAD: f64 = 0.4;
const REST_GRAVITY: f64 = 0.4;
const REST_RATE: f64 = 0.1;
/// Standard deviation that says nothing about a translation, metres. Its variance is a hundred times what counts as
/// unknown (see `motion_prior`).
const UNKNOWN_M: f64 = 1e3;
/// No IMU is less noisy than this, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz): data sheets of small sensors (Bosch BMI160 and BMI088,
/// TDK ICM-20948) say 1.2e-4 to 2.6e-4 and 1.6e-3 to 2.3e-3.
const LEAST_NOISE: (f64, f64) = (1e-4, 1e-3);
/// Weight of the newest sample in the running mean of the noise. A mean over the last hundred: half a second at 200 Hz.
const NOISE_NEWEST: f64 = 0.01;
/// So many equal readings in a row of more than this (rad/s, m/s^2) are the end of the sensor's range.
const CLIPPED: (u32, f64, f64) = (4, 1.0, 15.0);

/// What the sensor felt at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reading {
    pub(crate) stamp: Timestamp,
    /// Angular velocity in axes of base, rad/s, as measured.
    pub(crate) rate: Vector3<f64>,
    /// Specific force in axes of base, m/s^2, as measured.
    pub(crate) force: Vector3<f64>,
    /// Whether the sensor was at the end of its range.
    is_clipped: bool,
}

/// Noise of an IMU by sample, as a density: rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    pub(crate) rate: f64,
    pub(crate) force: f64,
}

/// Samples of one IMU, ten seconds of them, in axes of base.
#[derive(Debug, Clone, Default)]
pub struct ImuBuffer {
    readings: VecDeque<Reading>,
    /// Where the sensor is in base, metres.
    p_base_imu: Vector3<f64>,
    bias: Vector3<f64>,
    num_learned: f64,
    /// Running means of a sample's variance, and of the time between samples, seconds; none before three samples.
    variance: Option<(f64, f64)>,
    interval_s: f64,
    /// The newest sample as the sensor gave it, and for how many samples in a row each number has been the same.
    last: Option<([f64; 6], [u32; 6])>,
    check: ImuCheck,
}

impl ImuBuffer {
    /// Takes a sample, unless it is not newer than the one before. `t_base_sensor` takes the sensor's axes to base.
    pub fn push(&mut self, stamp: Timestamp, sample: &ImuSample, t_base_sensor: &Pose) {
        if self.readings.back().is_some_and(|r| r.stamp >= stamp) {
            return;
        }
        let since = self.readings.back().map_or(0.0, |r| stamp.seconds_since(r.stamp));
        self.check.felt(sample.linear_acceleration.norm(), since);
        self.p_base_imu = t_base_sensor.translation.vector;
        let run = self.note_repeats(sample);
        let reading = Reading {
            stamp,
            rate: t_base_sensor.rotation * sample.angular_velocity,
            force: t_base_sensor.rotation * sample.linear_acceleration,
            is_clipped: run > 0,
        };
        self.readings.push_back(reading);
        self.readings.iter_mut().rev().take(run).for_each(|r| r.is_clipped = true);
        self.measure_noise();
        while self.readings.front().is_some_and(|r| stamp.seconds_since(r.stamp) > KEPT_S) {
            self.readings.pop_front();
        }
    }

    /// For how many samples the sensor has been at the end of its range.
    fn note_repeats(&mut self, sample: &ImuSample) -> usize {
        let now: [f64; 6] =
            std::array::from_fn(|k| if k < 3 { sample.angular_velocity[k] } else { sample.linear_acceleration[k - 3] });
        let runs = match self.last {
            Some((before, runs)) => std::array::from_fn(|k| if now[k] == before[k] { runs[k] + 1 } else { 1 }),
            None => [1; 6],
        };
        self.last = Some((now, runs));
        let is_large = |k: usize| now[k].abs() > if k < 3 { CLIPPED.1 } else { CLIPPED.2 };
        (0..6).filter(|&k| runs[k] >= CLIPPED.0 && is_large(k)).map(|k| runs[k] as usize).max().unwrap_or(0)
    }

    /// Of noise that is white the second difference has six times the variance of a sample. What moves faster than samples
    /// can follow counts as noise, as it should.
    fn measure_noise(&mut self) {
        let n = self.readings.len();
        let Some(first) = n.checked_sub(3) else { return };
        let (a, b, c) = (self.readings[first], self.readings[first + 1], self.readings[first + 2]);
        let (before, after) = (b.stamp.seconds_since(a.stamp), c.stamp.seconds_since(b.stamp));
        if after > 1.5 * before || before > 1.5 * after {
            return;
        }
        let of = |d: Vector3<f64>| d.norm_squared() / 18.0;
        let now = (of(a.rate - b.rate * 2.0 + c.rate), of(a.force - b.force * 2.0 + c.force));
        self.variance = match self.variance {
            Some(v) => Some((v.0 + NOISE_NEWEST * (now.0 - v.0), v.1 + NOISE_NEWEST * (now.1 - v.1))),
            None => Some(now),
        };
        let interval = if self.interval_s == 0.0 { after } else { self.interval_s };
        self.interval_s = interval + NOISE_NEWEST * (after - interval);
    }

    /// How noisy the samples are.
    pub(crate) fn noise(&self) -> Noise {
        let (rate, force) = self.variance.unwrap_or((0.0, 0.0));
        let density = |variance: f64, least: f64| (variance * self.interval_s).sqrt().max(least);
        Noise { rate: density(rate, LEAST_NOISE.0), force: density(force, LEAST_NOISE.1) }
    }

    /// Where the sensor is in base, metres.
    pub(crate) fn p_base_imu(&self) -> Vector3<f64> {
        self.p_base_imu
    }

    /// The gyro's bias as far as frames have told it, in axes of base, rad/s, and its standard deviation.
    pub(crate) fn gyro_bias(&self) -> (Vector3<f64>, f64) {
        (self.bias, if self.num_learned >= LEARNED { BIAS_SIGMA.1 } else { BIAS_SIGMA.0 })
    }

    /// The mean specific force during the last moments before a stamp, in axes of base, m/s^2.
    pub(crate) fn mean_force(&self, stamp: Timestamp) -> Option<Vector3<f64>> {
        let first = self.readings.partition_point(|r| stamp.seconds_since(r.stamp) > REST_S.0);
        let end = self.readings.partition_point(|r| r.stamp <= stamp);
        let n = end.checked_sub(first).filter(|n| *n > 0)?;
        Some(self.readings.range(first..end).map(|r| r.force).sum::<Vector3<f64>>() / n as f64)
    }

    /// Stamp of the newest sample.
    pub fn newest(&self) -> Option<Timestamp> {
        self.readings.back().map(|r| r.stamp)
    }

    /// The direction against gravity in base, if the IMU was at rest just before a stamp.
    pub fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        let first = self.readings.partition_point(|r| stamp.seconds_since(r.stamp) > REST_S.1);
        let end = self.readings.partition_point(|r| r.stamp <= stamp);
        let stretch = end.checked_sub(first).filter(|n| *n >= REST_SAMPLES)?;
        let covered = self.readings[end - 1].stamp.seconds_since(self.readings[first].stamp);
        let n = stretch as f64;
        let mean = self.readings.range(first..end).map(|r| r.force).sum::<Vector3<f64>>() / n;
        let off = |r: &Reading| (r.force - mean).norm_squared();
        let spread = (self.readings.range(first..end).map(off).sum::<f64>() / n).sqrt();
        let rate = self.readings.range(first..end).map(|r| r.rate).sum::<Vector3<f64>>() / n;
        let is_gravity = (mean.norm() - GRAVITY).abs() < REST_GRAVITY;
        let rests = covered >= REST_S.0 && spread < REST_SPREAD && is_gravity && rate.norm() < REST_RATE;
        rests.then(|| Unit::new_normalize(mean))
    }

    /// The turn from one stamp to another, with a translation that is not known.
    pub fn between(&self, from: Timestamp, to: Timestamp) -> Option<MotionPrior> {
        let (rotation, _) = self.turn(from, to)?;
        let dt = to.seconds_since(from);
        let sigma = TURN_SIGMA.0 + TURN_SIGMA.1 * rotation.angle() + self.gyro_bias().1 * dt;
        let (t, r) = (UNKNOWN_M * UNKNOWN_M, sigma * sigma);
        Some(MotionPrior {
            t_prev_now: Pose::from_parts(Vector3::zeros().into(), rotation),
            covariance: Covariance6::from_diagonal(&nalgebra::Vector6::new(t, t, t, r, r, r)),
        })
    }

    /// What is wrong with the IMU, as far as that is known; empty if nothing is.
    pub fn faults(&self) -> Vec<ImuFault> {
        self.check.faults()
    }

    /// Whether the turns that it feels are known to be of no use.
    pub fn spoils_turns(&self) -> bool {
        self.check.spoils_turns()
    }

    /// Whether the turns that it feels have shown to be those of the robot.
    pub fn has_proven_turns(&self) -> bool {
        self.check.has_proven_turns()
    }

    /// An odometry that was given the samples made no use of them in so many frames in a row.
    pub fn note_unbelieved(&mut self, num_frames: u32) {
        self.check.num_unbelieved = num_frames;
    }

    /// Learns the bias from a turn that was measured otherwise, and whether samples agree with it. `is_planar`: it was
    /// measured about base's z alone.
    pub fn learn(&mut self, from: Timestamp, to: Timestamp, r_prev_now: &UnitQuaternion<f64>, is_planar: bool) {
        let dt = to.seconds_since(from);
        let Some((_, mean)) = self.turn(from, to).filter(|_| dt > 1e-3) else {
            if let Some(newest) = self.newest() {
                self.check.uncovered(to.seconds_since(newest).max(0.0));
            }
            return;
        };
        self.check.turned(&((mean - self.bias) * dt), r_prev_now, is_planar);
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
        let readings = self.stretch(from, to)?;
        let (mut rotation, mut sum) = (UnitQuaternion::identity(), Vector3::zeros());
        for pair in readings.windows(2) {
            let dt = pair[1].stamp.seconds_since(pair[0].stamp);
            let mean = (pair[0].rate + pair[1].rate) * 0.5;
            rotation *= UnitQuaternion::from_scaled_axis((mean - self.bias) * dt);
            sum += mean * dt;
        }
        Some((rotation, sum / to.seconds_since(from).max(1e-9)))
    }

    /// Readings from one stamp to another, both included: at the ends between samples, or held for a moment after the newest.
    /// None where a gap is in between.
    fn stretch(&self, from: Timestamp, to: Timestamp) -> Option<Vec<Reading>> {
        let mut out = vec![self.at(from)?];
        let first = self.readings.partition_point(|r| r.stamp <= from);
        let last = self.readings.partition_point(|r| r.stamp < to).max(first);
        out.extend(self.readings.range(first..last));
        out.push(self.at(to)?);
        out.windows(2).all(|w| w[1].stamp.seconds_since(w[0].stamp) <= MOST_GAP_S).then_some(out)
    }

    /// The same, none either where the sensor was at the end of its range.
    pub(crate) fn sound_stretch(&self, from: Timestamp, to: Timestamp) -> Option<Vec<Reading>> {
        self.stretch(from, to).filter(|s| s.iter().all(|r| !r.is_clipped))
    }

    /// What was felt at a stamp: between samples, or held for a moment after the newest.
    fn at(&self, stamp: Timestamp) -> Option<Reading> {
        let after = self.readings.partition_point(|r| r.stamp < stamp);
        let Some(next) = self.readings.get(after) else {
            let held = self.readings.back().filter(|r| stamp.seconds_since(r.stamp) <= MOST_GAP_S)?;
            return Some(Reading { stamp, ..*held });
        };
        if next.stamp == stamp {
            return Some(*next);
        }
        let before = self.readings.get(after.checked_sub(1)?)?;
        let span = next.stamp.seconds_since(before.stamp);
        let share = stamp.seconds_since(before.stamp) / span;
        (span <= MOST_GAP_S).then(|| Reading {
            stamp,
            rate: before.rate.lerp(&next.rate, share),
            force: before.force.lerp(&next.force, share),
            is_clipped: before.is_clipped || next.is_clipped,
        })
    }
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
    fn the_end_of_a_sensors_range_is_noticed() {
        let mut imu = ImuBuffer::default();
        for i in 0..100 {
            // A wave of 4 rad/s in a sensor that ends at 2 rad/s, on its side.
            let rate = (4.0 * (0.1 * f64::from(i)).sin()).clamp(-2.0, 2.0);
            let mount = Pose::rotation(Vector3::new(0.3, 0.8, 0.1));
            imu.push(at(0.01 * f64::from(i)), &sample(Vector3::new(0.0, rate, 0.0)), &mount);
        }
        assert!(imu.sound_stretch(at(0.0), at(0.04)).is_some(), "rising");
        assert!(imu.sound_stretch(at(0.10), at(0.20)).is_none(), "at the end");
        assert!(imu.sound_stretch(at(0.28), at(0.36)).is_some(), "falling");
    }

    #[test]
    fn noise_is_measured_under_motion() {
        let mut imu = ImuBuffer::default();
        // Uniform in plus and minus a half: Knuth's linear congruential generator.
        let mut state = 12345u64;
        let mut white = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for i in 0..4000 {
            let t = 0.005 * f64::from(i);
            let rate = Vector3::new((3.0 * t).sin(), 0.0, t.cos()) + Vector3::from_fn(|_, _| white()) * 0.02;
            let force = Vector3::new(4.0 * (11.0 * t).sin(), 0.0, 9.81) + Vector3::from_fn(|_, _| white()) * 0.2;
            imu.push(at(t), &ImuSample { angular_velocity: rate, linear_acceleration: force }, &Pose::identity());
        }
        // A uniform distribution's standard deviation is its width over the root of 12.
        let (rate, force) = (0.02 / 12f64.sqrt() * 0.005f64.sqrt(), 0.2 / 12f64.sqrt() * 0.005f64.sqrt());
        let measured = imu.noise();
        assert!((measured.rate / rate - 1.0).abs() < 0.2 && (measured.force / force - 1.0).abs() < 0.2, "{measured:?}");
    }

    #[test]
    fn the_bias_is_learned_from_placed_frames() {
        let mut imu = ImuBuffer::default();
        let (turning, bias) = (Vector3::new(0.0, 0.0, 0.3), Vector3::new(0.01, -0.02, 0.03));
        for i in 0..1000 {
            imu.push(at(0.01 * f64::from(i)), &sample(turning + bias), &Pose::identity());
            if i > 0 && i % 10 == 0 {
                let r = UnitQuaternion::from_scaled_axis(turning * 0.1);
                imu.learn(at(0.01 * f64::from(i - 10)), at(0.01 * f64::from(i)), &r, false);
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
}

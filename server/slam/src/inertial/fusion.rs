//! The IMU beside an odometry: what it expects of the next frame, what the frame's place then tells of it, and whether it
//! is to be believed.
//!
//! It runs along from the second placed frame on, and is believed once its predictions were as good as those of constant
//! velocity: a wrong mount, unit or clock, or a sensor that is broken, does not get that far, or not for long. One whose
//! predictions grow worse is not believed any more, runs on, and may come back.

use super::buffer::ImuBuffer;
use super::curve::Curve;
use super::faults::SHAKEN;
use super::gravity::GRAVITY;
use super::preintegration::{Gravity, NavState, Preintegrated, STATE, TURN_SHARE, off};
use super::window::{BOTH, PoseFactor, Window};
use crate::motion_noise::HANDS;
use nalgebra::{Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use percept_geometry::{Covariance6, Pose, Timestamp, se3};
use std::sync::Arc;

/// Standard deviations with which a window begins: position and rotation against the local model, metres and radians, the
/// velocity of a step, m/s and share of it, and the accelerometer's bias, m/s^2. Error of `inertial rosette seconds=20` of
/// percept-pipeline with the first two halved 8.2 and 8.5, doubled 7.7 and 8.1 mm (8.2), corrected poses of `rgbd` 6 mm
/// throughout.
const POSITION: f64 = 0.01;
const ROTATION: f64 = 0.005;
const VELOCITY: (f64, f64) = (0.3, 0.2);
const ACCEL_BIAS: f64 = 0.2;
/// Forces that differ from gravity by less than [`SHAKEN`] tell its direction to this angle, radians, and as much as they differ.
const DIRECTION: f64 = 0.05;
/// What registrations of frames in a row have in common, because they share a local model, metres and radians. Error
/// of `inertial rosette seconds=20` of percept-pipeline: halved 7.5, doubled 8.6 mm (8.2).
const IN_COMMON: (f64, f64) = (0.003, 0.001);
/// Weight of the newest frame in running means, and frames after which they say something. A mean over the last twenty:
/// two seconds at 10 Hz, as the window is long.
const NEWEST: f64 = 0.05;
const PROVEN: usize = 5;
/// Weight of a frame that surprises more than those before. Error of `inertial rosette seconds=20` of percept-pipeline
/// is 8.2 mm halved, doubled and as it is.
const STARTLED: f64 = 0.3;
/// Predictions that are off by no more than this are not told apart, metres and radians. Error of `inertial rosette
/// seconds=20` of percept-pipeline: halved 9.5, doubled 8.6 mm (8.2).
const SLACK: (f64, f64) = (0.003, 0.0015);
/// An IMU that was not believed has to be so much better than constant velocity before it is again. Error of `inertial
/// rosette seconds=20` of percept-pipeline: halved 10.8, doubled 9.1 mm (8.2).
const BETTER: f64 = 0.8;
/// Squared error of a prediction in standard deviations, by axis, at which what is known of the IMU is dropped. Twenty
/// standard deviations.
const ABSURD: f64 = 400.0;
/// And at which it is not believed: predictions are off by two standard deviations time and again.
const INCONSISTENT: f64 = 4.0;
/// The most by which errors of predictions widen what is said of them, in variance.
const WIDEST: f64 = 1e4;

pub(crate) type Matrix12 = SMatrix<f64, 12, 12>;

/// What the IMU expects of a frame.
#[derive(Debug, Clone)]
pub(crate) struct Expected {
    pub(crate) t_odom_base: Pose,
    /// Of that pose (right perturbation in base) and of base's velocity at the stamp (m/s, rad/s, axes of base).
    pub(crate) covariance: Matrix12,
    /// How base moves during the sweep.
    pub(crate) curve: Arc<Curve>,
}

impl Expected {
    /// Of the pose alone.
    pub(crate) fn pose_covariance(&self) -> Covariance6 {
        self.covariance.fixed_view::<6, 6>(0, 0).into_owned()
    }
}

/// A frame that was placed.
pub(crate) struct PlacedFrame<'a> {
    /// What placing it told by itself, of base.
    pub(crate) seen: &'a PoseFactor,
    /// Where constant velocity led.
    pub(crate) assumed: &'a Pose,
    /// The velocity of the step from the frame before, in odom, m/s.
    pub(crate) velocity: Vector3<f64>,
    pub(crate) stamp: Timestamp,
}

/// Running means of how far predictions were off, metres and radians: a force that is felt in another direction spoils the one
/// and leaves the other as it is.
#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    position: f64,
    rotation: f64,
}

impl Errors {
    fn add(&mut self, off: &Vector6<f64>, weight: f64) {
        self.position += weight * (off.fixed_rows::<3>(0).norm() - self.position);
        self.rotation += weight * (off.fixed_rows::<3>(3).norm() - self.rotation);
    }

    /// Whether neither is worse than so many times the other's.
    fn within(&self, share: f64, other: &Self) -> bool {
        self.position <= share * other.position + SLACK.0 && self.rotation <= share * other.rotation + SLACK.1
    }
}

/// The state of the fusion.
#[derive(Debug, Default)]
pub(crate) struct Inertial {
    window: Option<Window>,
    p_base_imu: Vector3<f64>,
    /// From the frame before to the current one.
    motion: Option<Preintegrated>,
    /// What was expected of the current frame, believed or not.
    expected: Option<Expected>,
    is_believed: bool,
    /// How far predictions were off: the IMU's, and those of constant velocity.
    off_by: (Errors, Errors),
    num_compared: usize,
    /// Running mean of the squared error in standard deviations, by axis.
    surprise: f64,
    /// Placed frames in a row in which samples led worse than constant velocity did, whatever was forgotten in between.
    num_unbelieved: u32,
}

impl Inertial {
    /// Looks ahead to the frame at `to`, whose points were taken from `sweep.0` to `sweep.1` seconds after that; the frame
    /// before was at `from`. What is expected, if that is to be believed.
    pub(crate) fn expect(
        &mut self,
        imu: Option<&ImuBuffer>,
        from: Option<Timestamp>,
        to: Timestamp,
        sweep: (f64, f64),
    ) -> Option<&Expected> {
        (self.motion, self.expected) = (None, None);
        let (imu, from) = (imu?, from?);
        if self.p_base_imu != imu.p_base_imu() {
            *self = Self { p_base_imu: imu.p_base_imu(), num_unbelieved: self.num_unbelieved, ..Self::default() };
        }
        let readings = imu.sound_stretch(from, to)?;
        let (gyro_bias, accel_bias) = match &self.window {
            Some(w) => (w.newest().gyro_bias, w.newest().accel_bias),
            None => (imu.gyro_bias().0, Vector3::zeros()),
        };
        let motion = Preintegrated::of(&readings, &imu.noise(), &gyro_bias, &accel_bias);
        self.expected = self.window.as_ref().and_then(|w| self.look_ahead(w, &motion, imu, to, sweep));
        self.motion = Some(motion);
        self.expected.as_ref().filter(|_| self.is_believed)
    }

    fn look_ahead(
        &self,
        window: &Window,
        motion: &Preintegrated,
        imu: &ImuBuffer,
        to: Timestamp,
        sweep: (f64, f64),
    ) -> Option<Expected> {
        let (state, covariance) = window.predict(motion)?;
        let curve = Curve::of(imu, to, sweep, &state, window.gravity())?;
        let covariance = covariance * self.surprise.clamp(1.0, WIDEST);
        // From position, rotation and velocity of the body to base, and the velocity to axes of base.
        let r_base_odom = *state.t_odom_body.rotation.inverse().to_rotation_matrix().matrix();
        let mut j = SMatrix::<f64, 12, BOTH>::zeros();
        j.fixed_view_mut::<6, 6>(0, 0).copy_from(&se3::adjoint(&self.t_base_body()));
        j.fixed_view_mut::<3, 3>(6, 6).copy_from(&r_base_odom);
        // The gyro's bias, negative: what is thought too large a bias is too small a rate.
        j.fixed_view_mut::<3, 3>(9, 9).copy_from(&-nalgebra::Matrix3::identity());
        let mut of_base: Matrix12 = j * covariance * j.transpose();
        let rate = curve.at(0.01).rotation.scaled_axis() / 0.01;
        // Where no sample covers a sweep velocities change as hands make them.
        let (v, w) = (HANDS.0 * curve.uncovered_s, HANDS.1 * curve.uncovered_s + TURN_SHARE * rate.norm());
        for k in 0..3 {
            of_base[(6 + k, 6 + k)] += v * v + 1e-6;
            of_base[(9 + k, 9 + k)] += w * w + 1e-8;
        }
        let t_odom_base = state.t_odom_body * self.t_base_body().inverse();
        Some(Expected { t_odom_base, covariance: of_base, curve: Arc::new(curve) })
    }

    fn t_base_body(&self) -> Pose {
        Pose::from_parts(self.p_base_imu.into(), UnitQuaternion::identity())
    }

    /// The current frame was placed. Where base is by all that is known, if the IMU is believed.
    pub(crate) fn placed(&mut self, imu: Option<&ImuBuffer>, frame: &PlacedFrame<'_>) -> Option<Pose> {
        let Some(imu) = imu else {
            *self = Self::default();
            return None;
        };
        let was_believed = self.is_believed && self.expected.is_some();
        self.num_unbelieved = if self.is_believed { 0 } else { self.num_unbelieved.saturating_add(1) };
        let (t, r) = (IN_COMMON.0 * IN_COMMON.0, IN_COMMON.1 * IN_COMMON.1);
        let floor = Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r));
        let seen = frame.seen.blurred(&floor);
        self.compare(frame, &seen);
        let registration = self.of_body(&seen);
        let t_body_base = self.t_base_body().inverse();
        let Some(motion) = self.motion.take() else {
            self.begin_again(&registration.t_odom_found, &frame.velocity);
            return None;
        };
        let Some(window) = &mut self.window else {
            self.window = begin(imu, frame, registration.t_odom_found);
            return None;
        };
        if self.expected.is_some() && self.surprise > ABSURD {
            // A bias has jumped, or the sensor was turned over.
            self.forget();
            return None;
        }
        if !window.add(motion, Some(registration)) {
            self.forget();
            return None;
        }
        if !was_believed {
            return None;
        }
        Some(window.newest().t_odom_body * t_body_base)
    }

    /// The current frame was not placed: inertia alone says where base is.
    pub(crate) fn lost(&mut self) {
        let motion = self.motion.take();
        let is_carried = self.window.as_mut().zip(motion).is_some_and(|(window, motion)| window.add(motion, None));
        if !is_carried {
            self.forget();
        }
    }

    /// Odom moved: `t` takes old coordinates to new ones.
    pub(crate) fn follow(&mut self, t: &Pose) {
        if let Some(window) = &mut self.window {
            window.follow(t);
        }
    }

    /// The pose jumped: nothing leads from what was known to what will be.
    pub(crate) fn forget(&mut self) {
        let (p_base_imu, num_unbelieved) = (self.p_base_imu, self.num_unbelieved);
        *self = Self { p_base_imu, num_unbelieved, ..Self::default() };
    }

    /// For how many frames in a row the IMU has been of no use.
    pub(crate) fn num_unbelieved(&self) -> u32 {
        self.num_unbelieved
    }

    /// A frame's place as the body's.
    fn of_body(&self, seen: &PoseFactor) -> PoseFactor {
        let t_base_body = self.t_base_body();
        let ad = se3::adjoint(&t_base_body);
        PoseFactor {
            t_odom_found: seen.t_odom_found * t_base_body,
            information: ad.transpose() * seen.information * ad,
            gradient: ad.transpose() * seen.gradient,
        }
    }

    /// Compares what was expected, and what constant velocity led to, with where the frame is.
    fn compare(&mut self, frame: &PlacedFrame<'_>, seen: &PoseFactor) {
        let Some(expected) = &self.expected else { return };
        // To where the frame alone would be placed, without what was expected of it; along what it leaves open it says nothing.
        let spread = seen.information.pseudo_inverse(1e-6).unwrap_or_else(|_| Matrix6::zeros());
        let off_by = |t: &Pose| spread * (seen.information * off(t, &seen.t_odom_found) - seen.gradient);
        let d = off_by(&expected.t_odom_base);
        let weight = NEWEST.max(1.0 / (self.num_compared + 1) as f64);
        self.off_by.0.add(&d, weight);
        self.off_by.1.add(&off_by(frame.assumed), weight);
        let widened = self.surprise.clamp(1.0, WIDEST);
        let total = expected.pose_covariance() / widened + spread;
        let squared = total.cholesky().map_or(0.0, |c| d.dot(&c.solve(&d)) / 6.0);
        let weight = if squared > self.surprise { STARTLED } else { NEWEST };
        self.surprise += weight * (squared.min(1e6) - self.surprise);
        self.num_compared += 1;
        let share = if self.is_believed { 1.0 } else { BETTER };
        if self.num_compared >= PROVEN {
            self.is_believed = self.off_by.0.within(share, &self.off_by.1) && self.surprise <= INCONSISTENT;
        }
    }

    /// After a gap: what is known of biases and gravity stays, the velocity is that of the step.
    fn begin_again(&mut self, t_odom_body: &Pose, velocity: &Vector3<f64>) {
        let Some(window) = self.window.take() else { return };
        let Some(known) = window.covariance() else { return self.forget() };
        let mut variances = variances(velocity, 0.0);
        for k in 9..STATE {
            variances[k] = known[(k, k)];
        }
        let direction = known[(STATE, STATE)].max(known[(STATE + 1, STATE + 1)]);
        let state = NavState { t_odom_body: *t_odom_body, velocity: *velocity, ..*window.newest() };
        self.window = Some(Window::new(state, *window.gravity(), &variances, direction));
    }
}

/// A window that begins with a frame; none if forces do not tell where gravity points.
fn begin(imu: &ImuBuffer, frame: &PlacedFrame<'_>, t_odom_body: Pose) -> Option<Window> {
    let force = imu.mean_force(frame.stamp)?;
    let share = (force.norm() / GRAVITY - 1.0).abs();
    if share > SHAKEN {
        return None;
    }
    let (gyro_bias, sigma) = imu.gyro_bias();
    let state = NavState { t_odom_body, velocity: frame.velocity, gyro_bias, accel_bias: Vector3::zeros() };
    let gravity = Gravity::along(&(t_odom_body.rotation * -force));
    Some(Window::new(state, gravity, &variances(&frame.velocity, sigma), (DIRECTION + share).powi(2)))
}

fn variances(velocity: &Vector3<f64>, gyro_bias: f64) -> SVector<f64, STATE> {
    let unsure = VELOCITY.0 + VELOCITY.1 * velocity.norm();
    let sigma = [POSITION, ROTATION, unsure, gyro_bias, ACCEL_BIAS];
    SVector::from_fn(|k, _| sigma[k / 3] * sigma[k / 3])
}

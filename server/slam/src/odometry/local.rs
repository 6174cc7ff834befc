//! Odometry by a local model: each frame is placed in what was seen before, then added to it.
//!
//! The prediction (wheels, an IMU, else constant velocity), being lost and starting again, and the covariance are the same for
//! every kind of sensor; what differs is the [`LocalModel`].

mod hypotheses;

use super::model::{After, LocalModel, Prediction, Registration};
use super::params::MotionLimits;
use super::rhythm::Rhythm;
use super::uncertainty::Uncertainty;
use super::{OdometryEstimate, OdometryKind, OdometryParams, ToldPlace};
use crate::covariance::diagonal;
use crate::inertial::{GyroCheck, ImuBuffer, Inertial, PlacedFrame};
use crate::keyframe::{KeyframeParams, SweepMotion, keyframe_scan_seen_by};
use crate::motion_noise::{GUESSED_AFTER_S, unknown_wheels};
use crate::motion_prior::MotionPrior;
use crate::scan::Scan;
use crate::tracking::{LostReason, Scale, TrackingState};
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, Timestamp, se3};
use std::sync::Arc;

/// What a measurement left open counts up to this variance, m^2. Half a metre: what the search covers. Halved and
/// doubled as it is on the log with wheels ([`crate::loops::planar`]).
const MAX_LEFT_OPEN: f64 = 0.25;
/// So far off may a pose be that somebody tells, metres and radians: twice the standard deviations that RViz gives a pose that
/// is pointed out (0.5 m, 0.26 rad).
const TOLD: (f64, f64) = (1.0, 0.5);

/// Odometry by a local model of what was seen: surfaces whose lengths are known.
pub(super) struct LocalOdometry {
    params: OdometryParams,
    model: Box<dyn LocalModel>,
    t_odom_base: Pose,
    last_stamp: Option<Timestamp>,
    velocity: Option<Vector6<f64>>,
    /// What the newest frame's sweep was undone with.
    sweep_velocity: Vector6<f64>,
    inertial: Inertial,
    gyro: GyroCheck,
    limits: MotionLimits,
    uncertainty: Uncertainty,
    rhythm: Rhythm,
    /// Of the newest measurement against the local model: what it left open is open for the next one too.
    left_open: Covariance6,
    /// Running mean of the inlier ratio.
    usual_inlier_ratio: f64,
    num_lost: usize,
    /// Since the last placed frame, seconds.
    unplaced_s: f64,
    /// Whether frames were missing when the first one was lost.
    after_silence: bool,
}

impl std::fmt::Debug for LocalOdometry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LocalOdometry")
            .field("t_odom_base", &self.t_odom_base)
            .field("last_stamp", &self.last_stamp)
            .field("num_lost", &self.num_lost)
            .finish_non_exhaustive()
    }
}

impl LocalOdometry {
    /// With an empty model, at the origin of odom.
    pub(super) fn new(kind: OdometryKind, model: Box<dyn LocalModel>, params: OdometryParams) -> Self {
        let limits = MotionLimits::of(kind, &params.tracking);
        Self {
            params,
            model,
            t_odom_base: Pose::identity(),
            last_stamp: None,
            velocity: None,
            sweep_velocity: Vector6::zeros(),
            inertial: Inertial::default(),
            gyro: GyroCheck::default(),
            limits,
            uncertainty: Uncertainty::new(kind),
            rhythm: Rhythm::default(),
            left_open: Covariance6::zeros(),
            usual_inlier_ratio: 0.0,
            num_lost: 0,
            unplaced_s: 0.0,
            after_silence: false,
        }
    }

    /// Places a scan and adds it to the local model ([`super::Odometry::register_with_imu`]).
    pub(super) fn register(
        &mut self,
        stamp: Timestamp,
        scan: &Scan,
        prior: Option<&MotionPrior>,
        imu: Option<&ImuBuffer>,
    ) -> OdometryEstimate {
        let stamped = self.last_stamp.map_or(0.0, |last| stamp.seconds_since(last).max(0.0));
        self.rhythm.tick(stamped);
        let dt = self.rhythm.elapsed(stamped);
        let t_odom_before = self.t_odom_base;
        let felt_rate = self.turn_rate_during(stamp, scan, imu);
        // Wheels tell the way better than inertia does.
        let imu = imu.filter(|_| !self.limits.is_planar && !prior.is_some_and(MotionPrior::tells_the_way));
        let turned = prior.filter(|p| p.is_turn_only()).map(|p| p.t_prev_now.rotation);
        let on_trial = prior.filter(|p| p.is_turn_only() && self.gyro.is_on_trial());
        let prior = prior.filter(|p| !p.is_turn_only() || self.gyro.is_believed());
        let prediction = self.predict_with_imu(stamp, dt, scan, prior, imu);
        self.last_stamp = Some(stamp);
        self.model.follow_curve(prediction.inertial.as_ref().map(|e| Arc::clone(&e.curve)));
        // The sweep is undone with what is known of this step's motion.
        let mut sweep_velocity = match prior {
            Some(_) if dt > 0.0 && dt <= self.params.tracking.max_gap_s => {
                se3::log(&self.t_odom_base.inv_mul(&prediction.t_odom_base)) / dt
            }
            _ => self.velocity(),
        };
        if let Some(rate) = felt_rate {
            sweep_velocity[5] = rate;
        }
        self.sweep_velocity = sweep_velocity;
        if let Err(reason) = self.model.prepare(scan, &sweep_velocity) {
            return self.lost(stamp, dt, &prediction, reason);
        }
        if self.model.is_empty() {
            return self.start(stamp, &prediction);
        }
        let found = self.place_or_search(dt, &prediction);
        let found = match on_trial.filter(|_| prediction.inertial.is_none()) {
            Some(gyro) => self.place_or_try_gyro(dt, &prediction, gyro, found),
            None => found,
        };
        let found = found.map(|found| self.sharpen(dt, scan, (&sweep_velocity, felt_rate), found));
        if let Ok(found) = &found {
            match &prediction.inertial {
                Some(e) => self.uncertainty.carried(&found.degenerate_axes, &e.pose_covariance().diagonal()),
                None => self.uncertainty.filled_in(&found.degenerate_axes, &prediction.measured, dt),
            }
        }
        let is_guessed = self.uncertainty.guessed().contains(&true);
        match found.and_then(|found| if is_guessed { Err(LostReason::Degenerate) } else { Ok(found) }) {
            Ok(found) => {
                self.model.believe(&found, &prediction.t_odom_base);
                // What inertia led to is no proof of the gyro, which is a part of it.
                if let Some(turned) = turned.filter(|_| self.num_lost == 0 && prediction.inertial.is_none()) {
                    let assumed = self.predict(dt, None).t_odom_base.rotation;
                    // A frame lies near where it was expected: with a wrong turn it looks as if that were right.
                    let alone = found.told.as_ref().map_or(found.t_odom_base, |told| told.alone());
                    let since = |now: &UnitQuaternion<f64>| self.t_odom_base.rotation.inverse() * now;
                    self.gyro.compare(&turned, &since(&assumed), &since(&alone.rotation));
                }
                let found = self.fuse(stamp, dt, found, imu);
                if self.num_lost == 0 {
                    self.rhythm.observe(stamped, &(t_odom_before.inverse() * found.t_odom_base));
                }
                self.tracked(stamp, dt, found)
            }
            Err(_) if self.num_lost + 1 >= self.patience(dt) => {
                self.model.clear();
                self.start(stamp, &prediction)
            }
            Err(reason) => self.lost(stamp, dt, &prediction, reason),
        }
    }

    /// How fast a robot in the plane turned while a scan was taken, rad/s, as a gyro felt it that has shown to be right: the
    /// robot may have turned otherwise between the scans.
    fn turn_rate_during(&self, stamp: Timestamp, scan: &Scan, imu: Option<&ImuBuffer>) -> Option<f64> {
        let (first, last) = scan.sweep_s();
        let imu = imu.filter(|imu| self.limits.is_planar && last > first && imu.has_proven_turns())?;
        let turn = imu.between(stamp.plus_seconds(first), stamp.plus_seconds(last))?.t_prev_now.rotation;
        Some(turn.scaled_axis().z / (last - first))
    }

    /// Where the IMU expects the frame, if it is believed; else as wheels, gyro and velocity say.
    fn predict_with_imu(
        &mut self,
        stamp: Timestamp,
        dt: f64,
        scan: &Scan,
        prior: Option<&MotionPrior>,
        imu: Option<&ImuBuffer>,
    ) -> Prediction {
        let expected = self.inertial.expect(imu, self.last_stamp, stamp, scan.sweep_s()).cloned();
        let expected = expected.filter(|e| self.is_possible(dt, &e.t_odom_base));
        let Some(expected) = expected else { return self.predict(dt, prior) };
        Prediction {
            t_odom_base: expected.t_odom_base,
            covariance: expected.pose_covariance(),
            is_measured: true,
            measured: [true; 6],
            is_turn_felt: true,
            inertial: Some(expected),
            ..self.predict(dt, None)
        }
    }

    /// Whether the robot can have got there since the frame before: inertia alone runs away once a velocity is wrong.
    fn is_possible(&self, dt: f64, t_odom_base: &Pose) -> bool {
        let way = (t_odom_base.translation.vector - self.t_odom_base.translation.vector).norm();
        way <= self.limits.speed * dt.max(self.params.tracking.max_gap_s)
    }

    /// What the frame's place tells of the IMU, and what that tells of the place.
    fn fuse(&mut self, stamp: Timestamp, dt: f64, found: Registration, imu: Option<&ImuBuffer>) -> Registration {
        let Some(seen) = &found.told else { return found };
        let assumed = self.predict(dt, None).t_odom_base;
        let way = found.t_odom_base.translation.vector - self.t_odom_base.translation.vector;
        let velocity = if dt > 1e-4 { way / dt } else { Vector3::zeros() };
        let frame = PlacedFrame { stamp, seen, assumed: &assumed, velocity };
        match self.inertial.placed(imu, &frame) {
            Some(t_odom_base) => Registration { t_odom_base, ..found },
            None => found,
        }
    }

    /// What was learned of an IMU does not hold any more: it is mounted otherwise, or another one. It has to prove itself again.
    pub(super) fn forget_imu(&mut self) {
        self.inertial = Inertial::default();
        self.gyro = GyroCheck::default();
    }

    /// In how many placed frames in a row the IMU that it was given predicted worse than constant velocity did.
    pub(super) fn num_imu_unbelieved(&self) -> u32 {
        self.inertial.num_unbelieved()
    }

    /// Whether the newest frame was placed.
    pub(super) fn is_tracking(&self) -> bool {
        self.last_stamp.is_some() && self.num_lost == 0
    }

    /// Base's velocity in base, m/s and rad/s, from the last two placed frames; zero when not known.
    pub(super) fn velocity(&self) -> Vector6<f64> {
        self.velocity.unwrap_or_else(Vector6::zeros)
    }

    /// The newest pose, base to odom.
    pub(super) fn t_odom_base(&self) -> &Pose {
        &self.t_odom_base
    }

    /// Bytes that the local model takes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        self.model.memory_bytes()
    }

    /// Changes what keyframes keep from now on.
    pub(super) fn set_keyframe_params(&mut self, params: KeyframeParams) {
        self.params.keyframe = params;
    }

    /// What a keyframe keeps of a scan.
    pub(super) fn keyframe_scan(&self, stamp: Timestamp, sensor: &SensorId, scan: &Scan) -> KeyframeScan {
        let (motion, color) = (self.sweep_motion(scan), self.model.color_camera());
        keyframe_scan_seen_by(&self.params.keyframe, stamp, sensor, scan, &motion, color)
    }

    /// What keyframes keep.
    pub(super) fn keyframe_params(&self) -> &KeyframeParams {
        &self.params.keyframe
    }

    /// How base moved during a scan that was just placed.
    pub(super) fn sweep_motion(&self, scan: &Scan) -> SweepMotion {
        match (self.model.sweep_curve(), scan) {
            (Some((curve, velocity)), _) => SweepMotion { velocity, curve: Some(curve) },
            // Of a planar scan the motion that it was placed with; a cloud's method may have found a better one since.
            (None, Scan::Planar(_)) => SweepMotion { velocity: self.sweep_velocity, curve: None },
            (None, _) => SweepMotion { velocity: self.velocity(), curve: None },
        }
    }

    /// Goes on after a restart: `recent` keyframes with their `t_odom_base`, oldest first, become the
    /// local model, and the next frame is expected near `t_odom_base_last`, base's pose at `stamp`.
    pub(super) fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)], stamp: Timestamp) {
        self.model.clear();
        self.model.seed(t_odom_base_last, recent);
        self.t_odom_base = *t_odom_base_last;
        self.last_stamp = Some(stamp);
        self.velocity = None;
        self.inertial.forget();
        (self.num_lost, self.unplaced_s) = (0, 0.0);
    }

    /// Begins anew with the next frame where wheels have led over a stretch of the way ([`super::Odometry::lead_to`]).
    pub(super) fn lead_to(&mut self, t_odom_base: &Pose, told: &Pose, stamp: Timestamp) -> OdometryEstimate {
        self.model.clear();
        self.inertial.lost();
        self.velocity = None;
        self.num_lost = 1;
        let way_m = told.translation.vector.norm();
        self.uncertainty.predicted(told, &unknown_wheels(way_m, told.rotation.angle()));
        self.t_odom_base = *t_odom_base;
        self.unmeasured(stamp, TrackingState::Lost { reason: LostReason::Adrift })
    }

    /// Moves to where a scan lies around a pose that was told; how well that is known.
    pub(super) fn settle(&mut self, scan: &Scan) -> ToldPlace {
        if self.model.prepare(scan, &Vector6::zeros()).is_err() {
            return ToldPlace::Refuted;
        }
        let (way, turn) = TOLD;
        let around = Prediction::within(self.t_odom_base, diagonal(way / 3.0, turn / 3.0));
        // Frames that follow each other are looked for less far away.
        let searched = self.model.search(&self.t_odom_base, way, turn).and_then(|found| found.into_iter().next());
        match searched.map_or_else(|| self.model.register(&around), Ok) {
            Ok(found) if self.model.is_certain(&found, After::Word) => {
                self.t_odom_base = found.t_odom_base;
                match self.model.is_certain(&found, After::Gap) {
                    true => ToldPlace::Certain,
                    false => ToldPlace::Likely,
                }
            }
            _ => ToldPlace::Refuted,
        }
    }

    fn tracked(&mut self, stamp: Timestamp, dt: f64, found: Registration) -> OdometryEstimate {
        let t_last_now = self.t_odom_base.inverse() * found.t_odom_base;
        let covariance = self.uncertainty.measured(&t_last_now, &found.covariance, &found.degenerate_axes);
        if self.limits.is_planar {
            let largest = found.covariance.diagonal().max();
            self.left_open = found.covariance * (MAX_LEFT_OPEN / largest.max(MAX_LEFT_OPEN));
        }
        let recovered = self.num_lost > 0;
        (self.num_lost, self.unplaced_s) = (0, 0.0);
        self.usual_inlier_ratio += 0.1 * (found.inlier_ratio - self.usual_inlier_ratio);
        // After a loss the step says nothing about the velocity; a repeated stamp neither.
        let usable = !recovered && dt > 1e-4 && dt <= self.params.tracking.max_gap_s;
        let from_steps = || {
            let now = se3::log(&t_last_now) / dt;
            // Stamps jitter: a step counts the less, the shorter it is.
            self.velocity.map_or(now, |before| before + (now - before) * (dt / (dt + self.limits.smoothing)))
        };
        self.velocity = self.model.sweep_velocity().or_else(|| usable.then(from_steps));
        self.model.integrate(&found.t_odom_base);
        self.t_odom_base = found.t_odom_base;
        if let Some(refined) = self.model.refine(&found.t_odom_base) {
            self.inertial.follow(&(refined * found.t_odom_base.inverse()));
            self.t_odom_base = refined;
        }
        OdometryEstimate {
            stamp,
            t_odom_base: self.t_odom_base,
            covariance,
            state: TrackingState::Tracking,
            inlier_ratio: found.inlier_ratio,
            rmse_m: found.rmse_m,
            iterations: found.iterations,
            degenerate_axes: found.degenerate_axes,
            scale: Scale::Measured,
            waiting: None,
        }
    }

    /// Starts the local model with the current frame, at the prediction.
    fn start(&mut self, stamp: Timestamp, prediction: &Prediction) -> OdometryEstimate {
        let first = self.num_lost == 0;
        if !first {
            self.inertial.lost();
            self.advance(prediction);
            // How it moved before it was lost says nothing about how it moves now.
            self.velocity = None;
        }
        self.uncertainty.restarted();
        self.left_open = Covariance6::zeros();
        (self.num_lost, self.unplaced_s) = (0, 0.0);
        self.model.integrate(&self.t_odom_base);
        self.unmeasured(stamp, TrackingState::Initialising)
    }

    fn lost(&mut self, stamp: Timestamp, dt: f64, prediction: &Prediction, reason: LostReason) -> OdometryEstimate {
        self.after_silence = self.is_after_silence(dt);
        self.num_lost += 1;
        self.unplaced_s += dt;
        match self.unplaced_s <= GUESSED_AFTER_S {
            true => self.inertial.lost(),
            false => self.inertial.forget(),
        }
        self.advance(prediction);
        // A guess of constant velocity is worth less with every second.
        let gap = dt > self.params.tracking.max_gap_s;
        self.velocity = self.velocity.filter(|_| !gap).map(|v| v * (-3.0 * dt).exp());
        self.unmeasured(stamp, TrackingState::Lost { reason })
    }

    fn advance(&mut self, prediction: &Prediction) {
        let t_last_now = self.t_odom_base.inverse() * prediction.t_odom_base;
        self.uncertainty.predicted(&t_last_now, &prediction.covariance);
        self.t_odom_base = prediction.t_odom_base;
    }

    fn unmeasured(&self, stamp: Timestamp, state: TrackingState) -> OdometryEstimate {
        OdometryEstimate {
            stamp,
            t_odom_base: self.t_odom_base,
            covariance: self.uncertainty.covariance(),
            state,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            iterations: 0,
            degenerate_axes: self.uncertainty.guessed(),
            scale: Scale::Measured,
            waiting: None,
        }
    }
}

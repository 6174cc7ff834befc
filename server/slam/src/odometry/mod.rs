//! Odometry: scans of one sensor in, the pose of base in the drifting frame `odom` out.
//!
//! Every kind registers frame to local model, never frame to frame. What they share is here: the
//! prediction (wheels, else constant velocity), being lost and starting again, and the covariance.
//! Start with [`Odometry::register`]; the methods are [`rgbd`], [`lidar3d`], [`lidar2d`] and [`mono`], which keeps a map and
//! a state of its own: what the others share supposes that lengths are known.

pub(crate) mod deskew;
pub mod lidar2d;
pub mod lidar3d;
pub mod mono;
pub mod rgbd;
mod rhythm;
mod uncertainty;

use crate::keyframe::{KeyframeParams, keyframe_scan_seen_by};
use crate::scan::{ImageScan, Scan};
use crate::tracking::{LostReason, Scale, TrackingState, Waiting};
use crate::{ParamError, check_range};
use nalgebra::Vector6;
use percept_geometry::{Covariance6, KeyframeFeatures, KeyframeScan, PointCloud, Pose, SensorId, Timestamp, se3};
use rhythm::Rhythm;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use uncertainty::Uncertainty;

/// A frame whose inlier ratio falls below this share of the usual one is tried from the last pose too.
const DOUBTFUL: f64 = 0.9;

/// Wheels that differ so much from the velocity before, in one frame, are doubted: metres and radians.
const SUDDEN: (f64, f64) = (0.15, 0.15);
/// What a measurement left open counts up to this variance, m^2.
const MAX_LEFT_OPEN: f64 = 0.25;

/// A prior whose position has a larger variance than this leaves the translation open, m^2.
const UNKNOWN_VARIANCE: f64 = 1e4;

/// Which method registers the scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OdometryKind {
    /// Depth images, with or without colour.
    Rgbd,
    /// 3D point clouds.
    Lidar3d,
    /// Planar scans: the robot moves in the plane z = 0 of odom.
    Lidar2d,
    /// Images of one camera: no depth, no scale unless another source gives it.
    Mono,
}

/// Parameters of all methods and of what they share.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryParams {
    /// Prediction, loss and restart.
    pub tracking: TrackingParams,
    /// Depth cameras.
    pub rgbd: rgbd::RgbdParams,
    /// 3D lidars.
    pub lidar3d: lidar3d::Lidar3dParams,
    /// Planar lidars.
    pub lidar2d: lidar2d::Lidar2dParams,
    /// Cameras without depth.
    pub mono: mono::MonoParams,
    /// When frames become keyframes and what is kept of them.
    pub keyframe: KeyframeParams,
}

impl OdometryParams {
    /// Checks every field of every part.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        self.tracking.validate()?;
        self.rgbd.validate()?;
        self.lidar3d.validate()?;
        self.lidar2d.validate()?;
        self.mono.validate()?;
        self.keyframe.validate()
    }
}

/// Prediction, loss and restart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingParams {
    /// After so many lost frames in a row the local model starts anew at the predicted pose, 1 to 10000.
    pub restart_after_frames: usize,
    /// A gap between frames longer than this ends the constant-velocity prediction, seconds, 0.05 to 60.
    pub max_gap_s: f64,
    /// Faster than this is no motion of the robot, m/s, 0.1 to 200; none takes 40 for 3D lidars, which
    /// ride on cars too, and 4 for the others.
    pub max_speed_mps: Option<f64>,
    /// Turning faster than this is no motion of the robot, rad/s, 0.1 to 50; none takes 3 for planar
    /// lidars and 8 for the others, which may be carried by hand.
    pub max_turn_rate_radps: Option<f64>,
    /// Acceleration that a prediction of constant velocity has to allow for, m/s^2, 0.1 to 100; none takes
    /// 1.5 for planar lidars and 4 for the others.
    pub acceleration_mps2: Option<f64>,
    /// Angular acceleration that it has to allow for, rad/s^2, 0.1 to 100; none takes 4 for planar lidars
    /// and 8 for the others.
    pub turn_acceleration_radps2: Option<f64>,
}

impl Default for TrackingParams {
    fn default() -> Self {
        Self {
            restart_after_frames: 30,
            max_gap_s: 1.0,
            max_speed_mps: None,
            max_turn_rate_radps: None,
            acceleration_mps2: None,
            turn_acceleration_radps2: None,
        }
    }
}

impl TrackingParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let frames = self.restart_after_frames as f64;
        check_range("tracking.restart_after_frames", frames, (1.0, 1e4), "within 1 to 10000", "use 30")?;
        check_range("tracking.max_gap_s", self.max_gap_s, (0.05, 60.0), "within 0.05 to 60", "use 1")?;
        let speed = self.max_speed_mps.unwrap_or(40.0);
        check_range("tracking.max_speed_mps", speed, (0.1, 200.0), "within 0.1 to 200", "leave it out")?;
        let turn = self.max_turn_rate_radps.unwrap_or(8.0);
        check_range("tracking.max_turn_rate_radps", turn, (0.1, 50.0), "within 0.1 to 50", "leave it out")?;
        let (a, turn) = (self.acceleration_mps2.unwrap_or(4.0), self.turn_acceleration_radps2.unwrap_or(8.0));
        check_range("tracking.acceleration_mps2", a, (0.1, 100.0), "within 0.1 to 100", "leave it out")?;
        check_range("tracking.turn_acceleration_radps2", turn, (0.1, 100.0), "within 0.1 to 100", "leave it out")
    }
}

/// What the robot can do, from the parameters or by kind: m/s, rad/s, m/s^2, rad/s^2; and the time
/// constant (s) of the velocity that predictions use, longer where logs are known for jittering stamps.
#[derive(Debug, Clone, Copy)]
struct MotionLimits {
    speed: f64,
    turn_rate: f64,
    acceleration: f64,
    turn_acceleration: f64,
    smoothing: f64,
    /// Whether the scene often leaves a direction open that a later frame decides (corridors in the plane).
    remembers_open: bool,
}

impl MotionLimits {
    fn of(kind: OdometryKind, params: &TrackingParams) -> Self {
        let (speed, turn_rate, acceleration, turn_acceleration, smoothing) = match kind {
            OdometryKind::Rgbd | OdometryKind::Mono => (4.0, 8.0, 4.0, 8.0, 0.03),
            OdometryKind::Lidar3d => (40.0, 8.0, 4.0, 8.0, 0.04),
            OdometryKind::Lidar2d => (4.0, 3.0, 1.5, 4.0, 0.2),
        };
        Self {
            speed: params.max_speed_mps.unwrap_or(speed),
            turn_rate: params.max_turn_rate_radps.unwrap_or(turn_rate),
            acceleration: params.acceleration_mps2.unwrap_or(acceleration),
            turn_acceleration: params.turn_acceleration_radps2.unwrap_or(turn_acceleration),
            smoothing,
            remembers_open: kind == OdometryKind::Lidar2d,
        }
    }
}

/// What another source (wheels, an IMU) says about the motion since the frame before.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionPrior {
    /// Base now, seen from base at the frame before.
    pub t_prev_now: Pose,
    /// Of that motion, right perturbation in base now. With standard deviations above 100 m the translation is open, and
    /// prediction takes it from the velocity.
    pub covariance: Covariance6,
}

/// Where base is, how sure that is, and how the frame fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct OdometryEstimate {
    /// When the frame was taken.
    pub stamp: Timestamp,
    /// Base to odom; odom is base at the first frame unless the odometry was seeded.
    pub t_odom_base: Pose,
    /// 6x6, order x, y, z, rotation x, y, z, right perturbation in base: since the start, drift included.
    pub covariance: Covariance6,
    /// Whether the pose was measured.
    pub state: TrackingState,
    /// Share of the frame's points that fit the local model, 0 to 1; 0 unless tracking.
    pub inlier_ratio: f64,
    /// Weighted root mean square of the distances from the local model's surfaces, metres.
    pub rmse_m: f64,
    /// Iterations of the solver, all levels together.
    pub iterations: usize,
    /// Axes of base (x, y, z, rotation x, y, z) that the scene left open and the prediction filled in.
    pub degenerate_axes: [bool; 6],
    /// Whether lengths are metres, and by what.
    pub scale: Scale,
    /// What a method that needs several frames to begin is waiting for.
    pub waiting: Option<Waiting>,
}

/// Where base is expected before the scan is looked at.
#[derive(Debug, Clone)]
pub(crate) struct Prediction {
    pub(crate) t_odom_base: Pose,
    /// Right perturbation in base.
    pub(crate) covariance: Covariance6,
    /// Whether it was measured (by wheels, an IMU), not assumed.
    pub(crate) is_measured: bool,
}

/// A frame placed in the local model.
#[derive(Debug, Clone)]
pub(crate) struct Match {
    pub(crate) t_odom_base: Pose,
    /// Of this measurement against the model, right perturbation in base.
    pub(crate) covariance: Covariance6,
    pub(crate) inlier_ratio: f64,
    pub(crate) rmse_m: f64,
    pub(crate) iterations: usize,
    pub(crate) degenerate_axes: [bool; 6],
}

/// What a method brings: a local model that frames are placed in and then added to.
pub(crate) trait LocalModel: Send {
    /// Makes `scan` the current frame. `velocity` is base's (m/s, rad/s), for undoing sweeps.
    fn prepare(&mut self, scan: &Scan, velocity: &Vector6<f64>) -> Result<(), LostReason>;
    /// Whether there is nothing to register against.
    fn is_empty(&self) -> bool;
    /// Places the current frame.
    fn register(&mut self, prediction: &Prediction) -> Result<Match, LostReason>;
    /// Whether the current frame, placed after a time without any, fits so well that it can hardly be elsewhere.
    fn is_certain(&self, _found: &Match) -> bool {
        true
    }
    /// Base's velocity (m/s, rad/s) while the current frame was taken, where placing it has found that too.
    fn sweep_velocity(&self) -> Option<Vector6<f64>> {
        None
    }
    /// Adds the current frame at its pose.
    fn integrate(&mut self, t_odom_base: &Pose);
    /// Makes the local model agree better with what its frames saw, after the current one was added at its pose; where base
    /// is then, if that moved it.
    fn refine(&mut self, _t_odom_base: &Pose) -> Option<Pose> {
        None
    }
    /// Where a depth camera's colour camera was found to be, for the image in full size.
    fn color_camera(&self) -> Option<rgbd::ColorCamera> {
        None
    }
    /// Forgets the model.
    fn clear(&mut self);
    /// Starts the model from keyframes with their `t_odom_base`, oldest first.
    fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]);
    /// A method with a map and a state of its own, whose lengths may be in no known unit, does all here.
    fn as_mono(&mut self) -> Option<&mut mono::Mono> {
        None
    }
    /// The map's points that its last frame shows, in base, metres; none where lengths are not metres.
    fn sparse_points(&self, _t_base_sensor: &Pose) -> PointCloud {
        PointCloud::default()
    }
    /// What the last frame shows of these points, as a keyframe keeps it.
    fn features(&self, _t_base_sensor: &Pose) -> Option<KeyframeFeatures> {
        None
    }
    /// Stamps and `t_odom_base` of the frames that such a method keeps.
    fn views(&self, _t_base_sensor: &Pose) -> Vec<(Timestamp, Pose)> {
        vec![]
    }
}

/// Odometry of one sensor: deterministic, no clock, no I/O; parallel on rayon's current pool.
pub struct Odometry {
    params: OdometryParams,
    model: Box<dyn LocalModel>,
    t_odom_base: Pose,
    last_stamp: Option<Timestamp>,
    velocity: Option<Vector6<f64>>,
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
}

impl std::fmt::Debug for Odometry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Odometry")
            .field("t_odom_base", &self.t_odom_base)
            .field("last_stamp", &self.last_stamp)
            .field("num_lost", &self.num_lost)
            .finish_non_exhaustive()
    }
}

impl Odometry {
    /// An odometry without a local model, at the origin of odom. Validate `params` first.
    pub fn new(kind: OdometryKind, params: OdometryParams) -> Self {
        let model: Box<dyn LocalModel> = match kind {
            OdometryKind::Rgbd => Box::new(rgbd::Rgbd::new(params.rgbd.clone())),
            OdometryKind::Lidar3d => Box::new(lidar3d::Lidar3d::new(params.lidar3d.clone())),
            OdometryKind::Lidar2d => Box::new(lidar2d::Lidar2d::new(params.lidar2d.clone())),
            OdometryKind::Mono => Box::new(mono::Mono::new(&params.mono, params.tracking.restart_after_frames)),
        };
        let limits = MotionLimits::of(kind, &params.tracking);
        Self {
            params,
            model,
            t_odom_base: Pose::identity(),
            last_stamp: None,
            velocity: None,
            limits,
            uncertainty: Uncertainty::default(),
            rhythm: Rhythm::default(),
            left_open: Covariance6::zeros(),
            usual_inlier_ratio: 0.0,
            num_lost: 0,
            unplaced_s: 0.0,
        }
    }

    /// Places a scan, adds it to the local model and says where base was when it was taken.
    ///
    /// A frame that cannot be placed gives `Lost` with the prediction as pose; the next frames are tried
    /// against the same model until `restart_after_frames` of them are lost.
    pub fn register(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) -> OdometryEstimate {
        if let Some(mono) = self.model.as_mono() {
            let estimate = mono.track(stamp, scan, prior);
            self.follow(&estimate);
            return estimate;
        }
        let stamped = self.last_stamp.map_or(0.0, |last| stamp.seconds_since(last).max(0.0));
        self.rhythm.tick(stamped);
        let dt = self.rhythm.elapsed(stamped);
        let t_odom_before = self.t_odom_base;
        let prediction = self.predict(dt, prior);
        self.last_stamp = Some(stamp);
        // The sweep is undone with what is known of this step's motion.
        let sweep_velocity = match prior {
            Some(_) if dt > 0.0 && dt <= self.params.tracking.max_gap_s => {
                se3::log(&self.t_odom_base.inv_mul(&prediction.t_odom_base)) / dt
            }
            _ => self.velocity(),
        };
        if let Err(reason) = self.model.prepare(scan, &sweep_velocity) {
            return self.lost(stamp, dt, &prediction, reason);
        }
        if self.model.is_empty() {
            return self.start(stamp, &prediction);
        }
        match self.place_or_doubt(dt, &prediction).map(|found| self.sharpen(dt, scan, &sweep_velocity, found)) {
            Ok(found) => {
                if self.num_lost == 0 {
                    self.rhythm.observe(stamped, &(t_odom_before.inverse() * found.t_odom_base));
                }
                self.tracked(stamp, dt, found)
            }
            Err(_) if self.num_lost + 1 >= self.params.tracking.restart_after_frames => {
                self.model.clear();
                self.start(stamp, &prediction)
            }
            Err(reason) => self.lost(stamp, dt, &prediction, reason),
        }
    }

    /// Takes over what a method found that keeps a state of its own. Steps tell a velocity only in metres.
    fn follow(&mut self, estimate: &OdometryEstimate) {
        let dt = self.last_stamp.map_or(0.0, |last| estimate.stamp.seconds_since(last));
        let step = se3::log(&self.t_odom_base.inv_mul(&estimate.t_odom_base));
        let both = estimate.state.is_tracking() && self.num_lost == 0 && estimate.scale.is_metric();
        let near = dt > 1e-4 && dt <= self.params.tracking.max_gap_s;
        self.velocity = (both && near).then(|| step / dt).filter(|v| v.fixed_rows::<3>(0).norm() < self.limits.speed);
        self.num_lost = if estimate.state.is_tracking() { 0 } else { self.num_lost + 1 };
        (self.t_odom_base, self.last_stamp) = (estimate.t_odom_base, Some(estimate.stamp));
    }

    /// How the past moved with the newest frame, where the method closes loops in a map of its own (a camera's): stamps,
    /// ascending, and what takes poses in odom near them in time to where they are now. Given once.
    pub fn take_moved(&mut self) -> Vec<(Timestamp, Pose)> {
        self.model.as_mono().map(mono::Mono::take_moved).unwrap_or_default()
    }

    /// What tells a camera its scale: a depth image of the same view, or an image of a second camera, that came after
    /// the newest image and belongs to it. Other methods, and a camera that is lost, take no notice.
    pub fn tell_scale(&mut self, hint: &ImageScan) {
        if let Some(mono) = self.model.as_mono() {
            mono.tell_scale(hint);
        }
    }

    /// Whether the newest frame was placed.
    pub fn is_tracking(&self) -> bool {
        self.last_stamp.is_some() && self.num_lost == 0
    }

    /// Base's velocity in base, m/s and rad/s, from the last two placed frames; zero when not known.
    pub fn velocity(&self) -> Vector6<f64> {
        self.velocity.unwrap_or_else(Vector6::zeros)
    }

    /// Of the newest pose since the start, drift included, right perturbation in base.
    pub fn covariance(&self) -> Covariance6 {
        self.uncertainty.covariance()
    }

    /// The newest pose, base to odom.
    pub fn t_odom_base(&self) -> &Pose {
        &self.t_odom_base
    }

    /// What a keyframe keeps of a scan: ends of beams in base, thinned; see [`KeyframeScan`]. Of a camera's image the points
    /// of its map that it shows, once lengths are metres, and nothing before.
    pub fn keyframe_scan(&self, stamp: Timestamp, sensor: &SensorId, scan: &Scan) -> KeyframeScan {
        let color = self.model.color_camera();
        let mut kept = keyframe_scan_seen_by(&self.params.keyframe, stamp, sensor, scan, &self.velocity(), color);
        if let Scan::Image(image) = scan {
            kept.hits = self.model.sparse_points(&image.t_base_sensor);
            kept.features = self.model.features(&image.t_base_sensor).map(Arc::new);
        }
        kept
    }

    /// What a camera's map now makes of the past: its views' stamps and `t_odom_base`, oldest first; for other kinds none.
    pub fn views(&self, t_base_sensor: &Pose) -> Vec<(Timestamp, Pose)> {
        self.model.views(t_base_sensor)
    }

    /// Goes on after a restart: `recent` keyframes with their `t_odom_base`, oldest first, become the
    /// local model, and the next frame is expected near `t_odom_base_last`, base's pose at `stamp`.
    pub fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)], stamp: Timestamp) {
        self.model.clear();
        self.model.seed(t_odom_base_last, recent);
        self.t_odom_base = *t_odom_base_last;
        self.last_stamp = Some(stamp);
        self.velocity = None;
        (self.num_lost, self.unplaced_s) = (0, 0.0);
    }

    /// The motion prior if there is one; what it leaves open, as a gyro does the translation, from constant velocity.
    fn predict(&self, dt: f64, prior: Option<&MotionPrior>) -> Prediction {
        let constant = self.constant_velocity(dt);
        let Some(prior) = prior else { return constant };
        // A prior surer than 1 mm and 1 mrad is not believed.
        let covariance = prior.covariance + diagonal(1e-3, 1e-3);
        if (0..3).all(|i| covariance[(i, i)] <= UNKNOWN_VARIANCE) {
            return Prediction { t_odom_base: self.t_odom_base * prior.t_prev_now, covariance, is_measured: true };
        }
        let way = self.t_odom_base.inv_mul(&constant.t_odom_base).translation;
        let mut both = constant.covariance;
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&covariance.fixed_view::<3, 3>(3, 3));
        let t_odom_base = self.t_odom_base * Pose::from_parts(way, prior.t_prev_now.rotation);
        Prediction { t_odom_base, covariance: both, is_measured: false }
    }

    /// Constant velocity while frames are near in time.
    fn constant_velocity(&self, dt: f64) -> Prediction {
        let t = &self.params.tracking;
        let velocity = self.velocity.filter(|_| dt <= t.max_gap_s);
        let moving = velocity.unwrap_or_else(Vector6::zeros) * dt;
        // Without a velocity, or lost, the robot may have done anything that robots usually do.
        let unsure = if self.num_lost > 0 || velocity.is_none() { dt } else { 0.0 };
        let sigma_t =
            0.01 + 0.5 * self.limits.acceleration * dt.min(t.max_gap_s).powi(2) + 0.25 * self.limits.speed * unsure;
        let sigma_r = 0.01 + 0.5 * self.limits.turn_acceleration * dt.min(t.max_gap_s).powi(2) + 0.5 * unsure;
        let usual = self.rhythm.error();
        let (sigma_t, sigma_r) = (sigma_t.max(1.5 * usual), sigma_r.max(1.5 * usual));
        let t_now_next = se3::exp(&moving);
        let covariance = se3::compose_covariance(&self.left_open, &t_now_next, &diagonal(sigma_t, sigma_r.min(1.0)));
        Prediction { t_odom_base: self.t_odom_base * t_now_next, covariance, is_measured: false }
    }

    /// Wheels that slip or lag shall not lose what the scan alone can place: where they fail, or say what the motion
    /// before does not lead to, that is tried as well, and wins if it fits better.
    fn place_or_doubt(&mut self, dt: f64, prediction: &Prediction) -> Result<Match, LostReason> {
        let measured = self.place(dt, prediction);
        if !prediction.is_measured || !self.limits.remembers_open {
            return measured;
        }
        let assumed = self.predict(dt, None);
        let apart = prediction.t_odom_base.inverse() * assumed.t_odom_base;
        let likely = apart.translation.vector.norm() < SUDDEN.0 && apart.rotation.angle() < SUDDEN.1;
        if likely && measured.is_ok() {
            return measured;
        }
        match (measured, self.place(dt, &assumed)) {
            (Ok(a), Ok(b)) => Ok(if b.inlier_ratio > 1.02 * a.inlier_ratio { b } else { a }),
            (measured, assumed) => measured.or_else(|reason| assumed.map_err(|_| reason)),
        }
    }

    /// Tries the prediction and, if that fails or fits worse than usual, the last pose; the better is taken.
    fn place(&mut self, dt: f64, prediction: &Prediction) -> Result<Match, LostReason> {
        let predicted = self.try_from(dt, prediction);
        let sound = |m: &Match| m.inlier_ratio >= DOUBTFUL * self.usual_inlier_ratio;
        let t_still_predicted = self.t_odom_base.inverse() * prediction.t_odom_base;
        if predicted.as_ref().is_ok_and(sound) || se3::log(&t_still_predicted).norm() < 1e-3 {
            return predicted.map_err(|reason| self.with_gap(dt, reason));
        }
        // After a gap the place of before may look like the one where wheels have led to since.
        if prediction.is_measured && !self.limits.remembers_open && self.is_after_gap(dt) {
            return predicted.map_err(|reason| self.with_gap(dt, reason));
        }
        let still = self.try_from(dt, &Prediction { t_odom_base: self.t_odom_base, ..prediction.clone() });
        let still = still.and_then(|m| match self.may_deny(prediction, &m) {
            true => Ok(m),
            false => Err(LostReason::ResidualTooLarge),
        });
        match (predicted, still) {
            (Ok(a), Ok(b)) if b.inlier_ratio <= 1.02 * a.inlier_ratio => {
                // The model's view of the winner is what its frame is fused with.
                self.try_from(dt, prediction).or(Ok(a))
            }
            (_, Ok(b)) => Ok(b),
            (Ok(_), Err(_)) => self.try_from(dt, prediction),
            (Err(reason), Err(_)) => Err(self.with_gap(dt, reason)),
        }
    }

    /// Whether a place found elsewhere than wheels say is believed rather than they: a frame fits anywhere along a wall. It has
    /// to fit as well as frames usually do, contradict nothing, and show the motion that it denies.
    fn may_deny(&self, prediction: &Prediction, found: &Match) -> bool {
        if !prediction.is_measured || self.limits.remembers_open {
            return true;
        }
        let off = se3::log(&prediction.t_odom_base.inv_mul(&found.t_odom_base));
        let is_seen = |k: usize| !found.degenerate_axes[k] || off[k].abs() < 3.0 * prediction.covariance[(k, k)].sqrt();
        (0..6).all(is_seen)
            && found.inlier_ratio >= DOUBTFUL * self.usual_inlier_ratio
            && self.model.is_certain(found)
    }

    /// Undoes the sweep's motion again where it was other than assumed, and places the scan once more.
    fn sharpen(&mut self, dt: f64, scan: &Scan, assumed: &Vector6<f64>, found: Match) -> Match {
        if self.model.sweep_velocity().is_some() || !scan.is_sweep() || dt < 1e-3 || dt > self.params.tracking.max_gap_s
        {
            return found;
        }
        let velocity = se3::log(&(self.t_odom_base.inverse() * found.t_odom_base)) / dt;
        // Over a sweep of 0.1 s: 1 cm, or 5 mrad.
        let off = velocity - assumed;
        if off.fixed_rows::<3>(0).norm() < 0.1 && off.fixed_rows::<3>(3).norm() < 0.05 {
            return found;
        }
        if self.model.prepare(scan, &velocity).is_err() {
            return found;
        }
        let covariance = diagonal(0.05, 0.02);
        let again = Prediction { t_odom_base: found.t_odom_base, covariance, is_measured: true };
        self.try_from(dt, &again).unwrap_or(found)
    }

    fn try_from(&mut self, dt: f64, prediction: &Prediction) -> Result<Match, LostReason> {
        let found = self.model.register(prediction)?;
        self.plausible(dt, found)
    }

    fn is_after_gap(&self, dt: f64) -> bool {
        self.unplaced_s + dt > self.params.tracking.max_gap_s
    }

    fn with_gap(&self, dt: f64, reason: LostReason) -> LostReason {
        if dt > self.params.tracking.max_gap_s { LostReason::TimeGap } else { reason }
    }

    fn plausible(&self, dt: f64, found: Match) -> Result<Match, LostReason> {
        let t_last_now = self.t_odom_base.inverse() * found.t_odom_base;
        // The constants allow for stamps that jitter.
        let too_far = t_last_now.translation.vector.norm() > self.limits.speed * dt.max(0.05) + 0.1;
        let too_much = t_last_now.rotation.angle() > self.limits.turn_rate * dt.max(0.05) + 0.1;
        if too_far || too_much {
            return Err(LostReason::MotionTooLarge);
        }
        // Meanwhile somebody may have carried the robot to a place that resembles the old one.
        if self.is_after_gap(dt) && !self.model.is_certain(&found) { Err(LostReason::TimeGap) } else { Ok(found) }
    }

    fn tracked(&mut self, stamp: Timestamp, dt: f64, found: Match) -> OdometryEstimate {
        let t_last_now = self.t_odom_base.inverse() * found.t_odom_base;
        let covariance = self.uncertainty.measured(&t_last_now, &found.covariance, &found.degenerate_axes);
        if self.limits.remembers_open {
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
        self.t_odom_base = self.model.refine(&found.t_odom_base).unwrap_or(found.t_odom_base);
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
            self.advance(prediction);
        }
        self.uncertainty.restarted();
        self.left_open = Covariance6::zeros();
        (self.num_lost, self.unplaced_s) = (0, 0.0);
        self.model.integrate(&self.t_odom_base);
        self.unmeasured(stamp, TrackingState::Initialising)
    }

    fn lost(&mut self, stamp: Timestamp, dt: f64, prediction: &Prediction, reason: LostReason) -> OdometryEstimate {
        self.num_lost += 1;
        self.unplaced_s += dt;
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
            degenerate_axes: [false; 6],
            scale: Scale::Measured,
            waiting: None,
        }
    }
}

/// Independent axes with these standard deviations (m, rad).
pub(crate) fn diagonal(sigma_t: f64, sigma_r: f64) -> Covariance6 {
    let (t, r) = (sigma_t * sigma_t, sigma_r * sigma_r);
    Covariance6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
}

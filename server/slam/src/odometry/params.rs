//! Parameters of odometry, and what robots can do.

use super::{OdometryKind, lidar2d, lidar3d, mono, rgbd};
use crate::covariance::diagonal;
use crate::keyframe::KeyframeParams;
use crate::motion_noise::{HANDS, WHEELED};
use crate::param_error::{ParamError, check_range};
use percept_geometry::Covariance6;
use serde::{Deserialize, Serialize};

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
    /// After so many lost frames in a row the local model starts anew at the predicted pose, 1 to 10000; after 3 at most if
    /// frames were missing before them (`max_gap_s`), or if they are planar scans that come 0.5 s or more apart. A camera
    /// without depth is always given all.
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
pub(super) struct MotionLimits {
    pub(super) speed: f64,
    pub(super) turn_rate: f64,
    pub(super) acceleration: f64,
    pub(super) turn_acceleration: f64,
    pub(super) smoothing: f64,
    /// Frames in a row that do not fit after a silence, from which on they are of another place.
    pub(super) frames_after_silence: usize,
    /// A lidar that sees all around in the plane that the robot drives in: what one scan leaves open (a corridor's length) is
    /// kept in mind for a later one, and scans may doubt wheels and are looked for widely, as they are placed cheaply.
    pub(super) is_planar: bool,
    /// Standard deviations that a motion prior is given besides its own: none is believed to be surer, m and rad.
    prior: (f64, f64),
}

/// See [`MotionLimits::frames_after_silence`]: what is in the way for a moment is gone by the third.
const FRAMES_AFTER_SILENCE: usize = 3;

impl MotionLimits {
    pub(super) fn of(kind: OdometryKind, params: &TrackingParams) -> Self {
        let (speed, turn_rate, (acceleration, turn_acceleration), smoothing) = match kind {
            OdometryKind::Rgbd | OdometryKind::Mono => (4.0, 8.0, HANDS, 0.03),
            OdometryKind::Lidar3d => (40.0, 8.0, HANDS, 0.04),
            OdometryKind::Lidar2d => (4.0, 3.0, WHEELED, 0.2),
        };
        Self {
            speed: params.max_speed_mps.unwrap_or(speed),
            turn_rate: params.max_turn_rate_radps.unwrap_or(turn_rate),
            acceleration: params.acceleration_mps2.unwrap_or(acceleration),
            turn_acceleration: params.turn_acceleration_radps2.unwrap_or(turn_acceleration),
            smoothing,
            // A place is found again within a second, so that a local model is not clung to. A camera's own map is all that it has.
            frames_after_silence: if kind == OdometryKind::Mono { usize::MAX } else { FRAMES_AFTER_SILENCE },
            is_planar: kind == OdometryKind::Lidar2d,
            // Wheels that are a hundredth off are so in every frame, while a 3D lidar's errors against its map average
            // out: were each step believed to the millimetre, they would drag the map along.
            prior: if kind == OdometryKind::Lidar3d { (0.01, 0.003) } else { (1e-3, 1e-3) },
        }
    }

    /// What is added to the covariance of a motion prior.
    pub(super) fn prior_floor(&self) -> Covariance6 {
        diagonal(self.prior.0, self.prior.1)
    }
}

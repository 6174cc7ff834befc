//! What a method brings: a local model that frames are placed in.

use super::rgbd::ViewFound;
use crate::color_camera::ColorCamera;
use crate::inertial::{Curve, Expected, PoseFactor};
use crate::scan::Scan;
use crate::tracking::LostReason;
use nalgebra::Vector6;
use percept_geometry::{Covariance6, KeyframeScan, Pose};
use std::sync::Arc;

/// Where base is expected before the scan is looked at.
#[derive(Debug, Clone)]
pub(crate) struct Prediction {
    pub(crate) t_odom_base: Pose,
    /// Right perturbation in base.
    pub(crate) covariance: Covariance6,
    /// Whether it was measured (by wheels, an IMU, another sensor), not assumed.
    pub(crate) is_measured: bool,
    /// The same for each axis of base.
    pub(crate) measured: [bool; 6],
    /// Whether the rotation is that which a gyro felt: unlike wheels and constant velocity it does not slip.
    pub(crate) is_turn_felt: bool,
    /// Seconds since the newest frame that was placed; 0 where there is none.
    pub(crate) elapsed_s: f64,
    /// Where base was then, base to odom, if that was the frame before.
    pub(crate) t_odom_before: Option<Pose>,
    /// What an IMU expects, if that is the prediction.
    pub(crate) inertial: Option<Expected>,
}

impl Prediction {
    /// Near a pose, whatever was before.
    pub(crate) fn within(t_odom_base: Pose, covariance: Covariance6) -> Self {
        Self {
            t_odom_base,
            covariance,
            is_measured: false,
            measured: [false; 6],
            is_turn_felt: false,
            elapsed_s: 0.0,
            t_odom_before: None,
            inertial: None,
        }
    }
}

/// A frame placed in the local model: one of several tries, perhaps, of which one is believed.
#[derive(Debug, Clone)]
pub(crate) struct Registration {
    pub(crate) t_odom_base: Pose,
    /// Of this measurement against the model, right perturbation in base.
    pub(crate) covariance: Covariance6,
    pub(crate) inlier_ratio: f64,
    pub(crate) rmse_m: f64,
    pub(crate) iterations: usize,
    pub(crate) degenerate_axes: [bool; 6],
    /// What it told by itself, of base, without what was predicted; none where a method does not know.
    pub(crate) told: Option<PoseFactor>,
    /// What the method found beside the pose.
    pub(crate) found: Found,
}

/// What a method finds beside the pose, and needs again when the frame goes into its model.
#[derive(Debug, Clone, Default)]
pub(crate) enum Found {
    /// Nothing.
    #[default]
    PoseAlone,
    /// How base moved during a sweep, and how that was found.
    Sweep(SweepFound),
    /// The model as it was seen from where a depth image was expected, and what moves in that.
    View(Arc<ViewFound>),
}

/// How base moved during a sweep, by where it was placed.
#[derive(Debug, Clone)]
pub(crate) struct SweepFound {
    /// Base's velocity, m/s and rad/s.
    pub(crate) velocity: Vector6<f64>,
    /// Seconds in which it may have changed from what was expected.
    pub(crate) elapsed: f64,
}

/// What a frame follows that is to fit without the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum After {
    /// A time in which the robot may have been carried off.
    Gap,
    /// Somebody's word of where it is.
    Word,
}

/// What a method brings: a local model that frames are placed in and then added to.
pub(crate) trait LocalModel: Send {
    /// How base moves while the frames to come are taken, as an IMU felt it; none where none did.
    fn follow_curve(&mut self, _curve: Option<Arc<Curve>>) {}
    /// Makes `scan` the current frame. `velocity` is base's (m/s, rad/s), for undoing sweeps.
    fn prepare(&mut self, scan: &Scan, velocity: &Vector6<f64>) -> Result<(), LostReason>;
    /// Whether there is nothing to register against.
    fn is_empty(&self) -> bool;
    /// Places the current frame. Changes nothing: of several tries only the one that is believed reaches the model, by
    /// [`LocalModel::believe`].
    fn register(&self, prediction: &Prediction) -> Result<Registration, LostReason>;
    /// Looks for the current frame wherever base can be within a way (m) and a turn (rad) of a pose in odom: all places where it
    /// is certain, the best first. None where too many fit nearly alike, or a method cannot look.
    fn search(&self, _t_odom_base: &Pose, _way: f64, _turn: f64) -> Option<Vec<Registration>> {
        None
    }
    /// The current frame lies there, and was expected at a pose in odom: what that teaches the method, before the frame is
    /// added.
    fn believe(&mut self, _placed: &Registration, _t_odom_expected: &Pose) {}
    /// Whether the current frame, placed after a time without any, fits so well that it can hardly be elsewhere; or so well, of much
    /// of which people may stand in the way, that it is where somebody says.
    fn is_certain(&self, _placed: &Registration, _after: After) -> bool {
        true
    }
    /// Base's velocity (m/s, rad/s) while the current frame was taken, where placing frames finds that too.
    fn sweep_velocity(&self) -> Option<Vector6<f64>> {
        None
    }
    /// How base moved while the current frame was taken, where an IMU felt it: that, and the velocity (m/s, rad/s) by which
    /// placing the frame corrected it.
    fn sweep_curve(&self) -> Option<(Arc<Curve>, Vector6<f64>)> {
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
    fn color_camera(&self) -> Option<ColorCamera> {
        None
    }
    /// Bytes that the model takes, about.
    fn memory_bytes(&self) -> usize;
    /// Forgets the model.
    fn clear(&mut self);
    /// Starts the model from keyframes with their `t_odom_base`, oldest first.
    fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]);
}

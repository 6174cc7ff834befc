//! What goes through the front end: what a sensor saw, where odometry has placed it, and the keyframe that it becomes.

use super::FoundAt;
use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_slam::{Odometry, OdometryEstimate, OdometryKind, Scan};

/// What a sensor saw of its surroundings.
pub(crate) struct View {
    pub(crate) spec: SensorSpec,
    /// Session's clock.
    pub(crate) stamp: Timestamp,
    pub(crate) scan: Scan,
    /// Whether it moves the pose.
    pub(crate) is_of_pose_sensor: bool,
    /// Whether another sensor did before.
    pub(crate) has_taken_over: bool,
}

impl View {
    /// The method that places it.
    pub(crate) fn kind(&self) -> OdometryKind {
        super::kind_of(&self.scan)
    }
}

/// A frame that odometry has placed, if it could.
pub(crate) struct Registered {
    /// Its state is what odometry measured; [`super::Tracking::told`] is what is said of it.
    pub(crate) estimate: OdometryEstimate,
    pub(crate) kind: OdometryKind,
    /// The second sensor that measured it in the pose sensor's place.
    pub(crate) led_by: Option<SensorId>,
    /// Whether odometry goes on after a loss with less than what usually fits: it may be elsewhere.
    pub(crate) is_doubtful: bool,
    /// Whether what was seen since odometry began anew moved with the robot: it says nothing of where that is.
    pub(crate) moved_along: bool,
    /// How the past moved with it, in a camera's own map: stamps, ascending, and old to new odom near them.
    pub(crate) moved: Vec<(Timestamp, Pose)>,
}

/// A frame that stays.
pub(crate) struct Keyframe {
    pub(crate) kind: SensorKind,
    pub(crate) scan: KeyframeScan,
    pub(crate) t_odom_base: Pose,
    /// Odometry's since the start.
    pub(crate) covariance: Covariance6,
    /// Whether its sensor moves the pose: loops are looked for from it.
    pub(crate) is_of_pose_sensor: bool,
}

impl Keyframe {
    /// What it shows, without what places are known by.
    pub(crate) fn ends(&self) -> KeyframeScan {
        KeyframeScan { features: None, ..self.scan.clone() }
    }
}

/// A robot that was found again.
pub(crate) struct Found {
    /// Tracking.
    pub(crate) estimate: OdometryEstimate,
    /// What to go on with, if not with the odometry that there is.
    pub(crate) odometry: Option<Odometry>,
    /// Where it was found, if odometry goes on.
    pub(crate) at: Option<FoundAt>,
    /// Whether nothing that it sees next can say otherwise.
    pub(crate) is_certain: bool,
}

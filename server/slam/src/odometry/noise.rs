//! How far odometry is off after a way: one model for each kind of sensor, asked by all who need to know. What no scan measured is
//! told by [`crate::motion_noise`].
//!
//! The errors of registration against a renewed local model are independent of each other and grow with the root of the way;
//! what is wrong in every step (a sensor's scale, the lever of a heading that has turned) grows with the way itself. The
//! numbers come from recordings, by `evaluate carmen|kitti-tracking|handheld|rgbd` (examples of this crate), which print root
//! mean squares of relative poses by the length of the way between them.

use super::OdometryKind;

/// Metres that a radian of turning counts as: views change by it as well. Times 0.7 103 and 19.8, times 1.4 91 and 26.6
/// on the log with wheels ([`crate::loops::planar`]).
const RADIAN_M: f64 = 0.5;

/// Of a placed frame's standard deviation, what a view adds: `evaluate handheld` and `kitti-tracking` (the end) with 3, 6 and 12 times:
/// 0.307, 0.0118, 0.0119 m, and 9.8, 9.9, 9.4 mm: flat upwards, while a model that believes old surfaces too much tears.
const PER_VIEW: f64 = 6.0;

/// A standard deviation that grows with the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    /// Of one registration against the local model, metres or radians.
    pub at_once: f64,
    /// Of errors that are independent, each metre: metres or radians / sqrt(m).
    pub per_root_m: f64,
    /// Of errors that add up: metres or radians a metre.
    pub per_m: f64,
}

impl Growth {
    /// After a way in metres.
    pub fn after(&self, way_m: f64) -> f64 {
        self.variance(way_m).sqrt()
    }

    fn variance(&self, way_m: f64) -> f64 {
        self.at_once.powi(2) + self.added(way_m)
    }

    /// The variance that a way in metres adds, m^2 or rad^2: what is off between two registrations beside their own errors.
    pub fn added(&self, way_m: f64) -> f64 {
        self.per_root_m.powi(2) * way_m + (self.per_m * way_m).powi(2)
    }

    /// Of the difference to another one, whose errors are independent.
    fn against(&self, other: &Self) -> Self {
        Self {
            at_once: self.at_once.hypot(other.at_once),
            per_root_m: self.per_root_m.hypot(other.per_root_m),
            per_m: self.per_m.hypot(other.per_m),
        }
    }

    /// The way, metres, that adds so much.
    pub fn way_of(&self, sigma: f64) -> f64 {
        let (linear, half) = (self.per_m.powi(2), 0.5 * self.per_root_m.powi(2));
        // Of linear d^2 + 2 half d = sigma^2 the positive root, as it does not cancel.
        sigma * sigma / (half + (half * half + linear * sigma * sigma).sqrt())
    }
}

/// How far odometry of one kind is off after a way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Of the position, metres.
    pub position: Growth,
    /// Of the orientation, radians.
    pub rotation: Growth,
}

impl OdometryNoise {
    /// Of an odometry. Planar: Intel and CSAIL without wheels, 0.3 to 200 m, beside the same with loops closed. 3D lidars: the
    /// handheld Livox, 30 m, and KITTI, 7 m; what adds up over longer ways is half of what KISS-ICP has on KITTI's odometry sets (Vizzo
    /// et al., 2023: 0.5 %). Depth cameras: 7-Scenes, 3 m, whose truth is good to two centimetres, so
    /// that half of what is left there is counted; simulated ones are ten times better. Cameras alone are taken for as good.
    pub fn of(kind: OdometryKind) -> Self {
        let growth = |(at_once, per_root_m, per_m)| Growth { at_once, per_root_m, per_m };
        let (position, rotation) = match kind {
            OdometryKind::Lidar2d => ((0.005, 0.0075, 0.0017), (0.002, 0.0015, 0.000_15)),
            OdometryKind::Lidar3d => ((0.005, 0.007, 0.003), (0.002, 0.0009, 0.0001)),
            OdometryKind::Rgbd | OdometryKind::Mono => ((0.005, 0.02, 0.002), (0.003, 0.012, 0.0002)),
        };
        Self { position: growth(position), rotation: growth(rotation) }
    }

    /// The standard deviation by which a local model of surfaces drifts while the whole view becomes new, where frames are placed in it
    /// with this one: what was seen a view ago is off by so much. A view is longer than a step, and a scene that holds less drifts more,
    /// so that this goes by views and not by metres: with [`Self::added`] by the way, simulated rosettes were off by 0.105 m instead of
    /// 0.018 (`evaluate lidar-sim rosette seconds=30`), the handheld recording by 0.0146 instead of 0.0118.
    pub(crate) fn per_view(sigma: f64) -> f64 {
        PER_VIEW * sigma
    }

    /// Of the difference between this odometry and another one of the same robot.
    pub fn against(&self, other: &Self) -> Self {
        Self { position: self.position.against(&other.position), rotation: self.rotation.against(&other.rotation) }
    }

    /// Standard deviations of position (m) and orientation (rad) of one registration against the local model.
    pub fn at_once(&self) -> (f64, f64) {
        (self.position.at_once, self.rotation.at_once)
    }

    /// Variances of position (m^2) and orientation (rad^2) that the way adds to each axis, beside those of registrations.
    pub fn added(&self, way_m: f64) -> (f64, f64) {
        (self.position.added(way_m), self.rotation.added(way_m))
    }

    /// Standard deviations of position (m) and orientation (rad) that the way adds to each axis.
    pub fn after(&self, way_m: f64) -> (f64, f64) {
        (self.position.after(way_m), self.rotation.after(way_m))
    }
}

/// The length of a motion, metres: what it moves (m) and what it turns (rad).
pub fn way_m(moved_m: f64, turned_rad: f64) -> f64 {
    moved_m + RADIAN_M * turned_rad.abs()
}

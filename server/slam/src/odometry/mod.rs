//! Odometry: scans of one sensor in, the pose of base in the drifting frame `odom` out.
//!
//! Every kind registers frame to local model, never frame to frame. Start with [`Odometry::register`]. Depth cameras and
//! lidars share one way of doing it ([`local`]) and differ in their model ([`rgbd`], [`lidar3d`], [`lidar2d`]). A camera
//! alone ([`camera`], [`mono`]) has a map and a state of its own: what the others share supposes that lengths are known.

mod camera;
mod kind;
pub mod lidar2d;
pub mod lidar3d;
mod local;
mod model;
pub mod mono;
mod noise;
mod params;
pub mod rgbd;
mod rhythm;
mod uncertainty;

use crate::inertial::ImuBuffer;
use crate::keyframe::{KeyframeParams, LaterScan, later};
use crate::motion_prior::MotionPrior;
use crate::scan::{ImageScan, Scan};
use crate::tracking::{Scale, TrackingState, Waiting};
use camera::CameraOdometry;
pub use kind::OdometryKind;
use local::LocalOdometry;
pub(crate) use model::{After, Found, LocalModel, Prediction, Registration};
use nalgebra::Vector6;
pub use noise::{Growth, OdometryNoise, way_m};
pub use params::{OdometryParams, TrackingParams};
use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, Timestamp};
use std::sync::Arc;

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

/// What a scan says of where somebody says that base is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToldPlace {
    /// It can hardly be elsewhere.
    Certain,
    /// It fits, but for much that stands in the way.
    Likely,
    /// It does not fit there, or contradicts what was seen there.
    Refuted,
}

/// Odometry of one sensor: deterministic, no clock, no I/O; parallel on rayon's current pool.
#[derive(Debug)]
pub struct Odometry {
    method: Method,
    /// Of the newest estimate.
    covariance: Covariance6,
}

/// How a sensor is followed.
enum Method {
    Local(Box<LocalOdometry>),
    Camera(Box<CameraOdometry>),
}

impl std::fmt::Debug for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Local(local) => local.fmt(f),
            Self::Camera(camera) => {
                f.debug_struct("Camera").field("t_odom_base", camera.t_odom_base()).finish_non_exhaustive()
            }
        }
    }
}

impl Odometry {
    /// An odometry without a local model, at the origin of odom. Validate `params` first.
    pub fn new(kind: OdometryKind, params: OdometryParams) -> Self {
        let model: Option<Box<dyn LocalModel>> = match kind {
            OdometryKind::Rgbd => Some(Box::new(rgbd::Rgbd::new(params.rgbd.clone()))),
            OdometryKind::Lidar3d => Some(Box::new(lidar3d::Lidar3d::new(params.lidar3d.clone()))),
            OdometryKind::Lidar2d => Some(Box::new(lidar2d::Lidar2d::new(params.lidar2d.clone()))),
            OdometryKind::Mono => None,
        };
        let method = match model {
            Some(model) => Method::Local(Box::new(LocalOdometry::new(kind, model, params))),
            None => Method::Camera(Box::new(CameraOdometry::new(&params))),
        };
        Self { method, covariance: Covariance6::zeros() }
    }

    /// Places a scan, adds it to the local model and says where base was when it was taken.
    ///
    /// A frame that cannot be placed gives `Lost` with the prediction as pose; the next frames are tried
    /// against the same model until `restart_after_frames` of them are lost.
    pub fn register(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) -> OdometryEstimate {
        self.register_with_imu(stamp, scan, prior, None)
    }

    /// The same with the samples of an IMU, those up to the sweep's end if there are: they predict the motion where `prior`
    /// leaves the translation open, and undo a sweep's motion, however quick. It takes a second of placed frames until they
    /// do; those that are wrong never do. Planar scans make use of the turn that was felt while they were taken, images of a
    /// camera alone of nothing beyond `prior`.
    pub fn register_with_imu(
        &mut self,
        stamp: Timestamp,
        scan: &Scan,
        prior: Option<&MotionPrior>,
        imu: Option<&ImuBuffer>,
    ) -> OdometryEstimate {
        let estimate = match &mut self.method {
            Method::Local(local) => local.register(stamp, scan, prior, imu),
            Method::Camera(camera) => camera.register(stamp, scan, prior),
        };
        self.covariance = estimate.covariance;
        estimate
    }

    /// How the past moved with the newest frame, where the method closes loops in a map of its own (a camera's): stamps,
    /// ascending, and what takes poses in odom near them in time to where they are now. Given once.
    pub fn take_moved(&mut self) -> Vec<(Timestamp, Pose)> {
        match &mut self.method {
            Method::Local(_) => vec![],
            Method::Camera(camera) => camera.take_moved(),
        }
    }

    /// What tells a camera its scale: a depth image of the same view, or an image of a second camera, that came after
    /// the newest image and belongs to it. Other methods, and a camera that is lost, take no notice.
    pub fn tell_scale(&mut self, hint: &ImageScan) {
        if let Method::Camera(camera) = &mut self.method {
            camera.tell_scale(hint);
        }
    }

    /// What was learned of an IMU does not hold any more: it is mounted otherwise, or another one. It has to prove itself again.
    pub fn forget_imu(&mut self) {
        if let Method::Local(local) = &mut self.method {
            local.forget_imu();
        }
    }

    /// In how many placed frames in a row the IMU that it was given predicted worse than constant velocity did.
    pub fn num_imu_unbelieved(&self) -> u32 {
        match &self.method {
            Method::Local(local) => local.num_imu_unbelieved(),
            Method::Camera(_) => 0,
        }
    }

    /// Whether the newest frame was placed.
    pub fn is_tracking(&self) -> bool {
        match &self.method {
            Method::Local(local) => local.is_tracking(),
            Method::Camera(camera) => camera.is_tracking(),
        }
    }

    /// Base's velocity in base, m/s and rad/s, from the last two placed frames; zero when not known.
    pub fn velocity(&self) -> Vector6<f64> {
        match &self.method {
            Method::Local(local) => local.velocity(),
            Method::Camera(camera) => camera.velocity(),
        }
    }

    /// Of the newest pose since the start, drift included, right perturbation in base.
    pub fn covariance(&self) -> Covariance6 {
        self.covariance
    }

    /// The newest pose, base to odom.
    pub fn t_odom_base(&self) -> &Pose {
        match &self.method {
            Method::Local(local) => local.t_odom_base(),
            Method::Camera(camera) => camera.t_odom_base(),
        }
    }

    /// Bytes that the local model takes, about.
    pub fn memory_bytes(&self) -> usize {
        match &self.method {
            Method::Local(local) => local.memory_bytes(),
            Method::Camera(camera) => camera.mono().memory_bytes(),
        }
    }

    /// Changes what keyframes keep from now on.
    pub fn set_keyframe_params(&mut self, params: KeyframeParams) {
        match &mut self.method {
            Method::Local(local) => local.set_keyframe_params(params),
            Method::Camera(camera) => camera.set_keyframe_params(params),
        }
    }

    /// What a keyframe keeps of a scan: ends of beams in base, thinned; see [`KeyframeScan`]. Of a camera's image the points
    /// of its map that it shows, once lengths are metres, and nothing before.
    pub fn keyframe_scan(&self, stamp: Timestamp, sensor: &SensorId, scan: &Scan) -> KeyframeScan {
        match &self.method {
            Method::Local(local) => local.keyframe_scan(stamp, sensor, scan),
            Method::Camera(camera) => camera.keyframe_scan(stamp, sensor, scan),
        }
    }

    /// Where beams of a scan that was just placed end, thinned as a keyframe's, without what places are known by: to be worked out
    /// when it is wanted. None of a camera's image.
    pub fn ends_later(&self, stamp: Timestamp, sensor: &SensorId, scan: &Scan) -> Option<LaterScan> {
        let Method::Local(local) = &self.method else { return None };
        Some(later(local.keyframe_params(), (stamp, sensor, scan), local.sweep_motion(scan)))
    }

    /// What a camera's map now makes of the past: its views' stamps and `t_odom_base`, oldest first; for other kinds none.
    pub fn views(&self, t_base_sensor: &Pose) -> Vec<(Timestamp, Pose)> {
        match &self.method {
            Method::Local(_) => vec![],
            Method::Camera(camera) => camera.mono().views(t_base_sensor),
        }
    }

    /// Goes on after a restart: `recent` keyframes with their `t_odom_base`, oldest first, become the
    /// local model, and the next frame is expected near `t_odom_base_last`, base's pose at `stamp`.
    pub fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)], stamp: Timestamp) {
        match &mut self.method {
            Method::Local(local) => local.seed(t_odom_base_last, recent, stamp),
            Method::Camera(camera) => camera.seed(t_odom_base_last, stamp),
        }
    }

    /// Begins anew at a pose that something else has led to over the last stretch of the way, `told`, with the next frame; what is said
    /// of this one. A camera alone, which has no local model, is not led: none.
    pub fn lead_to(&mut self, t_odom_base: &Pose, told: &Pose, stamp: Timestamp) -> Option<OdometryEstimate> {
        let Method::Local(local) = &mut self.method else { return None };
        let estimate = local.lead_to(t_odom_base, told, stamp);
        self.covariance = estimate.covariance;
        Some(estimate)
    }

    /// Begins in a map where somebody says that base is: `near` views of it with their poses in odom become the local model, and `scan`,
    /// taken at `stamp`, says how well it fits there; none where there is nothing to be compared with, and the word is believed. Refuted,
    /// this odometry is of no use. A camera alone, which has no local model, is believed.
    pub fn begin_at(
        &mut self,
        t_odom_told: &Pose,
        near: &[(Pose, Arc<KeyframeScan>)],
        scan: &Scan,
        stamp: Timestamp,
    ) -> Option<ToldPlace> {
        self.seed(t_odom_told, near, stamp);
        match &mut self.method {
            Method::Local(local) if !near.is_empty() => Some(local.settle(scan)),
            Method::Local(_) | Method::Camera(_) => None,
        }
    }
}

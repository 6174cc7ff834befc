//! A camera alone: images in, poses out, by a sparse map of points that several views see.
//!
//! An image becomes ORB features at undistorted pixels ([`frame`]); two images with parallax start the map ([`start`]);
//! every further one is placed among the map's points ([`tracker`], [`search`], [`pose`]), and now and then one becomes a
//! view that adds points ([`grow`]) and is adjusted with its neighbours ([`local`], [`adjust`]).
//!
//! One camera does not know how large things are: poses are in a unit of the map's own (the median depth of the first
//! view) until the scale is taken from elsewhere ([`scale`]). The estimate says which: [`Scale`].
//!
//! **Source** of the whole: Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system",
//! 2015. We depart from it in doing all in turn in one thread, in places found by sampled bits instead of a trained
//! vocabulary, and in the two-view choice by Torr's criterion.

mod adjust;
mod frame;
mod grow;
mod local;
mod loops;
mod map;
mod places;
mod pose;
mod scale;
mod search;
mod similarity;
mod start;
mod tracker;

use crate::odometry::uncertainty::Uncertainty;
use crate::odometry::{LocalModel, Match, MotionPrior, OdometryEstimate, Prediction, diagonal};
use crate::scan::{ImageScan, Scan};
use crate::tracking::{LostReason, Scale, TrackingState, Waiting};
use crate::{ParamError, check_range};
use frame::Lens;
use nalgebra::{Translation3, Vector6};
use percept_geometry::{CameraIntrinsics, Covariance6, KeyframeScan, PointCloud, Pose, Timestamp, se3};
use pose::PlacedCamera;
use scale::Scaling;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tracker::{Outcome, Tracker};

/// Parameters of odometry by a camera alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MonoParams {
    /// Features sought in an image, 200 to 10000. More: surer in poor light, slower.
    pub max_features: usize,
    /// Lowe's test where features are matched by looks alone: the nearest has to be nearer than this times the second
    /// nearest, 0.3 to 0.95.
    pub match_ratio: f64,
    /// Whether places seen again correct the map and its scale.
    pub close_loops: bool,
}

impl Default for MonoParams {
    fn default() -> Self {
        Self { max_features: 1000, match_ratio: 0.75, close_loops: true }
    }
}

impl MonoParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let features = self.max_features as f64;
        check_range("mono.max_features", features, (200.0, 10_000.0), "within 200 to 10000", "use 1000")?;
        check_range("mono.match_ratio", self.match_ratio, (0.3, 0.95), "within 0.3 to 0.95", "use 0.75")
    }
}

/// Odometry of one camera.
pub(crate) struct Mono {
    tracker: Tracker,
    params: MonoParams,
    lens: Option<(CameraIntrinsics, Lens)>,
    /// Base to odom when the map's first view was taken.
    t_odom_start: Pose,
    t_odom_base: Pose,
    scaling: Scaling,
    uncertainty: Uncertainty,
    num_lost: usize,
}

impl Mono {
    pub(crate) fn new(params: &MonoParams) -> Self {
        Self {
            tracker: Tracker::new(params),
            params: params.clone(),
            lens: None,
            t_odom_start: Pose::identity(),
            t_odom_base: Pose::identity(),
            scaling: Scaling::default(),
            uncertainty: Uncertainty::default(),
            num_lost: 0,
        }
    }

    /// Places an image; see [`crate::Odometry::register`].
    pub(crate) fn track(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) -> OdometryEstimate {
        let Scan::Image(scan) = scan else { return self.lost(stamp, prior, LostReason::UnsuitableScan) };
        let lens = match self.lens(&scan.intrinsics) {
            Ok(lens) => lens,
            Err(reason) => return self.lost(stamp, prior, reason),
        };
        let frame = match frame::extract(&scan.image, &scan.intrinsics, &lens, self.params.max_features) {
            Ok(frame) => frame,
            Err(reason) => return self.lost(stamp, prior, reason),
        };
        let motion = self.tracker.motion.as_ref();
        let hint = prior.map(|p| self.scaling.hint(p, &scan.t_base_sensor, motion));
        let views_before = self.tracker.newest;
        let outcome = self.tracker.track(stamp, frame, &lens, hint.as_ref());
        if !self.tracker.has_map() {
            self.scaling = Scaling::default();
        }
        self.scaling.moved(prior, &scan.t_base_sensor, &mut self.tracker, views_before);
        match outcome {
            Outcome::Waiting(waiting) => self.waiting(stamp, prior, waiting),
            Outcome::Started => {
                self.t_odom_start = self.t_odom_base;
                self.uncertainty.restarted();
                self.num_lost = 0;
                self.t_odom_base = self.newest(&scan.t_base_sensor);
                self.unmeasured(stamp, TrackingState::Initialising, None)
            }
            Outcome::Placed(placed) => {
                if std::mem::take(&mut self.tracker.is_corrected) {
                    // The newest pose stays where it is: the past moves, see `views`.
                    let t_start_base = self.t_odom_start.inverse() * self.newest(&scan.t_base_sensor);
                    self.t_odom_start = self.t_odom_base * t_start_base.inverse();
                }
                self.tracked(stamp, scan, &placed)
            }
            Outcome::Lost(reason) => self.lost(stamp, prior, reason),
        }
    }

    /// The lens of these intrinsics; other intrinsics than before begin anew.
    fn lens(&mut self, k: &CameraIntrinsics) -> Result<Lens, LostReason> {
        if k.validate().is_err() {
            return Err(LostReason::IntrinsicsMismatch);
        }
        if let Some((known, lens)) = &self.lens
            && known == k
        {
            return Ok(*lens);
        }
        let lens = Lens::of(k);
        self.tracker.clear();
        self.lens = Some((*k, lens));
        Ok(lens)
    }

    /// Base in odom of a camera in the map. The lever arm counts only where lengths are metres.
    fn to_odom(&self, t_camera_map: &Pose, t_base_sensor: &Pose) -> Pose {
        let mut b = *t_base_sensor;
        if self.scaling.scale() == Scale::Unknown {
            b.translation = Translation3::identity();
        }
        self.t_odom_start * b * t_camera_map.inverse() * b.inverse()
    }

    fn newest(&self, t_base_sensor: &Pose) -> Pose {
        self.tracker.t_camera_map().map_or(self.t_odom_base, |t| self.to_odom(t, t_base_sensor))
    }

    fn tracked(&mut self, stamp: Timestamp, scan: &ImageScan, placed: &PlacedCamera) -> OdometryEstimate {
        if let Some(depth) = &scan.depth {
            self.scaling.see_depth(depth, scan, &mut self.tracker);
        }
        if let Some(second) = &scan.second {
            self.scaling.see_second(second, &mut self.tracker, self.params.max_features);
        }
        let before = self.t_odom_base;
        self.t_odom_base = self.newest(&scan.t_base_sensor);
        let covariance = self.covariance(placed, &scan.t_base_sensor);
        let t_last_now = before.inverse() * self.t_odom_base;
        let covariance = self.uncertainty.measured(&t_last_now, &covariance, &[false; 6]);
        self.num_lost = 0;
        OdometryEstimate {
            stamp,
            t_odom_base: self.t_odom_base,
            covariance,
            state: TrackingState::Tracking,
            inlier_ratio: placed.num_inliers as f64 / placed.inliers.len().max(1) as f64,
            rmse_m: 0.0,
            iterations: placed.iterations,
            degenerate_axes: [false; 6],
            scale: self.scaling.scale(),
            waiting: None,
        }
    }

    /// Of the pose against the map, right perturbation in base.
    fn covariance(&self, placed: &PlacedCamera, t_base_sensor: &Pose) -> Covariance6 {
        // A left perturbation of t_camera_map is the opposite right one of t_map_camera.
        let camera = placed.information.try_inverse().unwrap_or_else(|| diagonal(1.0, 1.0));
        let adjoint = se3::adjoint(t_base_sensor);
        // Map points are as wrong as the sightings: twice the variance.
        adjoint * camera * adjoint.transpose() * 2.0
    }

    fn waiting(&mut self, stamp: Timestamp, prior: Option<&MotionPrior>, waiting: Waiting) -> OdometryEstimate {
        self.advance(prior);
        self.unmeasured(stamp, TrackingState::Initialising, Some(waiting))
    }

    fn lost(&mut self, stamp: Timestamp, prior: Option<&MotionPrior>, reason: LostReason) -> OdometryEstimate {
        self.num_lost += 1;
        self.advance(prior);
        self.unmeasured(stamp, TrackingState::Lost { reason }, None)
    }

    /// By the prior, if there is one; else base is taken to stand, and that is a poor guess.
    fn advance(&mut self, prior: Option<&MotionPrior>) {
        let still = MotionPrior { t_prev_now: Pose::identity(), covariance: diagonal(0.05, 0.05) };
        let prior = prior.unwrap_or(&still);
        self.uncertainty.predicted(&prior.t_prev_now, &prior.covariance);
        self.t_odom_base *= prior.t_prev_now;
    }

    fn unmeasured(&self, stamp: Timestamp, state: TrackingState, waiting: Option<Waiting>) -> OdometryEstimate {
        OdometryEstimate {
            stamp,
            t_odom_base: self.t_odom_base,
            covariance: self.uncertainty.covariance(),
            state,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            iterations: 0,
            degenerate_axes: [false; 6],
            scale: self.scaling.scale(),
            waiting,
        }
    }
}

impl LocalModel for Mono {
    fn prepare(&mut self, _: &Scan, _: &Vector6<f64>) -> Result<(), LostReason> {
        Err(LostReason::UnsuitableScan)
    }

    fn is_empty(&self) -> bool {
        !self.tracker.has_map()
    }

    fn register(&mut self, _: &Prediction) -> Result<Match, LostReason> {
        Err(LostReason::UnsuitableScan)
    }

    fn integrate(&mut self, _: &Pose) {}

    fn clear(&mut self) {
        self.tracker.clear();
    }

    fn seed(&mut self, t_odom_base_last: &Pose, _: &[(Pose, Arc<KeyframeScan>)]) {
        self.t_odom_base = *t_odom_base_last;
    }

    fn sparse_points(&self, t_base_sensor: &Pose) -> PointCloud {
        if !self.scaling.scale().is_metric() {
            return PointCloud::default();
        }
        let points = self.tracker.points_in_camera().into_iter();
        PointCloud::from_positions(points.map(|p| (t_base_sensor * p).cast()).collect())
    }

    fn views(&self, t_base_sensor: &Pose) -> Vec<(Timestamp, Pose)> {
        let views = self.tracker.map.views.values();
        views.map(|v| (v.stamp, self.to_odom(&v.t_camera_map, t_base_sensor))).collect()
    }

    fn as_mono(&mut self) -> Option<&mut Mono> {
        Some(self)
    }
}

//! A camera alone: images in, poses out, by a sparse map of points that several views see.
//!
//! An image becomes ORB features at undistorted pixels ([`frame`]); two images with parallax start the map ([`start`]);
//! every further one is placed among the map's points ([`tracker`], [`search`], [`pose`]), and now and then one becomes a
//! view that adds points ([`triangulation`]) and is adjusted with its neighbours ([`local`], [`bundle_adjustment`]).
//!
//! One camera does not know how large things are: poses are in a unit of the map's own (the median depth of the first
//! view) until the scale is taken from elsewhere ([`scale`]). The estimate says which: [`Scale`].
//!
//! **Source** of the whole: Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system",
//! 2015. We depart from it in doing all in turn in one thread, in places found by sampled bits instead of a trained
//! vocabulary, and in the two-view choice by Torr's criterion.
//!
//! Where a constant says "halved" and "doubled", this is the ATE with the best scale, millimetres, of
//! `evaluate mono rgbd-7scenes-a` as it went on: 25.1 with the constants as they are.

mod atlas;
mod bundle_adjustment;
mod frame;
mod known_steps;
mod local;
mod loops;
mod map;
mod places;
mod pose;
mod scale;
mod search;
mod second;
mod similarity;
mod start;
mod tracker;
mod triangulation;

use crate::covariance::diagonal;
use crate::motion_prior::{MotionPrior, UNKNOWN_VARIANCE};
use crate::odometry::OdometryEstimate;
use crate::odometry::uncertainty::Uncertainty;
use crate::param_error::{ParamError, check_range};
use crate::scan::{ImageScan, Scan};
use crate::tracking::{LostReason, Scale, TrackingState, Waiting};
use atlas::Atlas;
use frame::Lens;
use map::ViewId;
use nalgebra::{Point2, Translation3};
use percept_geometry::{
    CameraIntrinsics, Covariance6, FeatureMethod, KeyframeFeature, KeyframeFeatures, PointCloud, Pose, Timestamp, se3,
};
use pose::PlacedCamera;
use scale::Scaling;
use serde::{Deserialize, Serialize};
use tracker::{Outcome, Tracker};

/// Images farther apart than this in time need not overlap, seconds. It only names the reason; halved and doubled 25.1
/// ([`self`]).
const GAP_S: f64 = 1.0;
/// A turn between two images by which so large a share of what the first shows leaves the second. It only names the
/// reason; halved and doubled 25.1 ([`self`]).
const FAST_TURN: f64 = 0.25;

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
    /// The image that a second view is sought for: its stamp, and base to odom then.
    reference: Option<(Timestamp, Pose)>,
    t_odom_base: Pose,
    last_stamp: Option<Timestamp>,
    moved: Vec<(Timestamp, Pose)>,
    scaling: Scaling,
    /// Maps that were left because nothing fitted them.
    atlas: Atlas,
    /// Base to odom in metres, by priors since the last pose in metres, and whether they told the way of every frame since.
    reckoned: (Pose, bool),
    uncertainty: Uncertainty,
    num_lost: usize,
    /// So many images in a row that do not fit the map end it.
    restart_after: usize,
}

impl Mono {
    pub(crate) fn new(params: &MonoParams, restart_after: usize) -> Self {
        Self {
            tracker: Tracker::new(params),
            params: params.clone(),
            lens: None,
            t_odom_start: Pose::identity(),
            reference: None,
            last_stamp: None,
            moved: vec![],
            t_odom_base: Pose::identity(),
            scaling: Scaling::default(),
            atlas: Atlas::default(),
            reckoned: (Pose::identity(), true),
            uncertainty: Uncertainty::new(crate::OdometryKind::Mono),
            num_lost: 0,
            restart_after,
        }
    }

    /// Places an image; see [`crate::Odometry::register`].
    pub(crate) fn track(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) -> OdometryEstimate {
        let since = self.last_stamp.replace(stamp).map_or(0.0, |last| stamp.seconds_since(last));
        self.reckon(prior, since);
        let Scan::Image(scan) = scan else { return self.lost(stamp, prior, LostReason::UnsuitableScan) };
        let lens = match self.lens(&scan.intrinsics) {
            Ok(lens) => lens,
            Err(reason) => return self.lost(stamp, prior, reason),
        };
        let frame = match frame::extract(&scan.image, &scan.intrinsics, &lens, self.params.max_features) {
            Ok(frame) => frame,
            Err(reason) => return self.lost(stamp, prior, reason),
        };
        let motion = self.tracker.motion;
        let hint = prior.map(|p| self.scaling.hint(p, &scan.t_base_sensor, motion.as_ref()));
        let turn = hint.or(motion).map_or(0.0, |m| m.rotation.angle());
        let views_before = self.tracker.newest;
        let spare = (!self.atlas.is_empty()).then(|| frame.clone());
        let outcome = self.tracker.track(stamp, frame, &lens, hint.as_ref());
        if !self.tracker.has_map() {
            self.scaling = Scaling::default();
        }
        self.scaling.moved(prior, &scan.t_base_sensor, &mut self.tracker, views_before);
        let returned = match (&outcome, spare) {
            (Outcome::Waiting(_) | Outcome::Lost(_), Some(frame)) => self.take_back(stamp, frame, &lens),
            _ => None,
        };
        match returned.map_or(outcome, Outcome::Placed) {
            Outcome::Waiting(waiting) => {
                let estimate = self.waiting(stamp, prior, waiting);
                self.note_reference();
                self.tell_scale(scan);
                OdometryEstimate { scale: self.scaling.scale(), ..estimate }
            }
            Outcome::Started => {
                self.begun(&scan.t_base_sensor);
                self.unmeasured(stamp, TrackingState::Initialising, None)
            }
            Outcome::Placed(placed) => {
                if let Some(before) = self.tracker.corrected.take() {
                    self.correct(&before, &scan.t_base_sensor);
                }
                self.tracked(stamp, scan, &placed)
            }
            Outcome::Lost(reason) => {
                let turned = turn * lens.focal / scan.intrinsics.width as f64;
                let estimate = self.lost(stamp, prior, why(reason, since, turned));
                self.give_up();
                self.note_reference();
                self.tell_scale(scan);
                estimate
            }
        }
    }

    /// A loop was closed: the newest pose stays where it is, the past moves.
    fn correct(&mut self, before: &[(ViewId, Pose)], t_base_sensor: &Pose) {
        let old: Vec<(ViewId, Pose)> = before.iter().map(|(id, t)| (*id, self.to_odom(t, t_base_sensor))).collect();
        // The newest view is the image that closed the loop.
        let kept = old.last().map_or(self.t_odom_base, |(_, t)| *t);
        let t_start_base = self.t_odom_start.inverse() * self.newest(t_base_sensor);
        self.t_odom_start = kept * t_start_base.inverse();
        let moved = old.into_iter().filter_map(|(id, old)| {
            let view = self.tracker.map.views.get(&id)?;
            Some((view.stamp, self.to_odom(&view.t_camera_map, t_base_sensor) * old.inverse()))
        });
        self.moved = moved.collect();
    }

    /// How past views moved when a loop was closed with the newest image, once: stamps, ascending, and what takes poses
    /// in odom to where they are now.
    pub(crate) fn take_moved(&mut self) -> Vec<(Timestamp, Pose)> {
        std::mem::take(&mut self.moved)
    }

    /// Takes a depth image of the same view, or an image of a second camera, in, that belongs to the newest image.
    pub(crate) fn tell_scale(&mut self, hint: &ImageScan) {
        let is_placed = self.tracker.has_map() && self.num_lost == 0;
        let is_reference = !self.tracker.has_map() && self.tracker.reference_stamp() == self.last_stamp;
        if let Some(depth) = hint.depth.as_ref().filter(|_| is_placed) {
            self.scaling.see_depth(depth, hint, &mut self.tracker);
        }
        if let (Some(second), Some((_, lens))) = (&hint.second, &self.lens)
            && (is_placed || is_reference)
            && self.scaling.see_second(second, lens, &mut self.tracker, self.params.max_features)
        {
            self.begun(&hint.t_base_sensor);
        }
    }

    /// The map began with the image that was the reference, or with that and the newest.
    fn begun(&mut self, t_base_sensor: &Pose) {
        self.t_odom_start = self.reference.take().map_or(self.t_odom_base, |(_, t)| t);
        self.uncertainty.restarted();
        self.num_lost = 0;
        self.t_odom_base = self.newest(t_base_sensor);
    }

    /// Where base was when the image came that a second view is sought for.
    fn note_reference(&mut self) {
        let stamp = self.tracker.reference_stamp();
        if stamp != self.reference.map(|(known, _)| known) {
            self.reference = stamp.map(|stamp| (stamp, self.t_odom_base));
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
        self.atlas = Atlas::default();
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
        self.num_lost = 0;
        self.tell_scale(scan);
        let before = self.t_odom_base;
        self.t_odom_base = self.newest(&scan.t_base_sensor);
        if self.scaling.scale().is_metric() {
            self.reckoned = (self.t_odom_base, true);
        }
        let covariance = self.covariance(placed, &scan.t_base_sensor);
        let t_last_now = before.inverse() * self.t_odom_base;
        let covariance = self.uncertainty.measured(&t_last_now, &covariance, &[false; 6]);
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
        // A gyro alone says nothing of the way.
        let mut prior = prior.unwrap_or(&still).clone();
        if !knows_way(&prior) {
            let way = still.covariance.fixed_view::<3, 3>(0, 0).into_owned();
            prior.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&way);
        }
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

    /// Bytes that the map takes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        self.tracker.map.memory_bytes()
    }

    /// Forgets the map; base is there in odom.
    pub(super) fn begin_at(&mut self, t_odom_base: &Pose) {
        self.tracker.clear();
        self.atlas = Atlas::default();
        self.t_odom_base = *t_odom_base;
        self.reckoned = (self.t_odom_base, true);
    }

    /// The map's points that the last image shows, in base, metres; none where lengths are not metres.
    pub(super) fn sparse_points(&self, t_base_sensor: &Pose) -> PointCloud {
        if !self.scaling.scale().is_metric() {
            return PointCloud::default();
        }
        let points = self.tracker.points_in_camera().into_iter();
        PointCloud::from_positions(points.map(|p| (t_base_sensor * p).cast()).collect())
    }

    /// What the last image shows of these points, as a keyframe keeps it.
    pub(super) fn features(&self, t_base_sensor: &Pose) -> Option<KeyframeFeatures> {
        let (_, lens) = self.lens.as_ref().filter(|_| self.scaling.scale().is_metric())?;
        let known = self.tracker.features_in_camera().into_iter().map(|(pixel, descriptor, p)| KeyframeFeature {
            descriptor,
            p_base: (t_base_sensor * p).cast(),
            pixel: Point2::from((pixel - lens.min).cast()),
        });
        let known: Vec<KeyframeFeature> = known.collect();
        let step = known.len().div_ceil(KeyframeFeatures::LIMIT).max(1);
        let mut camera = lens.intrinsics();
        (camera.cx, camera.cy) = (-lens.min.x, -lens.min.y);
        // Those that it tracks: others would need points of their own, and a map of them.
        let method = FeatureMethod::Orb;
        Some(KeyframeFeatures { method, camera, features: known.into_iter().step_by(step).collect() })
    }

    /// Stamps and `t_odom_base` of the images that are kept.
    pub(super) fn views(&self, t_base_sensor: &Pose) -> Vec<(Timestamp, Pose)> {
        let views = self.tracker.map.views.values();
        views.map(|v| (v.stamp, self.to_odom(&v.t_camera_map, t_base_sensor))).collect()
    }
}

/// Whether a prior tells the translation: a gyro's does not.
fn knows_way(prior: &MotionPrior) -> bool {
    (0..3).all(|i| prior.covariance[(i, i)] <= UNKNOWN_VARIANCE)
}

/// An image that shares too little with those before may have come too late (`since`, seconds), or from a camera that
/// turned too fast (`turn`, as a share of the image's width).
fn why(reason: LostReason, since: f64, turn: f64) -> LostReason {
    match reason {
        LostReason::TooFewCorrespondences | LostReason::Degenerate if since > GAP_S => LostReason::TimeGap,
        LostReason::TooFewCorrespondences | LostReason::Degenerate if turn > FAST_TURN => LostReason::MotionTooLarge,
        other => other,
    }
}

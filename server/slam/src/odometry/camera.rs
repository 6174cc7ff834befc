//! Odometry by a camera alone: its map is its own, and its lengths may be in no known unit.

use super::mono::Mono;
use super::params::MotionLimits;
use super::{OdometryEstimate, OdometryKind, OdometryParams};
use crate::keyframe::{KeyframeParams, SweepMotion, keyframe_scan_seen_by};
use crate::motion_prior::MotionPrior;
use crate::scan::{ImageScan, Scan};
use nalgebra::Vector6;
use percept_geometry::{KeyframeScan, Pose, SensorId, Timestamp, se3};
use std::sync::Arc;

/// A camera's map, and how base moves by it.
pub(super) struct CameraOdometry {
    mono: Mono,
    keyframe: KeyframeParams,
    max_gap_s: f64,
    limits: MotionLimits,
    /// Of the newest image: whether it was placed.
    is_tracking: bool,
    last_stamp: Option<Timestamp>,
    t_odom_base: Pose,
    velocity: Option<Vector6<f64>>,
}

impl CameraOdometry {
    pub(super) fn new(params: &OdometryParams) -> Self {
        Self {
            mono: Mono::new(&params.mono, params.tracking.restart_after_frames),
            keyframe: params.keyframe.clone(),
            max_gap_s: params.tracking.max_gap_s,
            limits: MotionLimits::of(OdometryKind::Mono, &params.tracking),
            is_tracking: true,
            last_stamp: None,
            t_odom_base: Pose::identity(),
            velocity: None,
        }
    }

    /// Places an image ([`super::Odometry::register`]). Steps tell a velocity only in metres.
    pub(super) fn register(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) -> OdometryEstimate {
        let estimate = self.mono.track(stamp, scan, prior);
        let dt = self.last_stamp.map_or(0.0, |last| estimate.stamp.seconds_since(last));
        let step = se3::log(&self.t_odom_base.inv_mul(&estimate.t_odom_base));
        let both = estimate.state.is_tracking() && self.is_tracking && estimate.scale.is_metric();
        let near = dt > 1e-4 && dt <= self.max_gap_s;
        self.velocity = (both && near).then(|| step / dt).filter(|v| v.fixed_rows::<3>(0).norm() < self.limits.speed);
        self.is_tracking = estimate.state.is_tracking();
        (self.t_odom_base, self.last_stamp) = (estimate.t_odom_base, Some(estimate.stamp));
        estimate
    }

    pub(super) fn mono(&self) -> &Mono {
        &self.mono
    }

    pub(super) fn take_moved(&mut self) -> Vec<(Timestamp, Pose)> {
        self.mono.take_moved()
    }

    pub(super) fn tell_scale(&mut self, hint: &ImageScan) {
        self.mono.tell_scale(hint);
    }

    pub(super) fn is_tracking(&self) -> bool {
        self.last_stamp.is_some() && self.is_tracking
    }

    pub(super) fn velocity(&self) -> Vector6<f64> {
        self.velocity.unwrap_or_else(Vector6::zeros)
    }

    pub(super) fn t_odom_base(&self) -> &Pose {
        &self.t_odom_base
    }

    pub(super) fn set_keyframe_params(&mut self, params: KeyframeParams) {
        self.keyframe = params;
    }

    /// The points of its map that an image shows, once lengths are metres, and nothing before.
    pub(super) fn keyframe_scan(&self, stamp: Timestamp, sensor: &SensorId, scan: &Scan) -> KeyframeScan {
        let motion = SweepMotion { velocity: Vector6::zeros(), curve: None };
        let mut kept = keyframe_scan_seen_by(&self.keyframe, stamp, sensor, scan, &motion, None);
        if let Scan::Image(image) = scan {
            kept.hits = self.mono.sparse_points(&image.t_base_sensor);
            kept.features = self.mono.features(&image.t_base_sensor).map(Arc::new);
        }
        kept
    }

    pub(super) fn seed(&mut self, t_odom_base_last: &Pose, stamp: Timestamp) {
        self.mono.begin_at(t_odom_base_last);
        (self.t_odom_base, self.last_stamp) = (*t_odom_base_last, Some(stamp));
        (self.velocity, self.is_tracking) = (None, true);
    }
}

//! Which frames stay, and what is kept of them.

use super::{Frontend, Keyframe, View};
use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, SensorKind, Timestamp, se3};
use percept_slam::keyframe::{self, LaterScan};
use percept_slam::{KeyframePolicy, OdometryEstimate, Scan};
use std::sync::Arc;

/// Frames of other sensors this long after the newest pose, or before it, are not placed: the robot may be anywhere, seconds.
const MOST_APART_S: f64 = 0.5;

impl Frontend {
    /// The keyframe that a view of the pose sensor becomes, if it lies far enough from the one before, or is wanted.
    pub(crate) fn keyframe(
        &mut self,
        view: &View,
        estimate: &OdometryEstimate,
        is_wanted: impl FnOnce() -> bool,
    ) -> Option<Keyframe> {
        let t_odom_base = estimate.t_odom_base;
        self.is_keyframe(&view.spec.id, &t_odom_base, is_wanted).then(|| Keyframe {
            kind: view.spec.kind,
            scan: self.kept_of(view),
            t_odom_base,
            covariance: estimate.covariance,
            is_of_pose_sensor: true,
        })
    }

    fn is_keyframe(&mut self, sensor: &SensorId, t_odom_base: &Pose, is_wanted: impl FnOnce() -> bool) -> bool {
        self.policy(sensor).consider(t_odom_base) || {
            let is_wanted = is_wanted();
            if is_wanted {
                self.policy(sensor).resume(t_odom_base);
            }
            is_wanted
        }
    }

    /// The keyframe that a view of a second sensor becomes, if it lies far enough from the one before, or is wanted: where that sensor's
    /// own motion places it, if it is registered, else where the pose sensor says the robot is. The newest pose has this stamp and
    /// covariance.
    pub(crate) fn keyframe_beside(
        &mut self,
        view: &View,
        (newest, covariance): (Timestamp, Covariance6),
        is_wanted: impl FnOnce() -> bool,
    ) -> Option<Keyframe> {
        let t_odom_base = self.place_beside(view, newest)?;
        let (velocity, sensor) = (self.odometry.as_ref()?.velocity(), &view.spec.id);
        if !self.is_keyframe(sensor, &t_odom_base, is_wanted) {
            return None;
        }
        let params = &self.params.odometry.keyframe;
        let as_seen = self.second.keyframe_scan(sensor, view.stamp, &view.scan);
        let led_on = || keyframe::keyframe_scan(params, view.stamp, sensor, &view.scan, &velocity);
        let scan = as_seen.unwrap_or_else(led_on);
        Some(Keyframe { kind: view.spec.kind, scan, t_odom_base, covariance, is_of_pose_sensor: false })
    }

    /// Where base is at a view of a second sensor, base to odom: where that sensor's own motion places it, if it is registered, else
    /// where the pose sensor leads to. The newest pose has this stamp.
    fn place_beside(&self, view: &View, newest: Timestamp) -> Option<Pose> {
        let ahead = view.stamp.seconds_since(newest);
        if matches!(view.scan, Scan::Image(_)) || ahead.abs() > MOST_APART_S {
            return None;
        }
        let odometry = self.odometry.as_ref()?;
        let placed = self.second.place(&view.spec.id, view.stamp);
        Some(placed.unwrap_or_else(|| odometry.t_odom_base() * se3::exp(&(odometry.velocity() * ahead))))
    }

    /// What a view of the pose sensor shows; none of a camera's image.
    pub(crate) fn live(&self, view: &View) -> Option<LaterScan> {
        self.odometry.as_ref()?.ends_later(view.stamp, &view.spec.id, &view.scan)
    }

    /// The same of a second sensor, and base to odom then.
    pub(crate) fn live_beside(&self, view: &View, newest: Timestamp) -> Option<(Pose, LaterScan)> {
        let t_odom_base = self.place_beside(view, newest)?;
        let params = &self.params.odometry.keyframe;
        let velocity = self.odometry.as_ref()?.velocity();
        Some((t_odom_base, keyframe::ends_later(params, view.stamp, &view.spec.id, &view.scan, &velocity)))
    }

    /// What is kept of a view of the pose sensor: odometry knows more of it than the scan says.
    pub(crate) fn kept_of(&self, view: &View) -> KeyframeScan {
        let (stamp, sensor) = (view.stamp, &view.spec.id);
        match &self.odometry {
            Some(odometry) => odometry.keyframe_scan(stamp, sensor, &view.scan),
            None => {
                let params = &self.params.odometry.keyframe;
                keyframe::keyframe_scan(params, stamp, sensor, &view.scan, &Default::default())
            }
        }
    }

    /// Compares what a second sensor sees with what the pose sensor saw around here; `near` are its keyframes around a place in
    /// odom, with their `t_odom_base`.
    pub(crate) fn check_extrinsics(
        &mut self,
        keyframe: &Keyframe,
        near: impl Fn(&SensorId, &Pose) -> Vec<(Pose, Arc<KeyframeScan>)>,
    ) {
        let Some(pose_sensor) = self.sensors.pose_sensor().cloned() else { return };
        let is_camera = self.sensors.spec(&pose_sensor).is_none_or(|s| s.kind == SensorKind::Camera);
        if is_camera || !self.extrinsics.is_due(&keyframe.scan.sensor) {
            return;
        }
        let near = near(&pose_sensor, &keyframe.t_odom_base);
        let from_here = near.into_iter().map(|(t, k)| (keyframe.t_odom_base.inv_mul(&t), k));
        self.extrinsics.measure(&keyframe.scan, &from_here.collect::<Vec<_>>());
    }

    /// The next keyframe of a sensor has to lie away from this one.
    pub(crate) fn go_on_from(&mut self, sensor: &SensorId, t_odom_base: &Pose) {
        self.policy(sensor).resume(t_odom_base);
    }

    /// The next frame of each sensor becomes a keyframe.
    pub(crate) fn forget_keyframes(&mut self) {
        self.keyframe_policies.clear();
    }

    fn policy(&mut self, sensor: &SensorId) -> &mut KeyframePolicy {
        let params = &self.params.odometry.keyframe;
        self.keyframe_policies.entry(sensor.clone()).or_insert_with(|| KeyframePolicy::new(params.clone()))
    }
}

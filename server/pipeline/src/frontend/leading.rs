//! The pose goes by a second sensor where the pose sensor is silent, sees nothing, or leaves an axis open.

use super::second::Led;
use super::{Frontend, View, kind_of};
use percept_geometry::{KeyframeScan, Pose, SensorId, SensorKind, Timestamp};
use percept_slam::{Odometry, OdometryEstimate, OdometryKind, Scale, Scan, TrackingState};
use std::sync::Arc;

/// Frames of a second sensor that stands still are left out for so long at most, seconds.
const AT_LEAST_EVERY_S: f64 = 0.5;

impl Frontend {
    /// Places a view of a second sensor in an odometry of its own, if such are registered; whether it is left out, because the pose
    /// sensor sees well and base has hardly moved since the frame before.
    pub(crate) fn register_second(&mut self, view: &View) -> bool {
        let is_camera = |id: &SensorId| self.sensors.spec(id).is_none_or(|s| s.kind == SensorKind::Camera);
        // A camera's lengths and poses change with its map: there is nothing to be laid over.
        let is_wanted = self.params.second_sensors.enabled && !self.sensors.pose_sensor().is_some_and(is_camera);
        if !is_wanted || matches!(view.scan, Scan::Image(_)) {
            return false;
        }
        if self.is_left_out(view) {
            return true;
        }
        let method = (kind_of(&view.scan), &self.params.odometry);
        let motion = &self.motion;
        let measured = |from, to| motion.prior(from, to, None).motion;
        self.second.register(&view.spec.id, (view.stamp, &view.scan), method, measured);
        false
    }

    fn is_left_out(&self, view: &View) -> bool {
        let params = &self.params.second_sensors;
        let Some(newest) = self.second.newest(&view.spec.id).map(|e| e.stamp) else { return false };
        let is_recent = (0.0..AT_LEAST_EVERY_S).contains(&view.stamp.seconds_since(newest));
        let has_moved = || {
            let moved = self.second.moved(newest, view.stamp);
            moved.is_none_or(|(way, turn)| way >= params.distance_m || turn >= params.angle_rad)
        };
        is_recent && self.second.is_pose_known() && !self.second.is_silent(view.stamp) && !has_moved()
    }

    /// Where base is at a view of a second sensor by that sensor, if it leads: the pose sensor has been silent for longer than it
    /// usually is. Its state is that of the session from then on.
    pub(crate) fn lead(&mut self, view: &View) -> Option<OdometryEstimate> {
        if !self.second.is_silent(view.stamp) || !self.tracking.is_anchored() {
            return None;
        }
        let led =
            self.led(self.pose_kind()?, view.stamp).filter(|led| led.can_stand_in() && led.sensor == view.spec.id)?;
        let estimate = self.led_estimate(view.stamp, &led);
        self.tracking.step(&estimate, true, || false);
        Some(estimate)
    }

    /// Takes up odometry of a sensor that moves the pose from now on, because the one before fell silent: where it has led to
    /// itself, with `recent` keyframes of it and their `t_odom_base`, oldest first. Without, odometry goes on as if it were the sensor
    /// before.
    pub(crate) fn hand_over(&mut self, view: &View, recent: &[(Pose, Arc<KeyframeScan>)]) {
        let (sensor, kind) = (&view.spec.id, kind_of(&view.scan));
        let newest = self.second.newest(sensor).map(|e| e.stamp);
        let led = newest.and_then(|stamp| Some((stamp, self.led(kind, stamp).filter(|l| l.sensor == *sensor)?)));
        self.second.forget(sensor);
        if let Some((stamp, led)) = led.filter(|(_, led)| led.can_stand_in() && !recent.is_empty()) {
            let mut odometry = Odometry::new(kind, self.params.odometry.clone());
            odometry.seed(&led.t_odom_base, recent, stamp);
            self.odometry = Some(odometry);
            self.last_registered = Some(stamp);
            self.comoving.forget_places();
        }
        self.second.pose_jumped();
    }

    /// Where base is by a second sensor, as a pose sensor of this kind takes it.
    pub(super) fn led(&self, kind: OdometryKind, stamp: Timestamp) -> Option<Led> {
        if kind == OdometryKind::Mono {
            return None;
        }
        let led = self.second.lead(stamp)?;
        Some(if kind == OdometryKind::Lidar2d { led.flattened() } else { led })
    }

    /// What is told of a frame of the pose sensor: where that could not be placed, what a second sensor measured, and which. Second
    /// sensors are laid over what the pose sensor makes of it.
    pub(super) fn with_stand_in(
        &mut self,
        own: OdometryEstimate,
        kind: OdometryKind,
        led: Option<Led>,
    ) -> (OdometryEstimate, Option<SensorId>) {
        if kind == OdometryKind::Mono {
            return (own, None);
        }
        let is_anchored = self.tracking.unanchored().is_none();
        let led = led.filter(|led| is_anchored && !own.state.is_tracking() && led.can_stand_in());
        let begins = own.state == TrackingState::Initialising;
        self.second.follow(kind, &own, led.is_some() || !begins);
        match led {
            Some(led) => (self.led_estimate(own.stamp, &led), Some(led.sensor)),
            None => (own, None),
        }
    }

    /// What a second sensor measured in the pose sensor's place.
    fn led_estimate(&self, stamp: Timestamp, led: &Led) -> OdometryEstimate {
        let own = self.second.newest(&led.sensor);
        OdometryEstimate {
            stamp,
            t_odom_base: led.t_odom_base,
            covariance: led.covariance_since_start,
            state: TrackingState::Tracking,
            inlier_ratio: own.map_or(0.0, |e| e.inlier_ratio),
            rmse_m: own.map_or(0.0, |e| e.rmse_m),
            iterations: 0,
            degenerate_axes: [false; 6],
            scale: Scale::Measured,
            waiting: None,
        }
    }

    fn pose_kind(&self) -> Option<OdometryKind> {
        super::resume::odometry_kind(self.sensors.spec(self.sensors.pose_sensor()?)?.kind)
    }
}

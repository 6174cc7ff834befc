//! The front end goes on from what was stored.

use super::restart_check::Restarts;
use super::{Frontend, Tracking, View};
use percept_geometry::{KeyframeScan, Pose, SensorId, SensorKind, Timestamp};
use percept_slam::{Odometry, OdometryEstimate, OdometryKind, ToldPlace};
use std::sync::Arc;

impl Frontend {
    /// The newest stamp of a sensor, its own clock: frames up to it were taken in before.
    pub(crate) fn set_last_stamp(&mut self, sensor: &SensorId, stamp: Timestamp) {
        self.sensors.set_last_stamp(sensor, stamp);
    }

    /// Takes up odometry of a sensor at a pose, with `recent` keyframes and their `t_odom_base`, oldest first, as its local
    /// model; none if the sensor cannot move the pose.
    pub(crate) fn resume(
        &mut self,
        sensor: &SensorId,
        (t_odom_base, stamp): (Pose, Timestamp),
        recent: &[(Pose, Arc<KeyframeScan>)],
    ) -> Option<OdometryKind> {
        let kind = odometry_kind(self.sensors.spec(sensor)?.kind)?;
        let mut odometry = Odometry::new(kind, self.params.odometry.clone());
        odometry.seed(&t_odom_base, recent, stamp);
        self.odometry = Some(odometry);
        self.tracking = Tracking::resumed(t_odom_base, stamp);
        self.last_registered = Some(stamp);
        // A camera's own map is not stored: it begins anew.
        self.is_metric = kind != OdometryKind::Mono;
        self.sensors.set_pose_sensor(sensor.clone());
        Some(kind)
    }

    /// The robot is somewhere in a map that was there before it, or will be: odometry begins anew, and it is lost until it is found.
    pub(crate) fn wait_to_be_found(&mut self) {
        (self.odometry, self.last_registered) = (None, None);
        self.tracking = Tracking::lost_in_given();
    }

    /// Begins at a pose that was told, with what the sensor is to see there as the local model; what the view says of it. If there is
    /// nothing of the kind, the pose is believed; if the view refutes it, nothing is, and the robot is looked for as if nothing had
    /// been told.
    pub(crate) fn start_at(
        &mut self,
        view: &View,
        t_odom_base: &Pose,
        near: &[(Pose, Arc<KeyframeScan>)],
    ) -> Option<ToldPlace> {
        let mut odometry = Odometry::new(view.kind(), self.params.odometry.clone());
        let place = odometry.begin_at(t_odom_base, near, &view.scan, view.stamp);
        if place != Some(ToldPlace::Refuted) {
            self.odometry = Some(odometry);
        }
        if place.is_none() {
            self.tracking = Tracking::Initialising;
        }
        place
    }

    /// Where a view lies around a pose that was told, among what the sensor is to see there; none if it does not. Changes nothing.
    pub(crate) fn look_at(
        &self,
        view: &View,
        t_odom_base: &Pose,
        near: &[(Pose, Arc<KeyframeScan>)],
    ) -> Option<OdometryEstimate> {
        let mut odometry = Odometry::new(view.kind(), self.params.odometry.clone());
        if odometry.begin_at(t_odom_base, near, &view.scan, view.stamp) == Some(ToldPlace::Refuted) {
            return None;
        }
        Some(odometry.register(view.stamp, &view.scan, None)).filter(|placed| placed.state.is_tracking())
    }

    /// Goes on where the robot is told to be, with what the sensor has seen there as the local model, or with this view if it has seen
    /// nothing. Odom stays where it is.
    pub(crate) fn go_on_at(&mut self, view: &View, estimate: &OdometryEstimate, near: &[(Pose, Arc<KeyframeScan>)]) {
        let mut odometry = Odometry::new(view.kind(), self.params.odometry.clone());
        odometry.seed(&estimate.t_odom_base, near, estimate.stamp);
        if near.is_empty() {
            odometry.register(estimate.stamp, &view.scan, None);
        }
        self.odometry = Some(odometry);
        self.restarts = Restarts::default();
        self.comoving.forget_places();
        self.second.pose_jumped();
        self.tracking = Tracking::resumed(estimate.t_odom_base, estimate.stamp);
    }
}

/// The method for a kind of sensor; none for kinds that cannot carry the pose.
pub(super) fn odometry_kind(kind: SensorKind) -> Option<OdometryKind> {
    match kind {
        SensorKind::Depth | SensorKind::Rgbd => Some(OdometryKind::Rgbd),
        SensorKind::Lidar3d => Some(OdometryKind::Lidar3d),
        SensorKind::Lidar2d => Some(OdometryKind::Lidar2d),
        SensorKind::Camera => Some(OdometryKind::Mono),
        SensorKind::Imu | SensorKind::Odometry => None,
    }
}

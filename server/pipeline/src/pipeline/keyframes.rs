//! Frames that stay: they enter the map, and the trajectory hangs on them.

use super::{FrameReport, NewKeyframe, Pipeline};
use crate::map_graph::level::level;
use crate::{KeyframeInfo, TrajectoryEntry};
use percept_geometry::{KeyframeId, KeyframeScan, Pose, SensorId, SensorKind, SensorSpec, Timestamp, se3};
use percept_mapping::MapEntry;
use percept_scene::ObjectChange;
use percept_slam::{KeyframePolicy, Odometry, Scan, keyframe};
use std::sync::Arc;

impl Pipeline {
    /// A frame of another sensor: seen from where the pose sensor says the robot is, it adds to the map.
    pub(super) fn map_only(&mut self, spec: &SensorSpec, stamp: Timestamp, scan: &Scan) -> Option<FrameReport> {
        let pose = self.pose.as_ref().filter(|p| !p.state.is_lost() && p.scale.is_metric())?;
        if matches!(scan, Scan::Image(_)) {
            return None;
        }
        // Too long after the last pose the robot may be anywhere.
        let ahead = stamp.seconds_since(pose.stamp);
        if ahead.abs() > 0.5 {
            return None;
        }
        let odometry = self.odometry.as_ref()?;
        let t_odom_base = odometry.t_odom_base() * se3::exp(&(odometry.velocity() * ahead));
        if !self.policy(&spec.id).consider(&t_odom_base) {
            return None;
        }
        let mut report = FrameReport::default();
        let kept = self.kept_of(spec, stamp, scan, false);
        self.check_extrinsics(&kept, &t_odom_base);
        let mut keyframe = self.add_keyframe(spec, kept, t_odom_base);
        self.close_loops(&mut keyframe, false, None);
        report.changes = self.observe(spec, &keyframe);
        report.keyframe = Some(keyframe);
        Some(report)
    }

    /// Looks for objects in the map around a new keyframe.
    pub(super) fn observe(&mut self, spec: &SensorSpec, keyframe: &NewKeyframe) -> Vec<ObjectChange> {
        self.scene.observe(&self.map.layers(), keyframe, spec.kind == SensorKind::Camera)
    }

    /// Compares what a second sensor sees with what the pose sensor saw around here.
    fn check_extrinsics(&mut self, scan: &KeyframeScan, t_odom_base: &Pose) {
        let Some(pose_sensor) = self.sensors.pose_sensor().cloned() else { return };
        let is_camera = self.sensors.spec(&pose_sensor).is_none_or(|s| s.kind == SensorKind::Camera);
        if is_camera || !self.extrinsics.is_due(&scan.sensor) {
            return;
        }
        let near = self.keyframes_near(&pose_sensor, t_odom_base);
        let from_here = near.into_iter().map(|(t, k)| (t_odom_base.inv_mul(&t), k));
        self.extrinsics.measure(scan, &from_here.collect::<Vec<_>>());
    }

    pub(super) fn policy(&mut self, sensor: &SensorId) -> &mut KeyframePolicy {
        let params = &self.params.slam.odometry.keyframe;
        self.keyframe_policies.entry(sensor.clone()).or_insert_with(|| KeyframePolicy::new(params.clone()))
    }

    /// What a keyframe keeps; of the pose sensor's odometry knows more than the scan says.
    pub(super) fn kept_of(
        &self,
        spec: &SensorSpec,
        stamp: Timestamp,
        scan: &Scan,
        is_pose_sensor: bool,
    ) -> KeyframeScan {
        let odometry = self.odometry.as_ref();
        if let Some(odometry) = odometry.filter(|_| is_pose_sensor) {
            return odometry.keyframe_scan(stamp, &spec.id, scan);
        }
        let velocity = odometry.map(Odometry::velocity).unwrap_or_default();
        keyframe::keyframe_scan(&self.params.slam.odometry.keyframe, stamp, &spec.id, scan, &velocity)
    }

    pub(super) fn add_keyframe(&mut self, spec: &SensorSpec, mut scan: KeyframeScan, t_odom_base: Pose) -> NewKeyframe {
        let stamp = scan.stamp;
        // A camera's few points show no floor to be trusted, and its map begins before lengths are metres: it was levelled
        // then, where an IMU was at rest.
        if self.keyframes.is_empty() && spec.kind != SensorKind::Camera {
            let level = level(&scan, self.up(stamp));
            self.t_map_odom = level.t_map_base * t_odom_base.inverse();
            self.base_height_m = level.base_height_m;
        }
        scan.base_height_m = self.base_height_m;
        self.enter(stamp, &spec.id, t_odom_base, Arc::new(scan))
    }

    /// Puts a keyframe into the map where odometry says.
    pub(super) fn enter(
        &mut self,
        stamp: Timestamp,
        sensor: &SensorId,
        t_odom_base: Pose,
        scan: Arc<KeyframeScan>,
    ) -> NewKeyframe {
        let id = KeyframeId(self.keyframes.len() as u64);
        let t_map_base = self.t_map_odom * t_odom_base;
        self.insert(id, &MapEntry { t_map_base, t_odom_base, after_gap: self.after_gap }, &scan);
        self.newest_keyframe_t_odom_base = t_odom_base;
        let num_points = scan.hits.len();
        let info =
            KeyframeInfo { id, stamp, sensor: sensor.clone(), t_map_base, t_odom_base, num_points, merged: None };
        Arc::make_mut(&mut self.keyframes).push(info.clone());
        NewKeyframe { info, t_odom_base, after_gap: false, scan }
    }

    /// Adds a keyframe to the map layers. Poses and scans are our own: a refusal is a fault of ours.
    pub(super) fn insert(&mut self, id: KeyframeId, entry: &MapEntry, scan: &Arc<KeyframeScan>) {
        if let Err(error) = self.map.insert(id, entry, Arc::clone(scan)) {
            debug_assert!(false, "{error}");
        }
    }

    pub(super) fn extend_trajectory(
        &mut self,
        spec: &SensorSpec,
        stamp: Timestamp,
        tracked: bool,
        t_map_base: &Pose,
        keyframe: Option<&NewKeyframe>,
    ) -> Option<TrajectoryEntry> {
        let anchor = match keyframe {
            Some(k) => k.info.clone(),
            None => self.newest_anchor(&spec.id)?.clone(),
        };
        let entry = TrajectoryEntry {
            stamp,
            tracked,
            anchor: Some(anchor.id),
            t_anchor_base: anchor.t_map_base.inverse() * t_map_base,
            is_keyframe: keyframe.is_some(),
        };
        self.trajectory.push(entry);
        Some(entry)
    }

    /// The newest keyframe of the sensor that moves the pose.
    fn newest_anchor(&self, sensor: &SensorId) -> Option<&KeyframeInfo> {
        self.keyframes.iter().rev().find(|k| k.sensor == *sensor)
    }
}

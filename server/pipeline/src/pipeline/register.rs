//! A frame moves the pose: odometry places it, and what is known of the map says whether that is to be believed.

use super::atlas::tie_over_join;
use super::{FrameReport, Pipeline};
use crate::frontend::imu_prior::joined;
use crate::map_graph::level::by_gravity;
use crate::{Chunks, KeyframeInfo, PoseEstimate, TrajectoryEntry};
use percept_geometry::{KeyframeId, KeyframeScan, Pose, SensorId, SensorSpec, Timestamp};
use percept_mapping::MapKeyframe;
use percept_slam::{LostReason, Odometry, OdometryEstimate, OdometryKind, Scan, TrackingState};
use std::sync::Arc;

/// A keyframe this near says that the robot has been there, metres.
const MAPPED_M: f64 = 1.0;

/// Keyframes that odometry starts again from.
const NUM_RECENT: usize = 20;

impl Pipeline {
    /// Whether the newest pose is in metres.
    pub(super) fn is_metric(&self) -> bool {
        self.pose.as_ref().is_some_and(|p| p.scale.is_metric())
    }

    /// A frame of another sensor tells a camera its scale, perhaps.
    pub(super) fn tell_scale(&mut self, stamp: Timestamp, scan: &Scan) {
        if self.is_metric() {
            self.scale_hints.clear();
        } else if let (Some(hint), Some(odometry)) = (self.scale_hints.see_other(stamp, scan), &mut self.odometry) {
            odometry.tell_scale(&hint);
        }
    }

    /// A frame that moves the pose.
    pub(super) fn register(&mut self, spec: &SensorSpec, stamp: Timestamp, scan: &Scan) -> FrameReport {
        let since = self.last_registered;
        let wheels = since.and_then(|last| self.wheels.values().find_map(|w| w.between(last, stamp)));
        // Of several IMUs the first by name that covers the stretch.
        let felt = since.and_then(|last| self.imus.values().find_map(|i| Some((i, i.between(last, stamp)?))));
        let imu = felt.as_ref().map(|f| f.0).or_else(|| self.imus.values().next());
        let prior = joined(wheels.clone(), felt.as_ref().map(|f| f.1.clone()));
        let kind = match scan {
            Scan::Depth(_) => OdometryKind::Rgbd,
            Scan::Cloud(_) => OdometryKind::Lidar3d,
            Scan::Planar(_) => OdometryKind::Lidar2d,
            Scan::Image(_) => OdometryKind::Mono,
        };
        let odometry = self.odometry.get_or_insert_with(|| Odometry::new(kind, self.params.slam.odometry.clone()));
        let (t_odom_last, was_tracking) = (*odometry.t_odom_base(), odometry.is_tracking());
        let mut estimate = odometry.register_with_imu(stamp, scan, prior.as_ref(), imu);
        let moved = odometry.take_moved();
        if let Some(last) = since.filter(|_| was_tracking && estimate.state.is_tracking()) {
            let turn = t_odom_last.rotation.inverse() * estimate.t_odom_base.rotation;
            self.imus.values_mut().for_each(|i| i.learn(last, stamp, &turn));
            if self.clocks.turned(last, stamp, turn.angle()) {
                self.clock_offsets = Arc::new(self.clocks.found().clone());
            }
        }
        self.last_registered = Some(stamp);
        self.prepare_graph(kind);
        if !moved.is_empty() {
            self.move_unanchored(&moved);
        }
        if !estimate.scale.is_metric() {
            return self.answer_without_scale(stamp, &estimate, wheels.is_some());
        }
        let mut report = FrameReport::default();
        let mut anchoring = std::mem::take(&mut self.anchoring);
        let is_mapped = || self.is_mapped(&spec.id, &estimate.t_odom_base);
        let mut tracked = anchoring.judge(&estimate, wheels.as_ref(), is_mapped);
        self.anchoring = anchoring;
        if self.anchoring.is_adrift() {
            (estimate, tracked) = self.recover(kind, spec, scan, estimate, &mut report);
        }
        let t_odom_base = estimate.t_odom_base;
        let before_join = if tracked { self.join_waiting(&mut report) } else { None };
        if tracked && self.policy(&spec.id).consider(&t_odom_base) {
            let kept = self.kept_of(spec, stamp, scan, true);
            let mut keyframe = self.add_keyframe(spec, kept, t_odom_base);
            let tied = before_join.map(|before| tie_over_join(&before, &keyframe.info));
            self.close_loops(&mut keyframe, true, tied);
            report.changes = self.observe(spec, &keyframe);
            report.keyframe = Some(keyframe);
        }
        let pose = self.pose_of(stamp, &estimate);
        self.pose = Some(pose.clone());
        report.trajectory = self.extend_trajectory(spec, stamp, tracked, &pose.t_map_base, report.keyframe.as_ref());
        report.pose = Some(pose);
        if tracked {
            self.look_for_parts(stamp, &spec.id, report.keyframe.is_some());
        }
        report
    }

    /// A frame whose pose is in no known unit: it is answered and said so, and no map is built from it.
    fn answer_without_scale(&mut self, stamp: Timestamp, estimate: &OdometryEstimate, has_wheels: bool) -> FrameReport {
        self.anchoring.judge_without_scale(estimate, has_wheels);
        // The camera's map has begun anew: what was gathered in the one before hangs on nothing any more.
        drop(self.floating.begin_anew());
        // Before anything hangs on it the map is turned upright.
        if self.trajectory.is_empty()
            && self.keyframes.is_empty()
            && let Some(up) = self.up(stamp)
        {
            self.t_map_odom = by_gravity(up).t_map_base * estimate.t_odom_base.inverse();
        }
        let mut pose = self.pose_of(stamp, estimate);
        if self.anchoring.is_adrift() && pose.state.is_tracking() {
            pose.state = TrackingState::Lost { reason: LostReason::Adrift };
            pose.is_relocalised = false;
        }
        self.pose = Some(pose.clone());
        let tracked = pose.state.is_tracking();
        // Before the first pose that was measured there is no trajectory.
        let entry = (tracked || !self.trajectory.is_empty()).then_some(TrajectoryEntry {
            stamp,
            tracked,
            anchor: None,
            t_anchor_base: pose.t_map_base,
            is_keyframe: false,
        });
        entry.iter().for_each(|e| self.trajectory.push(*e));
        FrameReport { pose: Some(pose), trajectory: entry, ..FrameReport::default() }
    }

    /// Poses in a unit of their own hang on no keyframe: they follow the camera's own map when that closes a loop. Where they
    /// are stored they stay as they were said.
    fn move_unanchored(&mut self, moved: &[(Timestamp, Pose)]) {
        let (Some(first), t_map_odom) = (moved.first(), self.t_map_odom) else { return };
        let nearest = |stamp: Timestamp| {
            let after = moved.partition_point(|m| m.0 < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| moved.get(i));
            around.min_by_key(|m| m.0.nanos().abs_diff(stamp.nanos())).map(|m| m.1)
        };
        let mut trajectory = Chunks::default();
        for entry in self.trajectory.iter() {
            let mut entry = *entry;
            if let Some(t_new_old) = nearest(entry.stamp).filter(|_| entry.anchor.is_none() && entry.stamp >= first.0) {
                entry.t_anchor_base = t_map_odom * t_new_old * t_map_odom.inverse() * entry.t_anchor_base;
            }
            trajectory.push(entry);
        }
        self.trajectory = trajectory;
    }

    /// Whether a sensor has been where odometry is now: a keyframe of its is near.
    fn is_mapped(&self, sensor: &SensorId, t_odom_base: &Pose) -> bool {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let near = |k: &KeyframeInfo| {
            k.merged.is_none() && k.sensor == *sensor && (k.t_map_base.translation.vector - here).norm() < MAPPED_M
        };
        self.keyframes.iter().any(near)
    }

    /// Odometry runs on from a guess: back into the map if the frame is found there, else lost and said so. Where places
    /// can be recognised the whole map is looked through; else only the place where the robot was last known to be is
    /// tried: elsewhere rooms that resemble it would do as well.
    fn recover(
        &mut self,
        kind: OdometryKind,
        spec: &SensorSpec,
        scan: &Scan,
        estimate: OdometryEstimate,
        report: &mut FrameReport,
    ) -> (OdometryEstimate, bool) {
        if self.graph.is_some() {
            if self.look_around(kind, spec, scan, &estimate, report) {
                return (OdometryEstimate { state: TrackingState::Tracking, ..estimate }, true);
            }
        } else {
            let params = Arc::clone(&self.params);
            let mut anchoring = std::mem::take(&mut self.anchoring);
            let method = (kind, &params.slam.odometry);
            let near = |t_odom_base: &Pose| self.keyframes_near(&spec.id, t_odom_base);
            let found = anchoring.recover(method, &estimate, near, scan);
            self.anchoring = anchoring;
            if let Some((odometry, estimate)) = found {
                self.odometry = Some(odometry);
                return (estimate, true);
            }
        }
        // What odometry itself lacks says more.
        let state = match estimate.state {
            lost @ TrackingState::Lost { .. } => lost,
            _ => TrackingState::Lost { reason: LostReason::Adrift },
        };
        (OdometryEstimate { state, ..estimate }, false)
    }

    /// Keyframes of a sensor around a place, with their odom poses, oldest first.
    pub(super) fn keyframes_near(&self, sensor: &SensorId, t_odom_base: &Pose) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let of_sensor = self.map.keyframes().iter().filter(|(_, k)| k.sensor == *sensor);
        let mut by_distance: Vec<_> =
            of_sensor.map(|(id, k)| ((k.t_map_base.translation.vector - here).norm(), *id, k)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        by_distance.truncate(NUM_RECENT);
        by_distance.sort_by_key(|(_, id, _)| *id);
        let t_odom_map = self.t_map_odom.inverse();
        let seen = |(_, id, k): (f64, KeyframeId, &MapKeyframe)| Some((t_odom_map * k.t_map_base, self.map.scan(id)?));
        by_distance.into_iter().filter_map(seen).collect()
    }

    /// The newest keyframes of a sensor with their odom poses, oldest first: what odometry starts again from.
    pub(super) fn recent_keyframes(&self, sensor: &SensorId) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let t_odom_map = self.t_map_odom.inverse();
        let of_sensor = self.map.keyframes().iter().filter(|(_, k)| k.sensor == *sensor);
        let seen = |(id, k): (&KeyframeId, &MapKeyframe)| Some((t_odom_map * k.t_map_base, self.map.scan(*id)?));
        let newest = of_sensor.rev().take(NUM_RECENT).filter_map(seen);
        let mut recent: Vec<_> = newest.collect();
        recent.reverse();
        recent
    }

    fn pose_of(&self, stamp: Timestamp, estimate: &OdometryEstimate) -> PoseEstimate {
        let was_lost = self.pose.as_ref().is_some_and(|p| p.state.is_lost());
        PoseEstimate {
            stamp,
            state: estimate.state,
            t_map_base: self.t_map_odom * estimate.t_odom_base,
            t_odom_base: estimate.t_odom_base,
            covariance: estimate.covariance,
            inlier_ratio: estimate.inlier_ratio,
            rmse_m: estimate.rmse_m,
            degenerate_axes: estimate.degenerate_axes,
            scale: estimate.scale,
            waiting: estimate.waiting,
            is_relocalised: was_lost && estimate.state.is_tracking(),
            map_version: self.map.version(),
        }
    }
}

//! A map that was given before the robot came: views of it are the first keyframes.
//!
//! Until the robot is found in it, or is told to be, nothing anchors the robot: it never takes the place of what was given.

use super::MapGraph;
use crate::{KeyframeInfo, NewKeyframe};
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, SensorId};
use percept_mapping::given::{GivenView, is_given, is_recognised};
use percept_slam::{BackEndKeyframe, OdometryKind};
use std::sync::Arc;

/// Views this near a place are what odometry starts from there, metres: what a robot's newest keyframes reach.
const NEAR_M: f64 = 4.0;

impl MapGraph {
    /// Whether the map was given before the robot came.
    pub(crate) fn is_given(&self) -> bool {
        self.keyframes.iter().next().is_some_and(|k| is_given(&k.sensor))
    }

    /// Puts views of a map that was given into the empty map, whose frame is theirs. What a robot has seen before is forgotten.
    pub(crate) fn take_given(&mut self, views: Vec<GivenView>) -> Vec<NewKeyframe> {
        self.relocaliser.begin_anew();
        let enter = |view: GivenView| {
            let (stamp, sensor) = (view.scan.stamp, view.scan.sensor.clone());
            self.insert(stamp, &sensor, view.t_map_base, Arc::new(view.scan), false)
        };
        views.into_iter().map(enter).collect()
    }

    /// Makes the back end over keyframes that came before the first frame of the sensor that moves the pose.
    pub(crate) fn prepare_over_given(&mut self, kind: OdometryKind, sensor: &SensorId) {
        self.prepare(kind);
        let is_known = self.constraints.at_rest().is_none_or(|back_end| !back_end.poses().is_empty());
        if is_known || self.keyframes.is_empty() {
            return;
        }
        let node = |info: &KeyframeInfo| {
            let scan = self.map.kept_scan(info.id)?.clone();
            Some(BackEndKeyframe {
                id: info.id,
                t_map_base: info.t_map_base,
                t_odom_base: info.t_odom_base,
                covariance: Covariance6::zeros(),
                recognise: info.sensor == *sensor || is_seen_alike(kind, &info.sensor, &*scan.get()?),
                scan,
                after_gap: false,
                constraint: None,
            })
        };
        let nodes: Vec<BackEndKeyframe> =
            self.keyframes.iter().filter(|k| k.merged.is_none()).filter_map(node).collect();
        let loops = self.constraints.loops();
        if let Some(back_end) = self.constraints.at_rest() {
            back_end.resume(nodes.into_iter(), loops.to_vec(), 0);
        }
    }

    /// What a sensor of a kind sees of a given map around a place, with odom poses: odometry starts from it there.
    pub(crate) fn given_near(&self, kind: OdometryKind, t_odom_base: &Pose) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let of = |(id, k): (&KeyframeId, &percept_mapping::MapKeyframe)| {
            let is_near = (k.t_map_base.translation.vector - here).norm() < NEAR_M;
            let scan = if is_near && is_given(&k.sensor) { self.map.scan(*id)? } else { return None };
            is_seen_alike(kind, &k.sensor, &scan).then(|| (self.t_map_odom.inverse() * k.t_map_base, scan))
        };
        self.map.keyframes().iter().filter_map(of).collect()
    }

    /// What a sensor has seen around a place, or would see of a given map there, with odom poses.
    pub(crate) fn seen_near(
        &self,
        kind: OdometryKind,
        sensor: &SensorId,
        t_odom_base: &Pose,
    ) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let is_near = |(t, _): &(Pose, _)| (t.translation.vector - t_odom_base.translation.vector).norm() < NEAR_M;
        let own = self.keyframes_near(sensor, t_odom_base).into_iter().filter(is_near);
        self.given_near(kind, t_odom_base).into_iter().chain(own).collect()
    }

    /// Base is so high above the ground, as the view of a given map tells in which it was found.
    pub(super) fn learn_height(&mut self, found: KeyframeId, t_keyframe_base: &Pose) {
        let is_upright_view = |scan: &Arc<KeyframeScan>| is_given(&scan.sensor) && !scan.planar;
        if self.map.scan(found).as_ref().is_some_and(is_upright_view) {
            self.base_height_m = t_keyframe_base.translation.vector.z.max(0.0);
        }
    }
}

/// Whether a view of a given map shows what a sensor of this kind would see.
pub(super) fn is_seen_alike(kind: OdometryKind, sensor: &SensorId, scan: &KeyframeScan) -> bool {
    let is_alike = match kind {
        OdometryKind::Lidar2d => scan.planar,
        OdometryKind::Lidar3d => !scan.planar,
        OdometryKind::Rgbd | OdometryKind::Mono => false,
    };
    is_recognised(sensor) && is_alike
}

//! Keyframes enter: the map layers, and the back end.

use super::level::{by_gravity, level};
use super::worker::Question;
use super::{MapGraph, NewKeyframe};
use crate::KeyframeInfo;
use crate::frontend::Keyframe;
use nalgebra::{Unit, Vector3};
use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, SensorKind, Timestamp};
use percept_mapping::MapEntry;
use percept_slam::loops::LoopClosure;
use percept_slam::{BackEndKeyframe, OdometryNoise, way_m};
use std::sync::Arc;

/// How a keyframe hangs on others.
#[derive(Debug, Clone, Default)]
pub(super) struct Link {
    /// Whether nothing measured ties it to the keyframe before.
    pub(super) after_gap: bool,
    /// How it is known to lie to another one.
    pub(super) constraint: Option<LoopClosure>,
}

impl MapGraph {
    /// Puts a keyframe into the map where odometry says; what the back end makes of it comes with a later frame. `up` is the
    /// direction against gravity in base, if it was measured, and `before_joined` the robot's keyframe before, if a part has
    /// joined since.
    pub(crate) fn add(
        &mut self,
        keyframe: Keyframe,
        up: impl FnOnce() -> Option<Unit<Vector3<f64>>>,
        before_joined: Option<&KeyframeInfo>,
    ) -> NewKeyframe {
        let Keyframe { kind, mut scan, t_odom_base, covariance, is_of_pose_sensor } = keyframe;
        // A camera's few points show no floor to be trusted, and its map begins before lengths are metres: it was levelled
        // then, where an IMU was at rest.
        if self.keyframes.is_empty() && kind != SensorKind::Camera {
            let level = level(&scan, up());
            self.t_map_odom = level.t_map_base * t_odom_base.inverse();
            self.base_height_m = level.base_height_m;
        }
        scan.base_height_m = self.base_height_m;
        let (stamp, sensor) = (scan.stamp, scan.sensor.clone());
        let mut new = self.insert(stamp, &sensor, t_odom_base, Arc::new(scan), before_joined.is_some());
        let noise = self.constraints.noise();
        let constraint = before_joined.zip(noise).map(|(before, noise)| over_joined(before, &new.info, noise));
        let link = Link { after_gap: before_joined.is_some(), constraint };
        self.constrain(&mut new, covariance, is_of_pose_sensor, link);
        new
    }

    /// Takes out of a scan what ends where the map says that nothing stands.
    pub(crate) fn leave_out_news(&self, scan: &mut KeyframeScan, t_odom_base: &Pose) {
        scan.base_height_m = self.base_height_m;
        let is_news = self.map.layers().occupancy.is_news(&(self.t_map_odom * t_odom_base), scan);
        let stays: Vec<usize> = (0..is_news.len()).filter(|i| !is_news[*i]).collect();
        if stays.len() < is_news.len() {
            scan.hits = scan.hits.select(&stays);
        }
    }

    /// A camera's lengths are in a unit of its own: nothing can enter, and what was gathered in the camera's map before hangs on
    /// nothing any more. Before anything hangs on the map it is turned upright, if `up` was measured.
    pub(crate) fn wait_for_scale(&mut self, up: impl FnOnce() -> Option<Unit<Vector3<f64>>>, t_odom_base: &Pose) {
        drop(self.relocaliser.begin_anew());
        if self.trajectory.is_empty()
            && self.keyframes.is_empty()
            && let Some(up) = up()
        {
            self.t_map_odom = by_gravity(up).t_map_base * t_odom_base.inverse();
        }
    }

    /// Puts a keyframe into keyframes and layers where odometry says.
    pub(super) fn insert(
        &mut self,
        stamp: Timestamp,
        sensor: &SensorId,
        t_odom_base: Pose,
        scan: Arc<KeyframeScan>,
        after_gap: bool,
    ) -> NewKeyframe {
        let t_map_base = self.t_map_odom * t_odom_base;
        let info = KeyframeInfo {
            id: self.keyframes.next_id(),
            stamp,
            sensor: sensor.clone(),
            t_map_base,
            t_odom_base,
            num_points: scan.hits.len(),
            merged: None,
        };
        self.fill_layers(&info, after_gap, &scan);
        self.keyframes.push(info.clone());
        NewKeyframe { info, t_odom_base, after_gap: false, scan }
    }

    /// Adds a keyframe to the map layers. Poses and scans are our own: a refusal is a fault of ours.
    pub(super) fn fill_layers(&mut self, info: &KeyframeInfo, after_gap: bool, scan: &Arc<KeyframeScan>) {
        let entry = MapEntry { t_map_base: info.t_map_base, t_odom_base: info.t_odom_base, after_gap };
        if let Err(error) = self.map.insert(info.id, &entry, Arc::clone(scan)) {
            debug_assert!(false, "{error}");
        }
    }

    /// Hands a keyframe that is in the map to the back end. `covariance` is odometry's at its time; `recognise`: whether loops
    /// are looked for from it.
    pub(super) fn constrain(
        &mut self,
        keyframe: &mut NewKeyframe,
        covariance: Covariance6,
        recognise: bool,
        link: Link,
    ) {
        if !self.constraints.is_active() {
            return;
        }
        keyframe.after_gap = link.after_gap;
        let node = BackEndKeyframe {
            id: keyframe.info.id,
            t_map_base: keyframe.info.t_map_base,
            t_odom_base: keyframe.t_odom_base,
            covariance,
            scan: self.map.kept_scan(keyframe.info.id).cloned().unwrap_or_else(|| (&keyframe.scan).into()),
            recognise,
            after_gap: link.after_gap,
            constraint: link.constraint,
        };
        self.constraints.ask(Question::Keyframe(node), keyframe.info.stamp);
    }
}

/// The constraint between the robot's keyframe and the one before, where a part has joined in between.
fn over_joined(before: &KeyframeInfo, now: &KeyframeInfo, noise: &OdometryNoise) -> LoopClosure {
    let t_before_now = before.t_odom_base.inv_mul(&now.t_odom_base);
    let (t, r) = noise.after(way_m(t_before_now.translation.vector.norm(), t_before_now.rotation.angle()));
    LoopClosure {
        from: before.id,
        to: now.id,
        t_from_to: t_before_now,
        covariance: Covariance6::from_diagonal(&[t, t, t, r, r, r].map(|sigma| sigma * sigma).into()),
        inlier_ratio: 1.0,
    }
}

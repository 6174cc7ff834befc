//! A session goes on from what was stored of it.

use super::{Pipeline, merging};
use crate::recovery::Anchoring;
use crate::{KeyframeInfo, Merged, PoseEstimate, TrajectoryEntry};
use percept_geometry::{KeyframeId, KeyframeScan, Pose, SensorId, SensorKind, Timestamp};
use percept_mapping::MapEntry;
use percept_scene::Object;
use percept_slam::{Loop, Odometry, OdometryKind, Scale, TrackingState};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A keyframe as it was stored.
#[derive(Debug, Clone)]
pub struct RestoredKeyframe {
    /// Base to map, corrected.
    pub t_map_base: Pose,
    /// Base to odom at the keyframe.
    pub t_odom_base: Pose,
    /// Whether nothing measured ties it to the keyframe before.
    pub after_gap: bool,
    /// What it saw, or what stands for it.
    pub content: RestoredContent,
}

/// What is left of a stored keyframe.
#[derive(Debug, Clone)]
pub enum RestoredContent {
    /// All.
    Scan(Arc<KeyframeScan>),
    /// Where it was, and when.
    Merged {
        /// Stamp, session's clock.
        stamp: Timestamp,
        /// Sensor.
        sensor: SensorId,
        /// What stands for it.
        merged: Merged,
    },
}

impl RestoredKeyframe {
    pub(super) fn scan(&self) -> Option<&Arc<KeyframeScan>> {
        match &self.content {
            RestoredContent::Scan(scan) => Some(scan),
            RestoredContent::Merged { .. } => None,
        }
    }

    pub(super) fn sensor(&self) -> &SensorId {
        match &self.content {
            RestoredContent::Scan(scan) => &scan.sensor,
            RestoredContent::Merged { sensor, .. } => sensor,
        }
    }
}

/// A session as it was stored.
#[derive(Debug, Clone, Default)]
pub struct Restored {
    /// Keyframes from number 0 on.
    pub keyframes: Vec<RestoredKeyframe>,
    /// Registered frames, oldest first.
    pub trajectory: Vec<TrajectoryEntry>,
    /// Loops, in the order of finding.
    pub loops: Vec<Loop>,
    /// Number that the next loop gets.
    pub next_loop_id: u64,
    /// Objects, those gone included.
    pub objects: Vec<Object>,
    /// Number that the next object gets.
    pub next_object_id: u64,
    /// Newest accepted stamp of each sensor, its own clock.
    pub last_stamps: BTreeMap<SensorId, Timestamp>,
}

impl Pipeline {
    /// Brings back what was stored; sensors must be declared before.
    pub fn restore(&mut self, restored: Restored) {
        for (id, stamp) in &restored.last_stamps {
            self.sensors.set_last_stamp(id, *stamp);
        }
        let mut infos = Vec::with_capacity(restored.keyframes.len());
        for (i, k) in restored.keyframes.iter().enumerate() {
            let (id, sensor) = (KeyframeId(i as u64), k.sensor().clone());
            let (t_map_base, t_odom_base) = (k.t_map_base, k.t_odom_base);
            let entry = MapEntry { t_map_base, t_odom_base, after_gap: k.after_gap };
            self.policy(&sensor).resume(&k.t_odom_base);
            infos.push(match &k.content {
                RestoredContent::Scan(scan) => {
                    self.insert(id, &entry, scan);
                    self.base_height_m = scan.base_height_m;
                    let (stamp, num_points) = (scan.stamp, scan.hits.len());
                    KeyframeInfo { id, stamp, sensor, t_map_base, t_odom_base, num_points, merged: None }
                }
                RestoredContent::Merged { stamp, merged, .. } => {
                    self.map.skip(&entry);
                    let (stamp, merged) = (*stamp, Some(*merged));
                    KeyframeInfo { id, stamp, sensor, t_map_base, t_odom_base, num_points: 0, merged }
                }
            });
        }
        merging::carry(&mut infos);
        self.keyframes = Arc::new(infos);
        restored.trajectory.iter().for_each(|e| self.trajectory.push(*e));
        self.scene.restore(&self.params, &restored.objects, restored.next_object_id);
        self.restore_odometry(&restored);
    }

    /// Takes up odometry where the trajectory ends, with the last keyframes as the local model.
    fn restore_odometry(&mut self, restored: &Restored) {
        // Frames that were not tracked have guessed poses.
        let anchored = |e: &TrajectoryEntry| Some((*e, e.anchor.filter(|_| e.tracked)?));
        let entry = restored.trajectory.iter().rev().find_map(anchored);
        let (Some(newest), Some((entry, anchor))) = (restored.keyframes.last(), entry) else { return };
        self.newest_keyframe_t_odom_base = newest.t_odom_base;
        self.t_map_odom = newest.t_map_base * newest.t_odom_base.inverse();
        let Some(anchor) = restored.keyframes.get(anchor.0 as usize) else { return };
        // The trajectory hangs on keyframes of the sensor that moves the pose.
        let sensor = anchor.sensor().clone();
        let t_odom_base = anchor.t_odom_base * entry.t_anchor_base;
        let recent = self.recent_keyframes(&sensor);
        let Some(spec) = self.sensors.spec(&sensor).cloned() else { return };
        let Some(kind) = odometry_kind(spec.kind) else { return };
        let mut odometry = Odometry::new(kind, self.params.slam.odometry.clone());
        odometry.seed(&t_odom_base, &recent, entry.stamp);
        self.odometry = Some(odometry);
        self.anchoring = Anchoring::at(t_odom_base, entry.stamp);
        self.last_registered = Some(entry.stamp);
        self.restore_back_end(kind, &sensor, restored);
        self.sensors.set_pose_sensor(sensor);
        self.pose = Some(PoseEstimate {
            stamp: entry.stamp,
            state: TrackingState::Initialising,
            t_map_base: anchor.t_map_base * entry.t_anchor_base,
            t_odom_base,
            covariance: percept_geometry::Covariance6::identity() * 1e-2,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            degenerate_axes: [false; 6],
            // A camera's own map is not stored: it begins anew.
            scale: if kind == OdometryKind::Mono { Scale::Unknown } else { Scale::Measured },
            waiting: None,
            is_relocalised: false,
            map_version: self.map.version(),
        });
    }
}

/// The method for a kind of sensor; none for kinds that cannot carry the pose.
fn odometry_kind(kind: SensorKind) -> Option<OdometryKind> {
    match kind {
        SensorKind::Depth | SensorKind::Rgbd => Some(OdometryKind::Rgbd),
        SensorKind::Lidar3d => Some(OdometryKind::Lidar3d),
        SensorKind::Lidar2d => Some(OdometryKind::Lidar2d),
        SensorKind::Camera => Some(OdometryKind::Mono),
        SensorKind::Imu | SensorKind::Odometry => None,
    }
}

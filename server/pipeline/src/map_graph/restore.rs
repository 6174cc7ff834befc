//! The map graph goes on from what was stored.

use super::MapGraph;
use super::given::is_seen_alike;
use super::keyframes::Keyframes;
use super::trajectory::Trajectory;
use crate::{KeyframeInfo, Restored, RestoredContent, TrajectoryEntry};
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, Timestamp};
use percept_mapping::MapEntry;
use percept_slam::{BackEndKeyframe, OdometryKind};

/// Where the stored trajectory ends.
pub(crate) struct End {
    /// The sensor whose keyframes the trajectory hangs on.
    pub(crate) sensor: SensorId,
    pub(crate) stamp: Timestamp,
    pub(crate) t_map_base: Pose,
    pub(crate) t_odom_base: Pose,
    /// Base, seen from the keyframe that it hangs on.
    pub(crate) t_anchor_base: Pose,
}

impl MapGraph {
    /// Brings back keyframes, layers and trajectory; where the trajectory ends, if that is known.
    pub(crate) fn restore(&mut self, restored: &Restored) -> Option<End> {
        self.map.go_on_from(restored.map_version);
        let mut infos = Vec::with_capacity(restored.keyframes.len());
        for (i, k) in restored.keyframes.iter().enumerate() {
            let mut info = KeyframeInfo {
                id: KeyframeId(i as u64),
                stamp: Timestamp::default(),
                sensor: k.sensor().clone(),
                t_map_base: k.t_map_base,
                t_odom_base: k.t_odom_base,
                num_points: 0,
                merged: None,
            };
            match &k.content {
                RestoredContent::Scan(scan) => {
                    self.fill_layers(&info, k.after_gap, scan);
                    self.base_height_m = scan.base_height_m;
                    (info.stamp, info.num_points) = (scan.stamp, scan.hits.len());
                }
                RestoredContent::Merged { stamp, merged, .. } => {
                    let (t_map_base, t_odom_base) = (k.t_map_base, k.t_odom_base);
                    self.map.skip(&MapEntry { t_map_base, t_odom_base, after_gap: k.after_gap });
                    (info.stamp, info.merged) = (*stamp, Some(*merged));
                }
            }
            infos.push(info);
        }
        self.keyframes = Keyframes::restored(infos);
        self.trajectory = Trajectory::restored(&restored.trajectory);
        self.end(restored)
    }

    /// Where the trajectory ends; odom goes on from the newest keyframe.
    fn end(&mut self, restored: &Restored) -> Option<End> {
        // Frames that were not tracked have guessed poses.
        let anchored = |e: &TrajectoryEntry| Some((*e, e.anchor.filter(|_| e.tracked)?));
        let (entry, anchor) = restored.trajectory.iter().rev().find_map(anchored)?;
        let newest = restored.keyframes.last()?;
        self.t_map_odom = newest.t_map_base * newest.t_odom_base.inverse();
        let anchor = restored.keyframes.get(anchor.0 as usize)?;
        Some(End {
            // The trajectory hangs on keyframes of the sensor that moves the pose.
            sensor: anchor.sensor().clone(),
            stamp: entry.stamp,
            t_map_base: anchor.t_map_base * entry.t_anchor_base,
            t_odom_base: anchor.t_odom_base * entry.t_anchor_base,
            t_anchor_base: entry.t_anchor_base,
        })
    }

    /// Gives the stored keyframes and loops to the back end.
    pub(crate) fn restore_constraints(&mut self, kind: OdometryKind, pose_sensor: &SensorId, restored: &Restored) {
        self.prepare(kind);
        let Some(back_end) = self.constraints.at_rest() else { return };
        let keyframes = restored.keyframes.iter().enumerate().filter_map(|(i, k)| {
            let (id, scan) = (KeyframeId(i as u64), k.scan()?);
            Some(BackEndKeyframe {
                id,
                t_map_base: k.t_map_base,
                t_odom_base: k.t_odom_base,
                covariance: Covariance6::zeros(),
                scan: self.map.kept_scan(id).cloned().unwrap_or_else(|| scan.into()),
                recognise: scan.sensor == *pose_sensor || is_seen_alike(kind, &scan.sensor, scan),
                after_gap: k.after_gap,
                constraint: None,
            })
        });
        back_end.resume(keyframes, restored.loops.clone(), restored.next_loop_id);
        self.constraints.set_loops(restored.loops.clone());
    }
}

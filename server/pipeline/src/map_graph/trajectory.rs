//! Where the robot was at every registered frame, relative to keyframes, so that it moves with them.

use super::keyframes::Keyframes;
use crate::{Chunks, KeyframeInfo, TrajectoryEntry};
use percept_geometry::{Pose, Timestamp};
use std::ops::Deref;

/// Entries in the order of their stamps.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trajectory(Chunks<TrajectoryEntry>);

impl Deref for Trajectory {
    type Target = Chunks<TrajectoryEntry>;

    fn deref(&self) -> &Chunks<TrajectoryEntry> {
        &self.0
    }
}

impl Trajectory {
    /// As it was stored.
    pub(super) fn restored(entries: &[TrajectoryEntry]) -> Self {
        let mut trajectory = Chunks::default();
        entries.iter().for_each(|e| trajectory.push(*e));
        Self(trajectory)
    }

    /// As it is now, for readers.
    pub(crate) fn shared(&self) -> Chunks<TrajectoryEntry> {
        self.0.clone()
    }

    /// The newest stamp.
    pub(super) fn newest(&self) -> Option<Timestamp> {
        self.0.last().map(|entry| entry.stamp)
    }

    /// Hangs a frame on a keyframe.
    pub(super) fn push(
        &mut self,
        (stamp, t_map_base, tracked): (Timestamp, &Pose, bool),
        anchor: &KeyframeInfo,
        is_keyframe: bool,
    ) -> TrajectoryEntry {
        let t_anchor_base = anchor.t_map_base.inverse() * t_map_base;
        let entry = TrajectoryEntry { stamp, tracked, anchor: Some(anchor.id), t_anchor_base, is_keyframe };
        self.0.push(entry);
        entry
    }

    /// Adds a frame whose pose is in a unit of its own; before the first that was measured there is no trajectory.
    pub(super) fn push_without_scale(
        &mut self,
        (stamp, t_map_base, tracked): (Timestamp, &Pose, bool),
    ) -> Option<TrajectoryEntry> {
        if !tracked && self.0.is_empty() {
            return None;
        }
        let entry = TrajectoryEntry { stamp, tracked, anchor: None, t_anchor_base: *t_map_base, is_keyframe: false };
        self.0.push(entry);
        Some(entry)
    }

    /// Frames that hang on keyframes and were tracked, with base to map.
    pub(super) fn placed(&self, keyframes: &Keyframes) -> Vec<(Timestamp, Pose)> {
        let placed = |entry: &TrajectoryEntry| {
            let anchor = keyframes.of(entry.anchor.filter(|_| entry.tracked)?)?;
            Some((entry.stamp, anchor.t_map_base * entry.t_anchor_base))
        };
        self.0.iter().filter_map(placed).collect()
    }

    /// Hangs frames whose odom poses are known on the `anchors` before them, both in the order of their stamps; the entries
    /// as they are then.
    pub(super) fn mend(
        &mut self,
        frames: impl Iterator<Item = (Timestamp, Pose)>,
        anchors: &[&KeyframeInfo],
    ) -> Vec<TrajectoryEntry> {
        let mut mended = vec![];
        for (stamp, t_odom_base) in frames {
            let after = anchors.partition_point(|k| k.stamp <= stamp);
            let Some(anchor) = after.checked_sub(1).and_then(|k| anchors.get(k)) else { continue };
            let entry = TrajectoryEntry {
                stamp,
                tracked: true,
                anchor: Some(anchor.id),
                t_anchor_base: anchor.t_odom_base.inv_mul(&t_odom_base),
                is_keyframe: anchor.stamp == stamp,
            };
            mended.extend(self.replace(stamp, |_| entry));
        }
        mended
    }

    /// Frames that were placed in what is not the map any more, or where the robot was not; the entries as they are then.
    pub(super) fn forget(&mut self, frames: &[(Timestamp, Pose)]) -> Vec<TrajectoryEntry> {
        let lost = |entry: TrajectoryEntry| TrajectoryEntry { tracked: false, ..entry };
        let forgotten = frames.iter().filter(|(stamp, _)| self.is_tracked(*stamp)).map(|f| f.0);
        let forgotten: Vec<Timestamp> = forgotten.collect();
        forgotten.into_iter().filter_map(|stamp| self.replace(stamp, lost)).collect()
    }

    fn is_tracked(&self, stamp: Timestamp) -> bool {
        self.0.get(self.0.partition_point(|e| e.stamp < stamp)).is_some_and(|e| e.stamp == stamp && e.tracked)
    }

    /// Puts another entry in the place of the one with this stamp, if there is one.
    fn replace(
        &mut self,
        stamp: Timestamp,
        new: impl Fn(TrajectoryEntry) -> TrajectoryEntry,
    ) -> Option<TrajectoryEntry> {
        let i = self.0.partition_point(|e| e.stamp < stamp);
        let entry = new(*self.0.get(i).filter(|e| e.stamp == stamp)?);
        self.0.replace(i, entry);
        Some(entry)
    }

    /// Poses in a unit of their own hang on no keyframe: they follow the camera's own map when that closes a loop. `moved`
    /// takes odom near each stamp, ascending, to where it is now. Where they are stored they stay as they were said.
    pub(super) fn move_without_scale(&mut self, moved: &[(Timestamp, Pose)], t_map_odom: &Pose) {
        let Some(first) = moved.first() else { return };
        let nearest = |stamp: Timestamp| {
            let after = moved.partition_point(|m| m.0 < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| moved.get(i));
            around.min_by_key(|m| m.0.nanos().abs_diff(stamp.nanos())).map(|m| m.1)
        };
        let mut trajectory = Chunks::default();
        for entry in self.0.iter() {
            let mut entry = *entry;
            if let Some(t_new_old) = nearest(entry.stamp).filter(|_| entry.anchor.is_none() && entry.stamp >= first.0) {
                entry.t_anchor_base = t_map_odom * t_new_old * t_map_odom.inverse() * entry.t_anchor_base;
            }
            trajectory.push(entry);
        }
        self.0 = trajectory;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{KeyframeId, SensorId, se3};

    fn at(x: f64) -> Pose {
        se3::from_xy_yaw(x, 0.0, 0.0)
    }

    fn keyframe() -> KeyframeInfo {
        KeyframeInfo {
            id: KeyframeId(0),
            stamp: Timestamp(2),
            sensor: SensorId::from("camera"),
            t_map_base: at(5.0),
            t_odom_base: at(5.0),
            num_points: 1,
            merged: None,
        }
    }

    #[test]
    fn before_the_first_frame_that_was_measured_there_is_no_trajectory() {
        let mut trajectory = Trajectory::default();
        assert_eq!(trajectory.push_without_scale((Timestamp(1), &at(0.0), false)), None);
        assert!(trajectory.push_without_scale((Timestamp(2), &at(0.0), true)).is_some());
        assert!(trajectory.push_without_scale((Timestamp(3), &at(0.0), false)).is_some());
        assert_eq!(trajectory.len(), 2);
    }

    #[test]
    fn frames_in_a_cameras_own_unit_move_with_its_map_and_those_on_keyframes_with_these() {
        let mut trajectory = Trajectory::default();
        trajectory.push_without_scale((Timestamp(0), &at(0.0), true));
        trajectory.push_without_scale((Timestamp(1), &at(1.0), true));
        trajectory.push((Timestamp(2), &at(5.5), true), &keyframe(), false);
        // Where odom begins at (0, 3) and is turned by a quarter, forward is the map's y.
        let t_map_odom = se3::from_xy_yaw(0.0, 3.0, std::f64::consts::FRAC_PI_2);
        trajectory.move_without_scale(&[(Timestamp(1), at(2.0)), (Timestamp(2), at(2.0))], &t_map_odom);
        let entries: Vec<_> = trajectory.iter().map(|e| e.t_anchor_base.translation.vector).collect();
        let expected = [[0.0, 0.0], [1.0, 2.0], [0.5, 0.0]];
        for (entry, [x, y]) in entries.iter().zip(expected) {
            assert!((entry.x - x).abs() < 1e-12 && (entry.y - y).abs() < 1e-12, "{entry}");
        }
    }

    #[test]
    fn frames_that_are_known_since_hang_on_the_keyframe_before_them() {
        let mut trajectory = Trajectory::default();
        for i in 1..5 {
            trajectory.push((Timestamp(i), &at(0.0), false), &keyframe(), false);
        }
        let frames = [1, 2, 4, 7].map(|i| (Timestamp(i), at(5.0 + i as f64)));
        // The first lies before the keyframe, and the last was never registered.
        let mended = trajectory.mend(frames.into_iter(), &[&keyframe()]);
        let seen = |e: &TrajectoryEntry| (e.stamp.nanos(), e.tracked, e.is_keyframe, e.t_anchor_base.translation.x);
        assert_eq!(mended.iter().map(seen).collect::<Vec<_>>(), [(2, true, true, 2.0), (4, true, false, 4.0)]);
        assert_eq!(trajectory.iter().filter(|e| e.tracked).count(), 2);
        let forgotten = trajectory.forget(&frames[1..2]);
        assert_eq!(forgotten.len(), 1);
        assert!(trajectory.get(1).is_some_and(|e| !e.tracked && *e == forgotten[0]));
    }
}

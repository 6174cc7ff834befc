//! Where the robot was at a time: between two frames of the trajectory, on the shortest screw from one to the other.

use crate::{Snapshot, TrajectoryEntry};
use percept_geometry::{Pose, Timestamp, se3};
use std::ops::Range;

/// Where the robot was at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseAt {
    /// The time, session's clock.
    pub stamp: Timestamp,
    /// Base to map, with all corrections so far.
    pub t_map_base: Pose,
    /// Base to odom; none where lengths are in a unit of their own.
    pub t_odom_base: Option<Pose>,
    /// Whether both frames around it were placed.
    pub is_tracked: bool,
    /// Whether lengths are metres.
    pub is_metric: bool,
    /// Stamp of the frame before, or at, that time.
    pub before: Timestamp,
    /// Stamp of the frame after, or at, that time.
    pub after: Timestamp,
}

/// Why it is not known where the robot was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LookupError {
    /// No frame was registered yet.
    #[error("no frame was registered yet")]
    Empty,
    /// Before the first frame.
    #[error("before the first frame")]
    Before {
        /// Stamp of the first frame.
        first: Timestamp,
        /// Stamp of the newest.
        last: Timestamp,
    },
    /// After the newest frame.
    #[error("after the newest frame")]
    After {
        /// Stamp of the first frame.
        first: Timestamp,
        /// Stamp of the newest.
        last: Timestamp,
    },
    /// Between two frames whose lengths are in different units.
    #[error("between frames in different units")]
    UnitsDiffer {
        /// Stamp of the frame before.
        before: Timestamp,
        /// Stamp of the frame after.
        after: Timestamp,
    },
}

impl Snapshot {
    /// Stamps of the first and the newest registered frame.
    pub fn trajectory_range(&self) -> Option<(Timestamp, Timestamp)> {
        Some((self.trajectory.get(0)?.stamp, self.trajectory.last()?.stamp))
    }

    /// Places in the trajectory of the frames from `from` to `to`, both included; none stands for its beginning, or end.
    pub fn trajectory_between(&self, from: Option<Timestamp>, to: Option<Timestamp>) -> Range<usize> {
        let first = from.map_or(0, |from| self.trajectory.partition_point(|e| e.stamp < from));
        let end = to.map_or(self.trajectory.len(), |to| self.trajectory.partition_point(|e| e.stamp <= to));
        first..end.max(first)
    }

    /// Base to map, at a frame.
    pub fn t_map_base_of(&self, entry: &TrajectoryEntry) -> Option<Pose> {
        let Some(anchor) = entry.anchor else { return Some(entry.t_anchor_base) };
        Some(self.keyframes.get(usize::try_from(anchor.0).ok()?)?.t_map_base * entry.t_anchor_base)
    }

    fn t_odom_base_of(&self, entry: &TrajectoryEntry) -> Option<Pose> {
        let anchor = self.keyframes.get(usize::try_from(entry.anchor?.0).ok()?)?;
        Some(anchor.t_odom_base * entry.t_anchor_base)
    }

    /// Where the robot was at a time.
    ///
    /// # Errors
    /// By variant.
    pub fn pose_at(&self, stamp: Timestamp) -> Result<PoseAt, LookupError> {
        let (first, last) = self.trajectory_range().ok_or(LookupError::Empty)?;
        if stamp < first {
            return Err(LookupError::Before { first, last });
        }
        let after = self.trajectory.partition_point(|e| e.stamp < stamp);
        let next = self.trajectory.get(after).ok_or(LookupError::After { first, last })?;
        let before = if next.stamp == stamp { after } else { after.saturating_sub(1) };
        let previous = self.trajectory.get(before).unwrap_or(next);
        if previous.anchor.is_some() != next.anchor.is_some() {
            return Err(LookupError::UnitsDiffer { before: previous.stamp, after: next.stamp });
        }
        let span_s = next.stamp.seconds_since(previous.stamp);
        let share = if span_s > 0.0 { stamp.seconds_since(previous.stamp) / span_s } else { 0.0 };
        let between =
            |of: &dyn Fn(&TrajectoryEntry) -> Option<Pose>| Some(se3::interpolate(&of(previous)?, &of(next)?, share));
        let t_map_base = between(&|e| self.t_map_base_of(e)).ok_or(LookupError::Empty)?;
        Ok(PoseAt {
            stamp,
            t_map_base,
            t_odom_base: between(&|e| self.t_odom_base_of(e)),
            is_tracked: previous.tracked && next.tracked,
            is_metric: next.anchor.is_some(),
            before: previous.stamp,
            after: next.stamp,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Chunks, KeyframeInfo, Pipeline, PipelineParams};
    use nalgebra::{Isometry3, Vector3};
    use percept_geometry::{KeyframeId, SensorId};

    fn pose(x: f64, yaw: f64) -> Pose {
        Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * yaw)
    }

    /// Frames at 1, 2 and 4 s on a keyframe that a correction moved by 10 m, the first one in a unit of its own.
    fn snapshot() -> Snapshot {
        let mut snapshot = Pipeline::new(PipelineParams::default()).unwrap().snapshot();
        let keyframe = KeyframeInfo {
            id: KeyframeId(0),
            stamp: Timestamp(2_000_000_000),
            sensor: SensorId::from("laser"),
            t_map_base: pose(10.0, 0.0),
            t_odom_base: pose(0.0, 0.0),
            num_points: 1,
            merged: None,
        };
        snapshot.keyframes = [keyframe].into_iter().collect();
        let mut trajectory = Chunks::default();
        for (s, anchor, t_anchor_base, tracked) in [
            (1, None, pose(0.5, 0.0), true),
            (2, Some(KeyframeId(0)), pose(0.0, 0.0), true),
            (4, Some(KeyframeId(0)), pose(0.0, 1.0), true),
            (5, Some(KeyframeId(0)), pose(1.0, 1.0), false),
        ] {
            let stamp = Timestamp(s * 1_000_000_000);
            trajectory.push(TrajectoryEntry { stamp, tracked, anchor, t_anchor_base, is_keyframe: s == 2 });
        }
        snapshot.trajectory = trajectory;
        snapshot
    }

    fn at(seconds: f64) -> Result<PoseAt, LookupError> {
        snapshot().pose_at(Timestamp(0).plus_seconds(seconds))
    }

    #[test]
    fn a_pose_between_two_frames_lies_on_the_way_between_them() {
        let half = at(3.0).unwrap();
        // Turning by a radian within two seconds: half of it, and no way, after one.
        assert!((half.t_map_base.rotation.angle() - 0.5).abs() < 1e-12);
        assert!((half.t_map_base.translation.vector - Vector3::x() * 10.0).norm() < 1e-12);
        assert!(half.t_odom_base.unwrap().translation.vector.norm() < 1e-12, "odom was not corrected");
        assert!(half.is_tracked && half.is_metric);
        assert_eq!((half.before.nanos(), half.after.nanos()), (2_000_000_000, 4_000_000_000));
        let exact = at(4.0).unwrap();
        assert_eq!((exact.before, exact.after), (exact.stamp, exact.stamp));
        assert!(!at(4.5).unwrap().is_tracked, "one of the two was not placed");
    }

    #[test]
    fn nothing_is_made_up_outside_of_the_trajectory_or_between_units() {
        let (first, last) = (Timestamp(1_000_000_000), Timestamp(5_000_000_000));
        assert_eq!(at(0.999), Err(LookupError::Before { first, last }));
        assert_eq!(at(5.001), Err(LookupError::After { first, last }));
        assert_eq!(at(1.5), Err(LookupError::UnitsDiffer { before: first, after: Timestamp(2_000_000_000) }));
        let alone = at(1.0).unwrap();
        assert_eq!((alone.is_metric, alone.t_odom_base), (false, None));
        assert!(at(5.0).is_ok() && at(2.0).unwrap().is_metric);
        let empty = Pipeline::new(PipelineParams::default()).unwrap().snapshot();
        assert_eq!(empty.pose_at(first), Err(LookupError::Empty));
    }

    #[test]
    fn ranges_include_both_ends() {
        let s = snapshot();
        let stamp = |seconds: f64| Some(Timestamp(0).plus_seconds(seconds));
        assert_eq!(s.trajectory_between(None, None), 0..4);
        assert_eq!(s.trajectory_between(stamp(2.0), stamp(4.0)), 1..3);
        assert_eq!(s.trajectory_between(stamp(2.1), stamp(3.9)), 2..2);
        assert_eq!(s.trajectory_between(stamp(9.0), stamp(1.0)), 4..4);
    }
}

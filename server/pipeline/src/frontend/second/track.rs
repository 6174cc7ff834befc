//! Where base was, by one sensor's odometry, in the last seconds.

use nalgebra::UnitQuaternion;
use percept_geometry::{Pose, Timestamp, se3};
use std::collections::VecDeque;

/// Poses are kept for so long, seconds: frames of two sensors are compared as soon as both have come.
const KEPT_S: f64 = 3.0;
/// Velocities are taken over at least this time, seconds: registrations err by millimetres.
const SPAN_S: f64 = 0.08;

/// A placed frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    pub(super) stamp: Timestamp,
    /// Base to the odom of that odometry.
    pub(super) t_odom_base: Pose,
    /// Axes of base that the frame left open.
    pub(super) open: [bool; 6],
}

/// Base at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct At {
    pub(super) t_odom_base: Pose,
    /// Axes of base that a frame beside it left open.
    pub(super) open: [bool; 6],
    /// Between the two frames around it, seconds; 0 at a frame.
    pub(super) gap_s: f64,
    /// From the newest frame to it, seconds; 0 if it is not newer.
    pub(super) ahead_s: f64,
}

/// Placed frames without an interruption, oldest first.
#[derive(Debug, Clone, Default)]
pub(super) struct Track(VecDeque<Placed>);

impl Track {
    pub(super) fn push(&mut self, placed: Placed) {
        if self.newest().is_some_and(|newest| newest.stamp >= placed.stamp) {
            return;
        }
        self.0.push_back(placed);
        while self.0.front().is_some_and(|p| placed.stamp.seconds_since(p.stamp) > KEPT_S) {
            self.0.pop_front();
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn keep_newest(&mut self) {
        self.0.drain(..self.0.len().saturating_sub(1));
    }

    pub(super) fn newest(&self) -> Option<&Placed> {
        self.0.back()
    }

    /// Axes that frames from a stamp on left open.
    pub(super) fn open_from(&self, stamp: Timestamp) -> [bool; 6] {
        self.0.iter().rev().take_while(|p| p.stamp >= stamp).fold([false; 6], |open, p| either(&open, &p.open))
    }

    /// Base at a time between two frames.
    pub(super) fn at(&self, stamp: Timestamp) -> Option<At> {
        let after = self.0.partition_point(|p| p.stamp < stamp);
        let next = self.0.get(after)?;
        if next.stamp == stamp {
            return Some(At { t_odom_base: next.t_odom_base, open: next.open, gap_s: 0.0, ahead_s: 0.0 });
        }
        let before = self.0.get(after.checked_sub(1)?)?;
        let gap_s = next.stamp.seconds_since(before.stamp);
        let share = stamp.seconds_since(before.stamp) / gap_s;
        let t_odom_base = se3::interpolate(&before.t_odom_base, &next.t_odom_base, share);
        Some(At { t_odom_base, open: either(&before.open, &next.open), gap_s, ahead_s: 0.0 })
    }

    /// Base at a time between two frames, or at most `reach_s` after the newest, as it moved before.
    pub(super) fn at_or_ahead(&self, stamp: Timestamp, reach_s: f64) -> Option<At> {
        let newest = self.newest()?;
        let ahead_s = stamp.seconds_since(newest.stamp);
        if ahead_s <= 0.0 {
            return self.at(stamp);
        }
        let before = self.0.iter().rev().find(|p| newest.stamp.seconds_since(p.stamp) >= SPAN_S);
        let before = before.or(self.0.front()).filter(|p| p.stamp < newest.stamp)?;
        let gap_s = newest.stamp.seconds_since(before.stamp);
        let t_odom_base = se3::interpolate(&before.t_odom_base, &newest.t_odom_base, 1.0 + ahead_s / gap_s);
        (ahead_s <= reach_s).then_some(At { t_odom_base, open: newest.open, gap_s, ahead_s })
    }
}

/// The same pose, its rotation of length one to the last digit.
pub(super) fn normalized(t: &Pose) -> Pose {
    Pose::from_parts(t.translation, UnitQuaternion::new_normalize(t.rotation.into_inner()))
}

pub(super) fn either(a: &[bool; 6], b: &[bool; 6]) -> [bool; 6] {
    std::array::from_fn(|k| a[k] || b[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_interpolated_and_led_on_and_not_invented_far_ahead() {
        let mut track = Track::default();
        let at = Timestamp::from_secs_f64;
        let shut = [false; 6];
        for i in 0..10 {
            let open = [i == 3, false, false, false, false, false];
            let t_odom_base = se3::from_xy_yaw(0.1 * f64::from(i), 0.0, 0.0);
            track.push(Placed { stamp: at(0.1 * f64::from(i)), t_odom_base, open });
        }
        let between = track.at(at(0.25)).unwrap();
        assert!((between.t_odom_base.translation.x - 0.25).abs() < 1e-9 && between.open[0]);
        assert!((between.gap_s - 0.1).abs() < 1e-9);
        assert_eq!(track.at(at(0.55)).unwrap().open, shut);
        assert!(track.at(at(0.95)).is_none() && track.at(at(-0.1)).is_none());
        let ahead = track.at_or_ahead(at(1.1), 0.3).unwrap();
        assert!((ahead.t_odom_base.translation.x - 1.1).abs() < 1e-9 && (ahead.ahead_s - 0.2).abs() < 1e-9);
        assert!(track.at_or_ahead(at(1.3), 0.3).is_none());
        assert!(track.open_from(at(0.3))[0] && !track.open_from(at(0.31))[0]);
    }
}

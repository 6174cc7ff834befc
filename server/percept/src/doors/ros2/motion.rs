//! Where the robot was in the frame that its wheels count in, for the last seconds.

use percept_geometry::{Pose, Timestamp, se3};
use std::collections::VecDeque;

/// So long a pose of the map may take to come, nanoseconds.
const KEPT_NS: u64 = 20_000_000_000;
/// A pose is told of between samples that are no farther apart, nanoseconds; beyond the newest, by as much.
const GAP_NS: u64 = 500_000_000;
/// Samples that are kept at most: 20 s at 200 Hz.
const MOST: usize = 4000;

/// Poses by time, rising.
#[derive(Debug, Default)]
pub(super) struct Motion {
    samples: VecDeque<(Timestamp, Pose)>,
}

impl Motion {
    /// Notes a pose; one that is not newer than the last begins anew if time was set back, else it is known already.
    pub(super) fn push(&mut self, stamp: Timestamp, t_odom_base: Pose) {
        if let Some((newest, _)) = self.samples.back()
            && stamp <= *newest
        {
            if newest.0.abs_diff(stamp.0) < KEPT_NS {
                return;
            }
            self.samples.clear();
        }
        self.samples.push_back((stamp, t_odom_base));
        let is_old = |oldest: &(Timestamp, Pose)| stamp.0.abs_diff(oldest.0.0) > KEPT_NS;
        while self.samples.len() > MOST || self.samples.front().is_some_and(is_old) {
            self.samples.pop_front();
        }
    }

    /// Stamp of the newest pose.
    pub(super) fn newest(&self) -> Option<Timestamp> {
        self.samples.back().map(|(stamp, _)| *stamp)
    }

    /// Where the robot was at a time: between two samples on the screw that joins them.
    pub(super) fn at(&self, stamp: Timestamp) -> Option<Pose> {
        let after = self.samples.partition_point(|(at, _)| *at < stamp);
        match (after.checked_sub(1).and_then(|i| self.samples.get(i)), self.samples.get(after)) {
            (_, Some((at, pose))) if *at == stamp => Some(*pose),
            (Some((a, t_odom_a)), Some((b, t_odom_b))) => {
                let span = b.0.abs_diff(a.0);
                (span <= GAP_NS)
                    .then(|| se3::interpolate(t_odom_a, t_odom_b, stamp.0.abs_diff(a.0) as f64 / span as f64))
            }
            (Some((at, pose)), None) | (None, Some((at, pose))) => (at.0.abs_diff(stamp.0) <= GAP_NS).then_some(*pose),
            (None, None) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_told_between_samples_and_shortly_beyond() {
        let mut motion = Motion::default();
        assert_eq!(motion.at(Timestamp(0)), None);
        let s = |s: f64| Timestamp((s * 1e9) as i64);
        motion.push(s(1.0), Pose::translation(0.0, 0.0, 0.0));
        motion.push(s(1.2), Pose::translation(0.4, 0.0, 0.0));
        motion.push(s(3.0), Pose::translation(2.0, 0.0, 0.0));
        let x = |t: f64| motion.at(s(t)).map(|p| (p.translation.x * 1e6).round() / 1e6);
        assert_eq!(
            (x(1.1), x(1.2), x(2.0), x(3.4), x(3.6), x(0.4)),
            (Some(0.2), Some(0.4), None, Some(2.0), None, None)
        );
    }

    #[test]
    fn a_clock_that_is_set_back_begins_anew_and_a_late_sample_is_left() {
        let mut motion = Motion::default();
        let s = |s: i64| Timestamp(s * 1_000_000_000);
        motion.push(s(100), Pose::translation(1.0, 0.0, 0.0));
        motion.push(s(99), Pose::translation(9.0, 0.0, 0.0));
        assert_eq!((motion.newest(), motion.samples.len()), (Some(s(100)), 1));
        motion.push(s(5), Pose::translation(2.0, 0.0, 0.0));
        assert_eq!((motion.newest(), motion.samples.len()), (Some(s(5)), 1));
        (6..40).for_each(|i| motion.push(s(i), Pose::identity()));
        assert!(motion.samples.len() <= 21);
    }
}

//! A trajectory: poses in the order of time, and which poses of two trajectories belong together.

use crate::EvaluationError;
use percept_geometry::{Pose, Stamped, Timestamp, se3};
use std::borrow::Cow;

/// Stamps this close are one: files round them to as little as four decimals.
pub const SAME_STAMP_S: f64 = 2e-4;

/// Poses of one body in one frame, stamps not decreasing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory(Vec<Stamped<Pose>>);

impl Trajectory {
    /// A trajectory of `t_frame_body` poses.
    ///
    /// # Errors
    /// `StampsDecrease` or `PoseNotFinite` with the index of the first offender. Repeated stamps are
    /// let through: recorded ground truth has them.
    pub fn new(poses: Vec<Stamped<Pose>>) -> Result<Self, EvaluationError> {
        for (index, pose) in poses.iter().enumerate() {
            let t = &pose.value;
            if !t.translation.vector.iter().chain(t.rotation.coords.iter()).all(|v| v.is_finite()) {
                return Err(EvaluationError::PoseNotFinite { index });
            }
            if index > 0 && pose.stamp < poses[index - 1].stamp {
                return Err(EvaluationError::StampsDecrease { index });
            }
        }
        Ok(Self(poses))
    }

    /// The poses, in order of time.
    pub fn poses(&self) -> &[Stamped<Pose>] {
        &self.0
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Sum of the straight distances from pose to pose, metres.
    pub fn path_length_m(&self) -> f64 {
        path_length(self.0.iter().map(|p| &p.value))
    }

    /// The pose at `stamp`, on the geodesic between its neighbours; `None` before the first and after the last.
    pub fn at(&self, stamp: Timestamp) -> Option<Pose> {
        let after = self.0.partition_point(|p| p.stamp < stamp);
        let next = self.0.get(after)?;
        if next.stamp == stamp {
            return Some(next.value);
        }
        let previous = &self.0[after.checked_sub(1)?];
        let share = stamp.seconds_since(previous.stamp) / next.stamp.seconds_since(previous.stamp);
        Some(se3::interpolate(&previous.value, &next.value, share))
    }

    /// As [`Self::at`], but only if the neighbours are at most `max_gap_s` apart, or one of them is at `stamp` but
    /// for the rounding of stamps in files ([`SAME_STAMP_S`]).
    pub fn at_within(&self, stamp: Timestamp, max_gap_s: f64) -> Option<Pose> {
        let nearest = &self.0[self.nearest(stamp)?];
        if nearest.stamp.seconds_since(stamp).abs() <= SAME_STAMP_S {
            return Some(nearest.value);
        }
        let after = self.0.partition_point(|p| p.stamp < stamp);
        let (previous, next) = (self.0.get(after.checked_sub(1)?)?, self.0.get(after)?);
        (next.stamp.seconds_since(previous.stamp) <= max_gap_s).then(|| self.at(stamp)).flatten()
    }

    /// Index of the pose nearest in time to `stamp`, the earlier of equally near ones, the first of equals;
    /// `None` if empty.
    pub fn nearest(&self, stamp: Timestamp) -> Option<usize> {
        let after = self.0.partition_point(|p| p.stamp < stamp);
        let first_of_equals = |i: usize| self.0.partition_point(|p| p.stamp < self.0[i].stamp);
        let away = |i: usize| (i128::from(self.0[i].stamp.0) - i128::from(stamp.0)).unsigned_abs();
        match (after.checked_sub(1), after < self.0.len()) {
            (None, false) => None,
            (None, true) => Some(after),
            (Some(before), false) => Some(first_of_equals(before)),
            (Some(before), true) if away(before) <= away(after) => Some(first_of_equals(before)),
            (Some(_), true) => Some(after),
        }
    }

    /// The trajectory with its stamps moved by `offset_s`; itself for 0.
    pub(crate) fn shifted(&self, offset_s: f64) -> Result<Cow<'_, Self>, EvaluationError> {
        if offset_s == 0.0 {
            return Ok(Cow::Borrowed(self));
        }
        // A hundred years: stamps stay within their range.
        if offset_s.is_nan() || offset_s.abs() > 3.2e9 {
            let requirement = "finite and within 3.2e9 s";
            return Err(EvaluationError::InvalidParam { field: "estimate_offset_s", value: offset_s, requirement });
        }
        let pose = |p: &Stamped<Pose>| Stamped { stamp: p.stamp.plus_seconds(offset_s), value: p.value };
        Ok(Cow::Owned(Self(self.0.iter().map(pose).collect())))
    }
}

/// Sum of the straight distances from pose to pose, metres.
pub(crate) fn path_length<'a>(poses: impl IntoIterator<Item = &'a Pose>) -> f64 {
    let mut poses = poses.into_iter();
    let Some(mut previous) = poses.next() else { return 0.0 };
    let mut length = 0.0;
    for pose in poses {
        length += (pose.translation.vector - previous.translation.vector).norm();
        previous = pose;
    }
    length
}

/// A true pose and the estimate of it: both `t_frame_body`, each in its own trajectory's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PosePair {
    /// Stamp of the reference's pose.
    pub stamp: Timestamp,
    /// What is true.
    pub reference: Pose,
    /// What was estimated.
    pub estimate: Pose,
}

/// Pairs of poses that are at most `max_difference_s` apart in time.
///
/// As evo 1.38 does it: every pose of the shorter trajectory (of the estimate, if they are equally long) takes the
/// one nearest in time of the longer, which may so be taken twice; pairs come in the shorter one's order.
///
/// # Errors
/// `InvalidParam` for a negative or non-finite difference, `NoCommonStamps` if there is no pair.
pub fn associate(
    reference: &Trajectory,
    estimate: &Trajectory,
    max_difference_s: f64,
) -> Result<Vec<PosePair>, EvaluationError> {
    if !(max_difference_s.is_finite() && max_difference_s >= 0.0) {
        return Err(EvaluationError::InvalidParam {
            field: "max_difference_s",
            value: max_difference_s,
            requirement: "finite and not negative",
        });
    }
    let reference_is_longer = reference.len() >= estimate.len();
    let (short, long) = if reference_is_longer { (estimate, reference) } else { (reference, estimate) };
    let mut pairs = Vec::with_capacity(short.len());
    for pose in short.poses() {
        let Some(other) = partner(long.poses(), pose.stamp, max_difference_s) else { continue };
        let (r, e) = if reference_is_longer { (other, pose) } else { (pose, other) };
        pairs.push(PosePair { stamp: r.stamp, reference: r.value, estimate: e.value });
    }
    if pairs.is_empty() {
        return Err(EvaluationError::NoCommonStamps {
            num_reference: reference.len(),
            num_estimate: estimate.len(),
            max_difference_s,
        });
    }
    Ok(pairs)
}

/// The pose nearest in time, within `max_difference_s`: of equally near ones the earlier, of equal ones the last.
///
/// Compared are f64 seconds, as evo has them: recorded stamps often lie exactly between two others, and to which
/// side such a one falls is a matter of the last bit.
fn partner(poses: &[Stamped<Pose>], stamp: Timestamp, max_difference_s: f64) -> Option<&Stamped<Pose>> {
    let at = seconds(stamp);
    let after = poses.partition_point(|p| seconds(p.stamp) <= at).min(poses.len().checked_sub(1)?);
    let until = seconds(poses[after].stamp) - at;
    let since = after.checked_sub(1).map_or(f64::INFINITY, |before| at - seconds(poses[before].stamp));
    if until.abs() <= max_difference_s && until < since {
        Some(&poses[after])
    } else if since <= max_difference_s && since <= until {
        Some(&poses[after - 1])
    } else {
        None
    }
}

/// A stamp as the f64 of seconds that is read from its decimal digits.
fn seconds(stamp: Timestamp) -> f64 {
    let (whole, nanos) = (stamp.0.div_euclid(1_000_000_000), stamp.0.rem_euclid(1_000_000_000));
    whole as f64 + nanos as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn along_x(stamps: &[i64]) -> Trajectory {
        let pose = |&s: &i64| Stamped { stamp: Timestamp(s), value: Pose::translation(s as f64, 0.0, 0.0) };
        Trajectory::new(stamps.iter().map(pose).collect()).unwrap()
    }

    #[test]
    fn poses_between_stamps_are_interpolated_and_none_is_made_up_outside() {
        let t = along_x(&[0, 10, 30]);
        assert!((t.at(Timestamp(15)).unwrap().translation.x - 15.0).abs() < 1e-9);
        assert_eq!(t.at(Timestamp(30)).unwrap().translation.x, 30.0);
        assert!(t.at(Timestamp(-1)).is_none() && t.at(Timestamp(31)).is_none());
        assert!(Trajectory::default().at(Timestamp(0)).is_none());
        assert_eq!(t.path_length_m(), 30.0);
    }

    #[test]
    fn bad_trajectories_are_refused_by_index() {
        let at = |s: i64, x: f64| Stamped { stamp: Timestamp(s), value: Pose::translation(x, 0.0, 0.0) };
        let refused = |poses| Trajectory::new(poses).unwrap_err();
        assert_eq!(refused(vec![at(2, 0.0), at(1, 0.0)]), EvaluationError::StampsDecrease { index: 1 });
        assert_eq!(refused(vec![at(2, f64::NAN)]), EvaluationError::PoseNotFinite { index: 0 });
        assert!(Trajectory::new(vec![at(1, 0.0), at(1, 1.0)]).is_ok());
    }

    #[test]
    fn trajectories_that_do_not_meet_in_time_say_so() {
        let error = associate(&along_x(&[0, 1]), &along_x(&[5_000_000_000]), 0.01).unwrap_err();
        assert!(matches!(error, EvaluationError::NoCommonStamps { num_reference: 2, num_estimate: 1, .. }));
        assert!(associate(&along_x(&[0]), &Trajectory::default(), 0.01).is_err());
        assert!(associate(&along_x(&[0]), &along_x(&[0]), f64::NAN).is_err());
    }

    proptest! {
        #[test]
        fn nearest_is_the_first_minimum_of_all_differences(mut stamps in prop::collection::vec(0i64..40, 1..12), at in -5i64..45) {
            stamps.sort_unstable();
            let brute = (0..stamps.len()).min_by_key(|&i| (stamps[i] - at).abs());
            prop_assert_eq!(along_x(&stamps).nearest(Timestamp(at)), brute);
        }
    }
}

//! What one awake session adds to the sums over all.

use super::families::FAMILIES;
use percept_geometry::Timestamp;
use percept_slam::{LostReason, TrackingState};
use std::sync::{Mutex, PoisonError};

/// Two frames further apart than this have a pause between them, which is no time lost; seconds.
const PAUSE_S: f64 = 5.0;

const INITIALISING: &str = "initialising";
const TRACKING: &str = "tracking";
const LOST: &str = "lost";

/// What a session adds to the sums; dropped, it takes its part out again.
#[derive(Debug, Default)]
pub struct SessionShare(Mutex<Part>);

#[derive(Debug, Default)]
struct Part {
    keyframes: i64,
    objects: i64,
    memory_bytes: i64,
    tracking: Option<(&'static str, Timestamp)>,
}

impl SessionShare {
    /// Size of its map.
    pub fn map(&self, num_keyframes: usize, num_objects: usize) {
        let mut part = self.part();
        FAMILIES.keyframes.inc_by(moved(&mut part.keyframes, num_keyframes));
        FAMILIES.objects.inc_by(moved(&mut part.objects, num_objects));
    }

    /// What its map takes in memory.
    pub fn memory(&self, bytes: usize) {
        FAMILIES.memory_bytes.inc_by(moved(&mut self.part().memory_bytes, bytes));
    }

    /// How the robot was placed by the frame of this stamp.
    pub fn tracking(&self, state: TrackingState, stamp: Timestamp) {
        let mut part = self.part();
        let name = name(state);
        let before = part.tracking.replace((name, stamp));
        if let Some((LOST, since)) = before {
            let lost_s = stamp.seconds_since(since);
            if (0.0..=PAUSE_S).contains(&lost_s) {
                FAMILIES.lost_seconds.inc_by(lost_s);
            }
        }
        if before.is_some_and(|(was, _)| was == name) {
            return;
        }
        if let Some((was, _)) = before {
            FAMILIES.sessions_tracking.get_or_create(&[("state", was)]).dec();
            FAMILIES.tracking_changes.get_or_create(&[("to", name)]).inc();
        }
        FAMILIES.sessions_tracking.get_or_create(&[("state", name)]).inc();
        if let TrackingState::Lost { reason } = state {
            FAMILIES.tracking_lost.get_or_create(&[("reason", reason_name(reason))]).inc();
        }
    }

    fn part(&self) -> std::sync::MutexGuard<'_, Part> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for SessionShare {
    fn drop(&mut self) {
        self.map(0, 0);
        self.memory(0);
        if let Some((was, _)) = self.part().tracking {
            FAMILIES.sessions_tracking.get_or_create(&[("state", was)]).dec();
        }
    }
}

/// Sets `part` and says by how much it moved.
fn moved(part: &mut i64, to: usize) -> i64 {
    let to = i64::try_from(to).unwrap_or(i64::MAX);
    to - std::mem::replace(part, to)
}

const fn name(state: TrackingState) -> &'static str {
    match state {
        TrackingState::Initialising => INITIALISING,
        TrackingState::Tracking => TRACKING,
        TrackingState::Lost { .. } => LOST,
    }
}

const fn reason_name(reason: LostReason) -> &'static str {
    match reason {
        LostReason::TooFewPoints => "too_few_points",
        LostReason::TooFewCorrespondences => "too_few_correspondences",
        LostReason::ResidualTooLarge => "residual_too_large",
        LostReason::MotionTooLarge => "motion_too_large",
        LostReason::Degenerate => "degenerate",
        LostReason::TimeGap => "time_gap",
        LostReason::UnsuitableScan => "unsuitable_scan",
        LostReason::NoTexture => "no_texture",
        LostReason::BadExposure => "bad_exposure",
        LostReason::IntrinsicsMismatch => "intrinsics_mismatch",
        LostReason::Adrift => "adrift",
    }
}

const REASONS: [LostReason; 11] = [
    LostReason::TooFewPoints,
    LostReason::TooFewCorrespondences,
    LostReason::ResidualTooLarge,
    LostReason::MotionTooLarge,
    LostReason::Degenerate,
    LostReason::TimeGap,
    LostReason::UnsuitableScan,
    LostReason::NoTexture,
    LostReason::BadExposure,
    LostReason::IntrinsicsMismatch,
    LostReason::Adrift,
];

/// Makes the series exist.
pub(super) fn prepare() {
    for reason in REASONS {
        drop(FAMILIES.tracking_lost.get_or_create(&[("reason", reason_name(reason))]));
    }
    for state in [INITIALISING, TRACKING, LOST] {
        drop(FAMILIES.sessions_tracking.get_or_create(&[("state", state)]));
        drop(FAMILIES.tracking_changes.get_or_create(&[("to", state)]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_add_up_and_leave_nothing_behind() {
        // No other test of this process touches these sums.
        let (a, b) = (SessionShare::default(), SessionShare::default());
        a.map(3, 1);
        b.map(4, 0);
        a.map(5, 2);
        a.memory(1000);
        assert_eq!((FAMILIES.keyframes.get(), FAMILIES.objects.get(), FAMILIES.memory_bytes.get()), (9, 2, 1000));
        drop((a, b));
        assert_eq!((FAMILIES.keyframes.get(), FAMILIES.objects.get(), FAMILIES.memory_bytes.get()), (0, 0, 0));
    }

    #[test]
    fn lost_time_is_counted_by_stamps_without_pauses() {
        let share = SessionShare::default();
        let at = |s: f64| Timestamp::from_nanos((s * 1e9) as i64);
        let lost = TrackingState::Lost { reason: LostReason::NoTexture };
        let before = FAMILIES.lost_seconds.get();
        for (state, s) in [
            (TrackingState::Tracking, 0.0),
            (lost, 1.0),
            (lost, 1.5),
            (TrackingState::Tracking, 2.0),
            (lost, 3.0),
            (TrackingState::Tracking, 3600.0),
        ] {
            share.tracking(state, at(s));
        }
        assert!((FAMILIES.lost_seconds.get() - before - 1.0).abs() < 1e-9);
        assert_eq!(FAMILIES.tracking_lost.get_or_create(&[("reason", "no_texture")]).get(), 2);
    }
}

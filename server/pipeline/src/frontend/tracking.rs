//! What a frame's pose is worth: one state machine, told by odometry, wheels and the map.
//!
//! Odometry that was lost for too long starts a new local model at a pose that it predicted. If wheels covered every frame of
//! the loss, that pose is dead reckoning and mapping goes on. Otherwise nothing measured anchors it in the map: the robot is
//! unanchored and the map stays as it is, until the relocaliser has found it. Where it was found it is tentative, and the map still
//! stays as it is, until what it sees elsewhere agrees.

use percept_geometry::{Pose, Timestamp};
use percept_slam::{LostReason, OdometryEstimate, TrackingState};

/// A frame that is anchored in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AnchoredFrame {
    /// Base to odom.
    pub(crate) t_odom_base: Pose,
    /// When it was taken.
    pub(crate) stamp: Timestamp,
}

/// A robot whose odometry runs on from a guess.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unanchored {
    /// The newest frame that was anchored in the map.
    pub(crate) last: AnchoredFrame,
    /// Frames in metres since odometry began anew.
    pub(crate) num_frames: u32,
    /// Whether wheels covered the loss, and odometry or they each frame since: the guess is theirs then.
    pub(crate) is_reckoned: bool,
}

/// How the robot's pose hangs on the map. `last` is the newest frame that was anchored in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) enum Tracking {
    /// No frame was anchored in the map yet.
    #[default]
    Initialising,
    /// No frame was anchored in the map yet: lengths are in a camera's own unit.
    WaitingForScale,
    /// The newest frame is anchored in the map: it was measured, or started a local model where wheels had led.
    Anchored { last: AnchoredFrame },
    /// The newest frames are not anchored in the map, but wheels covered each of them, or a camera followed them in a unit of its
    /// own. Contradicted: a frame after a gap did not fit the map where wheels said that it is in it.
    DeadReckoning { last: AnchoredFrame, is_contradicted: bool },
    /// The newest frames are not anchored in the map, and nothing covered all of them.
    Lost { last: AnchoredFrame },
    /// Odometry began anew from a guess: nothing anchors it in the map.
    Unanchored(Unanchored),
    /// The robot was found in the map, and may be in another place that looks alike.
    Tentative { last: AnchoredFrame },
}

impl Tracking {
    /// Goes on from a stored frame.
    pub(crate) fn resumed(t_odom_base: Pose, stamp: Timestamp) -> Self {
        Self::Anchored { last: AnchoredFrame { t_odom_base, stamp } }
    }

    /// Before the first frame of a robot that comes into a map which was there before it.
    pub(crate) fn lost_in_given() -> Self {
        Self::Lost { last: AnchoredFrame { t_odom_base: Pose::identity(), stamp: Timestamp::default() } }
    }

    /// Takes the state after a frame. `has_wheels`: whether wheels measured the motion since the frame before. `is_mapped`:
    /// whether the robot has been before where odometry believes to be.
    pub(crate) fn step(&mut self, estimate: &OdometryEstimate, has_wheels: bool, is_mapped: impl Fn() -> bool) {
        let is_covered = has_wheels || estimate.state.is_tracking();
        *self = if estimate.scale.is_metric() {
            self.after_frame(estimate, is_covered, is_mapped)
        } else {
            self.after_frame_without_scale(is_covered)
        };
    }

    fn after_frame(self, estimate: &OdometryEstimate, is_covered: bool, is_mapped: impl Fn() -> bool) -> Self {
        let now = Self::resumed(estimate.t_odom_base, estimate.stamp);
        let (last, is_contradicted, is_reckoned) = match self {
            Self::Initialising | Self::WaitingForScale if estimate.state.is_lost() => return Self::Initialising,
            Self::Initialising | Self::WaitingForScale => return now,
            Self::Unanchored(before) => {
                let is_reckoned = before.is_reckoned && is_covered;
                return Self::Unanchored(Unanchored { num_frames: before.num_frames + 1, is_reckoned, ..before });
            }
            Self::Tentative { last } if estimate.state == TrackingState::Initialising => (last, false, false),
            Self::Tentative { .. } => return self,
            Self::Anchored { last } => (last, false, is_covered),
            Self::DeadReckoning { last, is_contradicted } => (last, is_contradicted, is_covered),
            Self::Lost { last } => (last, false, false),
        };
        match estimate.state {
            TrackingState::Tracking => now,
            TrackingState::Lost { .. } if !is_reckoned => Self::Lost { last },
            TrackingState::Lost { reason } => {
                let is_contradicted = is_contradicted || (reason == LostReason::TimeGap && is_mapped());
                Self::DeadReckoning { last, is_contradicted }
            }
            // A frame that does not fit the map where wheels say that it is in it: somebody carried the robot, perhaps.
            TrackingState::Initialising if !is_reckoned || is_contradicted || is_mapped() => {
                Self::Unanchored(Unanchored { last, num_frames: 0, is_reckoned })
            }
            TrackingState::Initialising => now,
        }
    }

    /// Nothing can be anchored in the map; whether the pose goes on from it is kept in mind until lengths are metres.
    fn after_frame_without_scale(self, is_covered: bool) -> Self {
        let (last, is_contradicted) = match self {
            Self::Initialising | Self::WaitingForScale => return Self::WaitingForScale,
            Self::Unanchored(_) => return self,
            Self::Tentative { last } => {
                return Self::Unanchored(Unanchored { last, num_frames: 0, is_reckoned: false });
            }
            Self::Anchored { last } if is_covered => (last, false),
            Self::DeadReckoning { last, is_contradicted } if is_covered => (last, is_contradicted),
            Self::Anchored { last } | Self::DeadReckoning { last, .. } | Self::Lost { last } => {
                return Self::Unanchored(Unanchored { last, num_frames: 0, is_reckoned: false });
            }
        };
        Self::DeadReckoning { last, is_contradicted }
    }

    /// The robot was found in the map, certainly or not, or what it has seen became the map.
    pub(crate) fn found(&mut self, estimate: &OdometryEstimate, is_certain: bool) {
        *self = match *self {
            Self::Unanchored(Unanchored { last, .. }) if !is_certain => Self::Tentative { last },
            _ => Self::resumed(estimate.t_odom_base, estimate.stamp),
        };
    }

    /// The robot is anchored in the map, and may be in another place that looks alike.
    pub(crate) fn doubt(&mut self) {
        if let Self::Anchored { last } = *self {
            *self = Self::Tentative { last };
        }
    }

    /// What spoke against the place that wheels have led to was not there: they lead on.
    pub(crate) fn reckon(&mut self) {
        if let Self::Unanchored(Unanchored { last, is_reckoned: true, .. }) = *self {
            *self = Self::DeadReckoning { last, is_contradicted: false };
        }
    }

    /// Whether the newest frames were not placed, and no new local model was begun.
    pub(crate) fn is_lost(&self) -> bool {
        matches!(self, Self::Lost { .. } | Self::DeadReckoning { .. })
    }

    /// The robot is not where it was found.
    pub(crate) fn withdraw(&mut self) {
        if let Self::Tentative { last } = *self {
            *self = Self::Unanchored(Unanchored { last, num_frames: 0, is_reckoned: false });
        }
    }

    /// Whether the robot was found in the map, and may be in another place that looks alike.
    pub(crate) fn is_tentative(&self) -> bool {
        matches!(self, Self::Tentative { .. })
    }

    /// Whether the newest frame is anchored in the map.
    pub(crate) fn is_anchored(&self) -> bool {
        matches!(self, Self::Anchored { .. })
    }

    /// What is known of a robot that is unanchored.
    pub(crate) fn unanchored(&self) -> Option<Unanchored> {
        match self {
            Self::Unanchored(unanchored) => Some(*unanchored),
            _ => None,
        }
    }

    /// What is said of a pose that odometry has estimated. What odometry itself lacks says more than that it is unanchored,
    /// and so does that a camera begins.
    pub(crate) fn told(&self, estimate: &OdometryEstimate) -> TrackingState {
        match estimate.state {
            state @ TrackingState::Lost { .. } => state,
            TrackingState::Initialising if !estimate.scale.is_metric() => TrackingState::Initialising,
            _ if self.unanchored().is_some() => TrackingState::Lost { reason: LostReason::Adrift },
            state => state,
        }
    }
}

#[cfg(test)]
mod tests;

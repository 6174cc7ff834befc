//! What a frame did.

use super::Told;
use crate::{MapChange, NewKeyframe, PoseEstimate, TrajectoryEntry};

/// What a frame did.
#[derive(Debug, Clone, Default)]
pub struct FrameReport {
    /// Pose after it; none for sensors that do not move the pose.
    pub pose: Option<PoseEstimate>,
    /// Set if the frame was added to the trajectory.
    pub trajectory: Option<TrajectoryEntry>,
    /// Set if it became a keyframe.
    pub keyframe: Option<NewKeyframe>,
    /// Keyframes of a part of the map that joined it with this frame, or became it; older than `keyframe`.
    pub joined: Vec<NewKeyframe>,
    /// Entries of the trajectory that are now known better, ascending: of frames since the robot was unanchored, which hang on the
    /// keyframes that joined, and of frames in what is not the map any more, which are not tracked.
    pub mended: Vec<TrajectoryEntry>,
    /// What changed besides, by what was begun at frames before.
    pub map: MapChange,
    /// What became of a pose that was told before it.
    pub told: Option<Told>,
}

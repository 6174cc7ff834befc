//! Whether a pose can be trusted, and if not, why.

use serde::{Deserialize, Serialize};

/// State of an odometry after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "state")]
pub enum TrackingState {
    /// This frame started the local model (the first frame, or a restart after too many lost ones): the
    /// pose is the one the model starts from, not a measurement.
    Initialising,
    /// The pose was measured against the local model.
    Tracking,
    /// No measurement: the pose is a prediction and its covariance has grown.
    Lost {
        /// Why.
        reason: LostReason,
    },
}

impl TrackingState {
    /// Whether the pose was measured.
    pub fn is_tracking(self) -> bool {
        self == Self::Tracking
    }

    /// Whether the frame could not be placed.
    pub fn is_lost(self) -> bool {
        matches!(self, Self::Lost { .. })
    }
}

/// Why a frame could not be placed; `Display` says it to an operator, with a remedy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LostReason {
    /// The frame holds too few usable measurements.
    TooFewPoints,
    /// Too little of the frame overlaps the local model.
    TooFewCorrespondences,
    /// The frame overlaps the model but does not fit it.
    ResidualTooLarge,
    /// The frame fits only with a motion that no robot of this kind makes.
    MotionTooLarge,
    /// The frame's geometry leaves most of the motion open.
    Degenerate,
    /// Too much time passed since the last placed frame, and the frame does not fit the old place.
    TimeGap,
    /// The scan's kind is not the one that this odometry registers.
    UnsuitableScan,
    /// Odometry was lost for too long and started anew at a guessed pose: nothing measured ties it to the map.
    Adrift,
}

impl std::fmt::Display for LostReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::TooFewPoints => "too few points: the sensor is covered, too near or too far from everything",
            Self::TooFewCorrespondences => "too little overlap with the places just seen: go back or turn back",
            Self::ResidualTooLarge => "the scene does not fit the places just seen: many things moved, or a jump",
            Self::MotionTooLarge => "the motion between two frames is too large: drive slower or send more frames",
            Self::Degenerate => "the scene has too little structure to fix the motion: turn towards objects or corners",
            Self::TimeGap => "frames were missing for too long: go back to where tracking was lost",
            Self::UnsuitableScan => "the sensor sends another kind of scan than this odometry registers",
            Self::Adrift => "odometry started anew at a guessed pose: go back to where tracking was lost",
        })
    }
}

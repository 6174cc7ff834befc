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
    /// The frame's geometry leaves most of the motion open, or has left an axis open for seconds while nothing measured it.
    Degenerate,
    /// Too much time passed since the last placed frame, and the frame does not fit the old place.
    TimeGap,
    /// The scan's kind is not the one that this odometry registers.
    UnsuitableScan,
    /// The image shows too few distinct places.
    NoTexture,
    /// Most of the image is white or black.
    BadExposure,
    /// The image's size is not that of the intrinsics, or these are no camera's.
    IntrinsicsMismatch,
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
            Self::Degenerate => {
                "the scene has too little structure to fix the motion: turn towards objects or corners, or send wheel \
                 odometry along"
            }
            Self::TimeGap => "frames were missing for too long: go back to where tracking was lost",
            Self::UnsuitableScan => "the sensor sends another kind of scan than this odometry registers",
            Self::NoTexture => "the image shows too little texture: turn towards things with detail, clean the lens",
            Self::BadExposure => "the image is nearly all white or black: check exposure, light and lens cap",
            Self::IntrinsicsMismatch => {
                "the camera's intrinsics do not fit its images: declare those of this resolution"
            }
            Self::Adrift => {
                "nothing ties this place to the map yet: drive on through known places, or go back to where tracking \
                 was lost"
            }
        })
    }
}

/// Whether lengths are metres, and what tells so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// The sensor measures lengths.
    Measured,
    /// Lengths are in a unit of the map's own: one camera does not tell more.
    Unknown,
    /// By wheel odometry, or what else stated the motion in metres.
    FromOdometry,
    /// By depth images.
    FromDepth,
    /// By a known distance between two cameras.
    FromBaseline,
}

impl std::fmt::Display for Scale {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Measured => "the sensor measures lengths",
            Self::Unknown => {
                "unknown: one camera does not tell lengths, so that no map is built; send wheel odometry, depth images \
                 or a second camera's images along"
            }
            Self::FromOdometry => "by wheel odometry",
            Self::FromDepth => "by depth images",
            Self::FromBaseline => "by a second camera at a known distance",
        })
    }
}

impl Scale {
    /// Whether lengths are metres.
    pub fn is_metric(self) -> bool {
        self != Self::Unknown
    }
}

/// What an odometry that needs several frames to begin is waiting for; `Display` says it to an operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Waiting {
    /// The first image came.
    SecondView,
    /// The camera stood, only turned, or looks at things far away.
    NoParallax,
    /// The images have too little in common.
    FewMatches,
}

impl std::fmt::Display for Waiting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::SecondView => "waiting for a second view: move the camera sideways",
            Self::NoParallax => "no parallax yet: move the camera sideways, turning in place shows no depth",
            Self::FewMatches => "the images have too little in common: move more slowly, towards things with detail",
        })
    }
}

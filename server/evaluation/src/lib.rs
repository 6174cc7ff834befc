//! How good is it: trajectories, detections and maps measured against the truth.
//!
//! Comes in: what was estimated and what is true, in memory. Goes out: figures with defined meaning.
//! No file is read here (that is `formats`) and nothing is estimated. Start with
//! [`score::score_trajectory`], which computes all figures of a trajectory; [`absolute`], [`relative`] and
//! [`drift`] are its parts. Without a true trajectory, but with some checked motions: [`relations`]. Detections: [`detection::match_detections`], [`ranking`] of their confidences, [`identity`] of tracks. Maps: [`occupancy`], [`cloud`].
//!
//! Trajectory figures agree with the tool evo (Grupp 2017) on its own test data, digit by digit.
//! A figure that does not exist (the precision of no detection, the drift of no path) is `None`, not 0.

pub mod absolute;
pub mod alignment;
pub mod assignment;
pub mod cloud;
pub mod detection;
pub mod drift;
pub mod identity;
pub mod occupancy;
pub mod ranking;
pub mod relations;
pub mod relative;
pub mod score;
pub mod statistics;
pub mod trajectory;

pub use absolute::{AbsoluteError, absolute_error};
pub use alignment::{Alignment, Similarity, align};
pub use assignment::best_pairs;
pub use cloud::{CloudScore, score_cloud};
pub use detection::{ClassScore, DetectionScore, FoundObject, TrueObject, match_detections};
pub use drift::{SegmentDrift, SegmentParams, end_drift_percent, segment_drift};
pub use identity::{IdentityPair, IdentityScore, identity_score};
pub use occupancy::{OccupancyScore, score_occupancy};
pub use ranking::{Judged, average_precision, calibration_error};
pub use relations::{RelationScore, TrueRelation, score_relations};
pub use relative::{Delta, RelativeError, relative_error};
pub use score::{TrajectoryParams, TrajectoryScore, aligned_pairs, score_trajectory};
pub use statistics::ErrorStatistics;
pub use trajectory::{PosePair, Trajectory, associate};

/// Why a figure could not be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EvaluationError {
    /// A pose of a trajectory is earlier than the one before it.
    #[error("pose {index}: stamp is earlier than that of the pose before, sort the trajectory by time")]
    StampsDecrease {
        /// Index of the earlier pose.
        index: usize,
    },
    /// A pose holds NaN or infinity.
    #[error("pose {index}: not finite")]
    PoseNotFinite {
        /// Its index.
        index: usize,
    },
    /// No pose of the one trajectory has a pose of the other close enough in time.
    #[error(
        "no stamps within {max_difference_s} s of each other among {num_reference} reference and {num_estimate} estimated poses"
    )]
    NoCommonStamps {
        /// Poses in the reference.
        num_reference: usize,
        /// Poses in the estimate.
        num_estimate: usize,
        /// Largest time difference allowed, seconds.
        max_difference_s: f64,
    },
    /// The scale of a similarity is not determined: all positions of one trajectory coincide.
    #[error("scale is not determined: all positions of a trajectory coincide, align with se3")]
    ScaleUndetermined,
    /// No two poses are as far apart as asked.
    #[error("no two poses are {delta} {unit} apart among {num_poses}, choose a smaller delta")]
    NoPairs {
        /// The distance asked for.
        delta: f64,
        /// `frames`, `m`, `s` or `deg`.
        unit: &'static str,
        /// Poses there are.
        num_poses: usize,
    },
    /// No relation has both its stamps in the trajectory.
    #[error(
        "none of {num_relations} relations has both its stamps in the trajectory or in a gap of at most {max_gap_s} s"
    )]
    NoRelations {
        /// Relations given.
        num_relations: usize,
        /// Longest gap that is bridged, seconds.
        max_gap_s: f64,
    },
    /// What was asked for takes too long for so many poses.
    #[error(
        "all pairs by angle among {num_poses} poses, at most {limit} are compared: take fewer poses, or not all pairs"
    )]
    TooManyPoses {
        /// Poses there are.
        num_poses: usize,
        /// Most that are compared.
        limit: usize,
    },
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is not {requirement}")]
    InvalidParam {
        /// Parameter name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
    },
    /// Two inputs that belong together differ in size.
    #[error("{field}: expected {expected} elements, got {actual}")]
    ShapeMismatch {
        /// Which input.
        field: &'static str,
        /// Elements needed.
        expected: usize,
        /// Elements given.
        actual: usize,
    },
}

/// `value` if it is positive and finite.
fn positive(field: &'static str, value: f64) -> Result<f64, EvaluationError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(EvaluationError::InvalidParam { field, value, requirement: "positive and finite" })
    }
}

//! Why a map could not do what was asked.

use crate::submap_id::SubmapId;
use percept_geometry::{GeometryError, KeyframeId, KeyframeScan, Pose};

/// Facts about a refused request; the map is as it was before.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MappingError {
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is refused, {remedy}")]
    InvalidParam {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What to set instead.
        remedy: &'static str,
    },
    /// A pose (of base in the map, or of the sensor in base) has a NaN or infinite number.
    #[error("pose is not finite")]
    PoseNotFinite,
    /// A keyframe of this number is in the map already.
    #[error("keyframe {} is in the map already", .id.0)]
    DuplicateKeyframe {
        /// The number.
        id: KeyframeId,
    },
    /// Keyframes enter in the order of their numbers.
    #[error("keyframe {} comes after {}", .id.0, .newest.0)]
    KeyframeNotNewest {
        /// The number.
        id: KeyframeId,
        /// The newest in the map.
        newest: KeyframeId,
    },
    /// There is no submap of this id.
    #[error("submap {} of run {} of robot {} is not in the map", .id.number, .id.run, .id.robot)]
    NoSubmap {
        /// The id.
        id: SubmapId,
    },
    /// What a submap holds is out of memory, and the store does not give it back.
    #[error("what submap {} of run {} of robot {} holds is lost", .id.number, .id.run, .id.robot)]
    SubmapLost {
        /// The id.
        id: SubmapId,
    },
    /// A scan's channels do not fit its points, or its height is not finite.
    #[error(transparent)]
    Scan(#[from] GeometryError),
    /// A point is not finite, or so far out that no cell there has a number.
    #[error("point is not finite, or farther out than cells have numbers")]
    PointTooFar,
    /// A map that was given shows no place from which it could be looked at.
    #[error("nothing of the map is known to be free: there is no place to look at it from")]
    NothingFree,
    /// A dense grid of this size was asked for.
    #[error("region of {cells} cells is larger than the limit of {limit}")]
    RegionTooLarge {
        /// Cells asked for.
        cells: u64,
        /// Cells allowed.
        limit: u64,
    },
    /// A depth image reaches into so many blocks of voxels.
    #[error(
        "depth image touches {blocks} blocks of voxels, the limit is {limit}: choose larger voxels or a shorter range"
    )]
    TooManyBlocks {
        /// Blocks that it touches.
        blocks: usize,
        /// Blocks allowed.
        limit: usize,
    },
    /// The surface has more triangles than were allowed.
    #[error("surface has more than {limit} triangles: name a smaller region, or allow more")]
    MeshTooLarge {
        /// Triangles allowed.
        limit: usize,
    },
    /// A region whose minimum exceeds its maximum.
    #[error("region is empty: its minimum exceeds its maximum")]
    RegionEmpty,
    /// A dense grid's cells do not fit its width and height.
    #[error("grid of {width} x {height} has {cells} cells")]
    GridShape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Cells given.
        cells: usize,
    },
    /// A cell's value is neither -1 (unknown) nor in 0..=100.
    #[error("cell {index} has value {value}, expected -1 or 0 to 100")]
    CellValue {
        /// Row-major index.
        index: usize,
        /// The value as given.
        value: i8,
    },
}

/// Refuses a parameter that is not within `min..=max` (both finite), naming it.
pub(crate) fn check(
    field: &'static str,
    value: f64,
    min: f64,
    max: f64,
    remedy: &'static str,
) -> Result<(), MappingError> {
    if value >= min && value <= max { Ok(()) } else { Err(MappingError::InvalidParam { field, value, remedy }) }
}

/// Refuses a pose with a number that is not finite.
pub(crate) fn check_pose(pose: &Pose) -> Result<(), MappingError> {
    let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
    if finite { Ok(()) } else { Err(MappingError::PoseNotFinite) }
}

/// Refuses a keyframe that no layer can take.
pub(crate) fn check_keyframe(t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
    check_pose(t_map_base)?;
    check_pose(&scan.t_base_sensor)?;
    scan.hits.validate()?;
    let value = scan.base_height_m;
    let bad = GeometryError::OutOfRange { field: "base_height_m", value, requirement: "finite" };
    if value.is_finite() { Ok(()) } else { Err(bad.into()) }
}

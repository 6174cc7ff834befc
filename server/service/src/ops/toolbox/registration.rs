//! Two clouds to a transform.

use super::registration_error;
use crate::Result;
use percept_geometry::{PointCloud, Pose};
use percept_perception::registration::{IcpResult, RegisterParams, register};

/// Lays a source over a target from an initial `t_target_source`.
///
/// # Errors
/// `REGISTRATION_INVALID`: too few points, parameters out of bounds, a channel that the method needs is not there;
/// `VOXEL_TOO_SMALL`.
pub fn register_clouds(
    source: &PointCloud,
    target: &PointCloud,
    initial: &Pose,
    params: &RegisterParams,
) -> Result<IcpResult> {
    register(source, target, initial, params).map_err(registration_error)
}

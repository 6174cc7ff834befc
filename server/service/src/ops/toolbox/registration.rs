//! Two clouds to a transform.

use super::registration_error;
use crate::Result;
use percept_geometry::{PointCloud, Pose};
use percept_perception::cloud::{NormalParams, estimate_normals};
use percept_perception::registration::{IcpParams, IcpResult, align_point_to_plane, align_point_to_point};

/// What registration minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegistrationMethod {
    /// Distances of points.
    PointToPoint,
    /// Distances from the target's surface.
    PointToPlane,
}

/// Lays a source over a target from an initial `t_target_source`.
///
/// # Errors
/// `REGISTRATION_INVALID`: too few points, parameters out of bounds.
pub fn register_clouds(
    source: &PointCloud,
    target: &PointCloud,
    initial: &Pose,
    method: RegistrationMethod,
    params: &IcpParams,
) -> Result<IcpResult> {
    let aligned = match method {
        RegistrationMethod::PointToPoint => align_point_to_point(&source.positions, &target.positions, initial, params),
        RegistrationMethod::PointToPlane => {
            let estimated;
            let normals = match &target.normals {
                Some(normals) => normals,
                None => {
                    let radius_m = params.max_distance_m;
                    let normals = NormalParams { radius_m, ..NormalParams::default() };
                    estimated = estimate_normals(&target.positions, &normals, None)?;
                    &estimated
                }
            };
            align_point_to_plane(&source.positions, &target.positions, normals, initial, params)
        }
    };
    aligned.map_err(|e| registration_error(&e))
}

//! Registration: parameters of requests, and answers.

use super::{count, set};
use crate::convert::{geometry, unknown_enum};
use crate::v1;
use percept_perception::registration::{IcpMethod, IcpParams, IcpResult, RegisterParams};
use percept_service::Result;

/// Method and parameters of a registration.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn registration(r: &v1::RegisterCloudsRequest) -> Result<RegisterParams> {
    use v1::RegistrationMethod as M;
    let method = match M::try_from(r.method) {
        Ok(M::Unspecified | M::PointToPlane) => IcpMethod::PointToPlane,
        Ok(M::PointToPoint) => IcpMethod::PointToPoint,
        Err(_) => return Err(unknown_enum("method", r.method)),
    };
    let mut icp = IcpParams { method, ..IcpParams::default() };
    set(&mut icp.max_distance_m, r.max_distance_m);
    set(&mut icp.max_iterations, count(r.max_iterations));
    Ok(RegisterParams { icp, ..RegisterParams::default() })
}

/// A registration as a message.
pub fn registration_to(r: &IcpResult) -> v1::RegisterCloudsResponse {
    v1::RegisterCloudsResponse {
        t_target_source: Some(geometry::pose_to(&r.t_target_source)),
        fitness: r.inlier_ratio,
        rmse_m: r.inlier_rmse_m,
        covariance: Some(geometry::covariance_to(&r.covariance)),
        iterations: r.iterations as u32,
        converged: r.converged(),
        degenerate_axes: r.degenerate_axes.to_vec(),
    }
}

//! Registration: parameters of requests, and answers.

use super::{count, set};
use crate::convert::{geometry, unknown_enum};
use crate::v1;
use percept_perception::registration::{IcpParams, IcpResult};
use percept_service::Result;
use percept_service::toolbox::RegistrationMethod;

/// Method and parameters of a registration.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn registration(r: &v1::RegisterCloudsRequest) -> Result<(RegistrationMethod, IcpParams)> {
    use v1::RegistrationMethod as M;
    let method = match M::try_from(r.method) {
        Ok(M::Unspecified | M::PointToPlane) => RegistrationMethod::PointToPlane,
        Ok(M::PointToPoint) => RegistrationMethod::PointToPoint,
        Err(_) => return Err(unknown_enum("method", r.method)),
    };
    let mut params = IcpParams::default();
    set(&mut params.max_distance_m, r.max_distance_m);
    set(&mut params.max_iterations, count(r.max_iterations));
    Ok((method, params))
}

/// A registration as a message.
pub fn registration_to(r: &IcpResult) -> v1::RegisterCloudsResponse {
    v1::RegisterCloudsResponse {
        t_target_source: Some(geometry::pose_to(&r.t_target_source)),
        fitness: r.inlier_ratio,
        rmse_m: r.inlier_rmse_m,
        covariance: Some(geometry::covariance_to(&r.covariance)),
        iterations: r.iterations as u32,
        converged: r.converged,
        degenerate_axes: r.degenerate_axes.to_vec(),
    }
}

//! Registration: parameters of requests, and answers.

use crate::convert::{geometry, required, unknown_enum};
use crate::v1;
use percept_perception::registration::{
    Fpfh, FpfhParams, GlobalMethod, GlobalOutcome, GlobalParams, GlobalResult, IcpMethod, IcpOutcome, IcpParams,
    IcpResult, RegisterParams, RobustKernel,
};
use percept_service::{Error, Result};

/// Levels of a registration, at most.
const MAX_LEVELS: usize = 16;

/// Method and parameters of a registration.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn registration(r: &v1::RegisterCloudsRequest) -> Result<RegisterParams> {
    use v1::RegistrationMethod as M;
    let method = match M::try_from(r.method) {
        Ok(M::Unspecified | M::PointToPlane) => IcpMethod::PointToPlane,
        Ok(M::PointToPoint) => IcpMethod::PointToPoint,
        Ok(M::Gicp) => IcpMethod::Gicp,
        Ok(M::Vgicp) => IcpMethod::Vgicp,
        Ok(M::Coloured) => IcpMethod::Colored,
        Err(_) => return Err(unknown_enum("method", r.method)),
    };
    let mut icp = IcpParams { method, kernel: kernel(r.kernel, r.kernel_scale_m)?, ..IcpParams::default() };
    lay_over!(icp, r: max_distance_m, max_iterations, translation_tolerance_m, rotation_tolerance_rad);
    lay_over!(icp, r: num_neighbours, target_voxel_size_m, colour_share, tangent_weight, degeneracy_threshold);
    if r.voxel_sizes_m.len() > MAX_LEVELS {
        let words = format!("voxel_sizes_m has {} entries; send at most {MAX_LEVELS}", r.voxel_sizes_m.len());
        return Err(Error::invalid("LEVELS_TOO_MANY", "voxel_sizes_m", words));
    }
    Ok(RegisterParams { icp, voxel_sizes_m: r.voxel_sizes_m.clone() })
}

fn kernel(kind: i32, scale_m: Option<f64>) -> Result<RobustKernel> {
    use v1::RobustKernelKind as K;
    let scale = || required("kernel_scale_m", scale_m);
    Ok(match K::try_from(kind) {
        Ok(K::Unspecified | K::None) => RobustKernel::None,
        Ok(K::Huber) => RobustKernel::Huber(scale()?),
        Ok(K::Cauchy) => RobustKernel::Cauchy(scale()?),
        Ok(K::GemanMcclure) => RobustKernel::GemanMcClure(scale()?),
        Ok(K::Tukey) => RobustKernel::Tukey(scale()?),
        Err(_) => return Err(unknown_enum("kernel", kind)),
    })
}

fn outcome_to(outcome: IcpOutcome) -> v1::RegistrationOutcome {
    match outcome {
        IcpOutcome::Converged => v1::RegistrationOutcome::Converged,
        IcpOutcome::Degenerate => v1::RegistrationOutcome::Degenerate,
        IcpOutcome::MaxIterations => v1::RegistrationOutcome::MaxIterations,
        IcpOutcome::TooFewPairs => v1::RegistrationOutcome::TooFewPairs,
        IcpOutcome::Diverged => v1::RegistrationOutcome::Diverged,
    }
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
        outcome: outcome_to(r.outcome).into(),
    }
}

/// Parameters of a registration with no first guess.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn global(r: &v1::RegisterCloudsGloballyRequest) -> Result<GlobalParams> {
    use v1::GlobalRegistrationMethod as M;
    let method = match M::try_from(r.method) {
        Ok(M::Unspecified | M::Consistency) => GlobalMethod::Consistency,
        Ok(M::Ransac) => GlobalMethod::Ransac,
        Err(_) => return Err(unknown_enum("method", r.method)),
    };
    let mut params = GlobalParams { method, seed: r.seed, ..GlobalParams::default() };
    lay_over!(params, r: voxel_size_m, max_iterations);
    params.refine = r.refine.unwrap_or(params.refine);
    Ok(params)
}

/// A registration with no first guess as a message.
pub fn global_to(r: &GlobalResult) -> v1::RegisterCloudsGloballyResponse {
    use v1::GlobalRegistrationOutcome as O;
    let outcome = match r.outcome {
        GlobalOutcome::Found => O::Found,
        GlobalOutcome::Doubtful => O::Doubtful,
        GlobalOutcome::Ambiguous => O::Ambiguous,
        GlobalOutcome::NotFound => O::NotFound,
    };
    v1::RegisterCloudsGloballyResponse {
        outcome: outcome.into(),
        t_target_source: Some(geometry::pose_to(&r.t_target_source)),
        covariance: Some(geometry::covariance_to(&r.covariance)),
        overlap: r.overlap,
        rival_overlap: r.rival_overlap,
        rmse_m: r.inlier_rmse_m,
        num_pairs: r.num_pairs as u32,
        num_agreeing: r.num_agreeing as u32,
        degenerate_axes: r.degenerate_axes.to_vec(),
        evidence: if r.evidence.is_finite() { r.evidence } else { 0.0 },
        rival_evidence: r.rival_evidence,
    }
}

/// Parameters of features.
pub fn point_features(r: &v1::ComputePointFeaturesRequest) -> FpfhParams {
    let mut params = FpfhParams::default();
    lay_over!(params, r: radius_m, max_neighbours);
    params
}

/// Features as a message.
pub fn point_features_to(features: &[Fpfh]) -> v1::ComputePointFeaturesResponse {
    v1::ComputePointFeaturesResponse { features: features.iter().flatten().flat_map(|v| v.to_le_bytes()).collect() }
}

//! Registration: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::geometry;
use percept_wire::convert::toolbox::{self as convert, registration};
use percept_wire::v1;

operations! {
    toolbox_registration_service_server::ToolboxRegistrationService, "ToolboxRegistrationService/*",
    one {
        register_clouds(RegisterCloudsRequest) -> RegisterCloudsResponse,
        register_clouds_globally(RegisterCloudsGloballyRequest) -> RegisterCloudsGloballyResponse,
    }
    parts {
        compute_point_features(ComputePointFeaturesRequest) -> ComputePointFeaturesResponse as ComputePointFeaturesStream,
    }
}

fn register_clouds(t: &Toolbox, r: v1::RegisterCloudsRequest) -> Result<v1::RegisterCloudsResponse> {
    let source = convert::cloud(t, "source", r.source.as_ref())?;
    let target = convert::cloud(t, "target", r.target.as_ref())?;
    let initial = geometry::pose("initial_guess", r.initial_guess.as_ref())?;
    let params = registration::registration(&r)?;
    Ok(registration::registration_to(&ops::register_clouds(&source, &target, &initial, &params)?))
}

pub(in crate::doors::grpc) fn register_clouds_globally(
    t: &Toolbox,
    r: v1::RegisterCloudsGloballyRequest,
) -> Result<v1::RegisterCloudsGloballyResponse> {
    let source = convert::cloud(t, "source", r.source.as_ref())?;
    let target = convert::cloud(t, "target", r.target.as_ref())?;
    let params = registration::global(&r)?;
    Ok(registration::global_to(&t.register_clouds_globally(&source, &target, &params)?))
}

fn compute_point_features(t: &Toolbox, r: v1::ComputePointFeaturesRequest) -> Result<v1::ComputePointFeaturesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let features = ops::compute_point_features(&cloud, &registration::point_features(&r))?;
    Ok(registration::point_features_to(&features))
}

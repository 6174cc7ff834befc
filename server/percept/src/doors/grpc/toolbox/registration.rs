//! Registration: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::geometry;
use percept_wire::convert::toolbox::{self as convert, registration};
use percept_wire::v1;

pub(super) fn register_clouds(t: &Toolbox, r: v1::RegisterCloudsRequest) -> Result<v1::RegisterCloudsResponse> {
    let source = convert::cloud(t, "source", r.source.as_ref(), r.source_handle.as_deref())?;
    let target = convert::cloud(t, "target", r.target.as_ref(), r.target_handle.as_deref())?;
    let initial = geometry::pose("initial_guess", r.initial_guess.as_ref())?;
    let params = registration::registration(&r)?;
    Ok(registration::registration_to(&ops::register_clouds(&source, &target, &initial, &params)?))
}

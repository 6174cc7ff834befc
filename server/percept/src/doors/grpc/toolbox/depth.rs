//! Depth and colour images: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, depth};
use percept_wire::v1;

pub(super) fn unproject_depth(t: &Toolbox, r: v1::UnprojectDepthRequest) -> Result<v1::UnprojectDepthResponse> {
    let (image, color, intrinsics, params) = depth::unprojection(&r, t.limits())?;
    let cloud = ops::unproject_depth(&image, color.as_ref(), &intrinsics, &params)?;
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::UnprojectDepthResponse { cloud, kept })
}

pub(super) fn convert_depth(t: &Toolbox, r: v1::ConvertDepthRequest) -> Result<v1::ConvertDepthResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    Ok(v1::ConvertDepthResponse { depth: Some(depth::converted_depth(&image, &r)?) })
}

pub(super) fn convert_color(t: &Toolbox, r: v1::ConvertColorRequest) -> Result<v1::ConvertColorResponse> {
    let image = depth::color("color", r.color.as_ref(), t.limits())?;
    Ok(v1::ConvertColorResponse { color: Some(depth::converted_color(&image, &r)?) })
}

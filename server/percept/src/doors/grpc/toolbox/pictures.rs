//! Pictures: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, depth, pictures};
use percept_wire::v1;

pub(super) fn render_cloud(t: &Toolbox, r: v1::RenderCloudRequest) -> Result<v1::RenderCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (params, labels) = (pictures::render_params(&r)?, pictures::labels(&r)?);
    Ok(v1::RenderCloudResponse { png: ops::render_cloud(&cloud, labels.as_deref(), &params)?.into() })
}

pub(super) fn render_depth(t: &Toolbox, r: v1::RenderDepthRequest) -> Result<v1::RenderDepthResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    Ok(v1::RenderDepthResponse { png: ops::render_depth(&image, pictures::depth_range(&r)?)?.into() })
}

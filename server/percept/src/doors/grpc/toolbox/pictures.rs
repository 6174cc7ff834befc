//! Pictures: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, depth, pictures};
use percept_wire::v1;

operations! {
    toolbox_pictures_service_server::ToolboxPicturesService, "ToolboxPicturesService/*",
    one {}
    parts {
        render_cloud(RenderCloudRequest) -> RenderCloudResponse as RenderCloudStream,
        render_depth(RenderDepthRequest) -> RenderDepthResponse as RenderDepthStream,
    }
}

fn render_cloud(t: &Toolbox, r: v1::RenderCloudRequest) -> Result<v1::RenderCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (params, labels) = (pictures::render_params(&r)?, pictures::labels(&r)?);
    Ok(v1::RenderCloudResponse { png: ops::render_cloud(&cloud, labels.as_deref(), &params)?.into() })
}

fn render_depth(t: &Toolbox, r: v1::RenderDepthRequest) -> Result<v1::RenderDepthResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    Ok(v1::RenderDepthResponse { png: ops::render_depth(&image, pictures::depth_range(&r)?)?.into() })
}

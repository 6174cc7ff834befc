//! Depth and colour images: decode, call, encode.

use percept_perception::depth as images;
use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::geometry;
use percept_wire::convert::toolbox::images::camera;
use percept_wire::convert::toolbox::{self as convert, depth, depth_images};
use percept_wire::v1;

operations! {
    toolbox_depth_service_server::ToolboxDepthService, "ToolboxDepthService/*",
    one {}
    parts {
        unproject_depth(UnprojectDepthRequest) -> UnprojectDepthResponse as UnprojectDepthStream,
        convert_depth(ConvertDepthRequest) -> ConvertDepthResponse as ConvertDepthStream,
        convert_colour(ConvertColourRequest) -> ConvertColourResponse as ConvertColourStream,
        filter_depth(FilterDepthRequest) -> FilterDepthResponse as FilterDepthStream,
        compute_depth_normals(ComputeDepthNormalsRequest) -> ComputeDepthNormalsResponse as ComputeDepthNormalsStream,
        segment_depth_planes(SegmentDepthPlanesRequest) -> SegmentDepthPlanesResponse as SegmentDepthPlanesStream,
        find_depth_edges(FindDepthEdgesRequest) -> FindDepthEdgesResponse as FindDepthEdgesStream,
        register_colour(RegisterColourRequest) -> RegisterColourResponse as RegisterColourStream,
    }
}

fn unproject_depth(t: &Toolbox, r: v1::UnprojectDepthRequest) -> Result<v1::UnprojectDepthResponse> {
    let (image, colour, intrinsics, params) = depth::unprojection(&r, t.limits())?;
    let cloud = ops::unproject_depth(&image, colour.as_ref(), &intrinsics, &params)?;
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::UnprojectDepthResponse { cloud, kept })
}

fn convert_depth(t: &Toolbox, r: v1::ConvertDepthRequest) -> Result<v1::ConvertDepthResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    Ok(v1::ConvertDepthResponse { depth: Some(depth::converted_depth(&image, &r)?) })
}

fn convert_colour(t: &Toolbox, r: v1::ConvertColourRequest) -> Result<v1::ConvertColourResponse> {
    let image = depth::color("colour", r.colour.as_ref(), t.limits())?;
    Ok(v1::ConvertColourResponse { colour: Some(depth::converted_color(&image, &r)?) })
}

fn filter_depth(t: &Toolbox, r: v1::FilterDepthRequest) -> Result<v1::FilterDepthResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    let image = ops::filter_depth(image, &depth_images::filters(&r)?)?;
    Ok(v1::FilterDepthResponse { depth: Some(depth::depth_to(&image)) })
}

fn compute_depth_normals(t: &Toolbox, r: v1::ComputeDepthNormalsRequest) -> Result<v1::ComputeDepthNormalsResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    let rays = images::RayTable::new(&camera("intrinsics", r.intrinsics.as_ref())?)?;
    Ok(depth_images::normals_to(&images::NormalMap::of_depth(&image, &rays, &depth_images::normal_params(&r))?))
}

fn segment_depth_planes(t: &Toolbox, r: v1::SegmentDepthPlanesRequest) -> Result<v1::SegmentDepthPlanesResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    let intrinsics = camera("intrinsics", r.intrinsics.as_ref())?;
    Ok(depth_images::planes_to(&images::depth_planes(&image, &intrinsics, &depth_images::plane_params(&r))?))
}

fn find_depth_edges(t: &Toolbox, r: v1::FindDepthEdgesRequest) -> Result<v1::FindDepthEdgesResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    let intrinsics = camera("intrinsics", r.intrinsics.as_ref())?;
    Ok(depth_images::edges_to(&images::boundaries(&image, &intrinsics, &depth_images::edge_params(&r))?))
}

fn register_colour(t: &Toolbox, r: v1::RegisterColourRequest) -> Result<v1::RegisterColourResponse> {
    let image = depth::depth("depth", r.depth.as_ref(), t.limits())?;
    let colour = depth::color("colour", r.colour.as_ref(), t.limits())?;
    let depth_camera = camera("depth_camera", r.depth_camera.as_ref())?;
    let colour_camera = camera("colour_camera", r.colour_camera.as_ref())?;
    let t_colour_depth = geometry::pose("t_colour_depth", r.t_colour_depth.as_ref())?;
    let jump = r.max_jump_fraction.unwrap_or(0.05);
    let found = images::register_color(&image, &depth_camera, &colour, &colour_camera, &t_colour_depth, jump)?;
    Ok(depth_images::registered_to(&found))
}

//! Features, and several views of one scene: decode, call, encode.

use percept_perception::{features2d, multiview};
use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{depth, features, images};
use percept_wire::v1;

operations! {
    toolbox_images_service_server::ToolboxImagesService, "ToolboxImagesService/*",
    one {}
    parts {
        extract_features(ExtractFeaturesRequest) -> ExtractFeaturesResponse as ExtractFeaturesStream,
        match_features(MatchFeaturesRequest) -> MatchFeaturesResponse as MatchFeaturesStream,
        estimate_essential(EstimateEssentialRequest) -> EstimateEssentialResponse as EstimateEssentialStream,
        estimate_homography(EstimateHomographyRequest) -> EstimateHomographyResponse as EstimateHomographyStream,
        estimate_two_view(EstimateTwoViewRequest) -> EstimateTwoViewResponse as EstimateTwoViewStream,
        triangulate_points(TriangulatePointsRequest) -> TriangulatePointsResponse as TriangulatePointsStream,
        solve_pnp(SolvePnpRequest) -> SolvePnpResponse as SolvePnpStream,
        detect_in_image(DetectInImageRequest) -> DetectInImageResponse as DetectInImageStream,
        list_image_detectors(ListImageDetectorsRequest) -> ListImageDetectorsResponse as ListImageDetectorsStream,
    }
}

fn extract_features(t: &Toolbox, r: v1::ExtractFeaturesRequest) -> Result<v1::ExtractFeaturesResponse> {
    let image = depth::color("image", r.image.as_ref(), t.limits())?;
    Ok(features::features_to(&ops::extract_features(&image.to_gray(), &features::method(&r)?)?))
}

fn detect_in_image(t: &Toolbox, r: v1::DetectInImageRequest) -> Result<v1::DetectInImageResponse> {
    let image = depth::color("image", r.image.as_ref(), t.limits())?;
    Ok(images::image_detections_to(&ops::detect_in_image(t, &r.detector, &image)?))
}

fn list_image_detectors(t: &Toolbox, _: v1::ListImageDetectorsRequest) -> Result<v1::ListImageDetectorsResponse> {
    Ok(images::image_detectors_to(t.image_detectors()))
}

fn match_features(_: &Toolbox, r: v1::MatchFeaturesRequest) -> Result<v1::MatchFeaturesResponse> {
    let (query, train) = features::descriptors(&r)?;
    let found = features2d::match_features(&query, &train, &features::match_params(&r));
    Ok(features::matches_to(&found.map_err(ops::feature_error)?))
}

fn estimate_essential(_: &Toolbox, r: v1::EstimateEssentialRequest) -> Result<v1::EstimateEssentialResponse> {
    let (a, b) = (images::pixels("points_a", &r.points_a)?, images::pixels("points_b", &r.points_b)?);
    let (camera_a, camera_b) = images::cameras(r.camera_a.as_ref(), r.camera_b.as_ref())?;
    let found = multiview::estimate_essential(&a, &b, &camera_a, &camera_b, &images::ransac(r.ransac.as_ref()));
    Ok(images::essential_to(&found.map_err(ops::multiview_error)?))
}

fn estimate_homography(_: &Toolbox, r: v1::EstimateHomographyRequest) -> Result<v1::EstimateHomographyResponse> {
    let (a, b) = (images::pixels("points_a", &r.points_a)?, images::pixels("points_b", &r.points_b)?);
    let found = multiview::estimate_homography(&a, &b, &images::ransac(r.ransac.as_ref()));
    Ok(images::homography_to(&found.map_err(ops::multiview_error)?))
}

fn estimate_two_view(_: &Toolbox, r: v1::EstimateTwoViewRequest) -> Result<v1::EstimateTwoViewResponse> {
    let (a, b) = (images::pixels("points_a", &r.points_a)?, images::pixels("points_b", &r.points_b)?);
    let (camera_a, camera_b) = images::cameras(r.camera_a.as_ref(), r.camera_b.as_ref())?;
    let found = multiview::estimate_two_view(&a, &b, &camera_a, &camera_b, &images::ransac(r.ransac.as_ref()));
    Ok(images::two_view_to(&found.map_err(ops::multiview_error)?))
}

fn triangulate_points(_: &Toolbox, r: v1::TriangulatePointsRequest) -> Result<v1::TriangulatePointsResponse> {
    Ok(images::triangulated_to(&ops::triangulate_points(&images::views(&r)?)?))
}

fn solve_pnp(_: &Toolbox, r: v1::SolvePnpRequest) -> Result<v1::SolvePnpResponse> {
    let (points, pixels) = (images::points("points", &r.points)?, images::pixels("pixels", &r.pixels)?);
    let camera = images::camera("camera", r.camera.as_ref())?;
    let found = multiview::solve_pnp(&points, &pixels, &camera, &images::ransac(r.ransac.as_ref()));
    Ok(images::pnp_to(&found.map_err(ops::multiview_error)?))
}

//! The table of routes: which request is which rpc. The router and the OpenAPI document are made from it.

use super::super::grpc::Api;
use super::super::status;
use super::calls::{
    Call, asked, call, collect, decode, join_cloud, join_download, join_grid, join_trajectory, joined, parts, tagged,
    unary,
};
use super::fields;
use super::refused::Refused;
use axum::http::request::Parts;
use axum::http::{Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::future::BoxFuture;
use percept_geometry::Timestamp;
use percept_service::reason;
use percept_service::{CallContext, Error};
use percept_wire::convert::scene;
use percept_wire::parts::InParts;
use percept_wire::{json, v1};
use prost::Message;
use prost_reflect::MethodDescriptor;
use tonic::Status;
use v1::detectors_service_server::DetectorsService;
use v1::evaluation_service_server::EvaluationService;
use v1::layers_service_server::LayersService;
use v1::maps_service_server::MapsService;
use v1::navigation_service_server::NavigationService;
use v1::operations_service_server::OperationsService;
use v1::scene_service_server::SceneService;
use v1::sensors_service_server::SensorsService;
use v1::server_service_server::ServerService;
use v1::sessions_service_server::SessionsService;
use v1::toolbox_clouds_service_server::ToolboxCloudsService;
use v1::toolbox_depth_service_server::ToolboxDepthService;
use v1::toolbox_images_service_server::ToolboxImagesService;
use v1::toolbox_kept_clouds_service_server::ToolboxKeptCloudsService;
use v1::toolbox_pictures_service_server::ToolboxPicturesService;
use v1::toolbox_pipelines_service_server::ToolboxPipelinesService;
use v1::toolbox_planning_service_server::ToolboxPlanningService;
use v1::toolbox_registration_service_server::ToolboxRegistrationService;
use v1::toolbox_segmentation_service_server::ToolboxSegmentationService;
use v1::toolbox_shapes_service_server::ToolboxShapesService;

/// The tag of the resource in an encoded response.
pub(super) type Tag = fn(&[u8]) -> Option<String>;

/// HTTP methods in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Verb {
    Get,
    Post,
    Patch,
    Delete,
}

impl Verb {
    /// As OpenAPI spells it.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Get => "get",
            Self::Post => "post",
            Self::Patch => "patch",
            Self::Delete => "delete",
        }
    }
}

/// How a route answers.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    /// The response message; of a stream, its messages joined into one.
    Message(Call),
    /// The same, with the tag of what is in it as its entity tag.
    Tagged(Call, Tag),
    /// The same, or Graphviz.
    SceneGraph(Call),
    /// The picture that the response message begins with, or all of it where a message is asked for.
    Picture(Call),
    /// Server-sent events.
    Events,
    /// The same, of all sessions.
    FleetEvents,
    /// What is told of a path that is watched, as server-sent events.
    PathEvents,
    /// A file.
    File,
    /// What an operation found: a file, or a message.
    OperationResult,
}

/// A route. A `POST` carries the request message as its body, a `PATCH` the resource in it, the others say it in the query.
pub(super) struct Route {
    pub(super) verb: Verb,
    pub(super) path: &'static str,
    /// `Service/Method` in `percept.v1`.
    pub(super) rpc: &'static str,
    /// Path parameters and the dotted field of the request that each one fills.
    pub(super) fill: &'static [(&'static str, &'static str)],
    pub(super) kind: Kind,
    /// The field that the body of a `PATCH` is.
    pub(super) body: &'static str,
}

/// A route with its rpc of the contract.
pub(super) struct Bound {
    pub(super) route: &'static Route,
    pub(super) rpc: MethodDescriptor,
}

impl Bound {
    /// All routes.
    ///
    /// # Errors
    /// `INTERNAL` if the table names an rpc that the contract does not have.
    pub(super) fn all() -> Result<Vec<Self>, Error> {
        let find = |name: &str| {
            let (service, method) = name.split_once('/')?;
            let service = json::pool().get_service_by_name(&format!("percept.v1.{service}"))?;
            service.methods().find(|m| m.name() == method)
        };
        let bind = |route: &'static Route| {
            let rpc =
                find(route.rpc).ok_or_else(|| Error::internal(format!("no rpc {} in the contract", route.rpc)))?;
            Ok(Self { route, rpc })
        };
        ROUTES.iter().map(bind).collect()
    }
}

impl Route {
    /// Names that may stand in the query: the request's scalars that the path does not fill.
    pub(super) fn query_fields(&self, rpc: &MethodDescriptor) -> Vec<String> {
        let mut names = match self.kind {
            _ if matches!(self.verb, Verb::Post | Verb::Patch) => vec![],
            _ => fields::leaves(&rpc.input()).into_iter().map(|(path, _)| path).collect(),
        };
        names.retain(|name| !self.fill.iter().any(|(_, field)| field == name));
        if matches!(self.kind, Kind::File) {
            // It is the file's name.
            names.retain(|name| name != "format");
        }
        if matches!(self.kind, Kind::SceneGraph(_)) {
            names.push("format".to_owned());
        }
        names
    }
}

/// Whether the scene graph is asked for in Graphviz's language.
pub(super) fn wants_dot(parts: &Parts) -> Result<bool, Refused> {
    let form = fields::form(&parts.uri as &Uri)?;
    let accepted = parts.headers.get(header::ACCEPT).and_then(|v| v.to_str().ok()).unwrap_or_default();
    match form.as_deref() {
        Some("dot") => Ok(true),
        Some("json") => Ok(false),
        None => Ok(accepted.contains("text/vnd.graphviz")),
        Some(other) => {
            let shown: String = other.chars().take(80).collect();
            let message = format!("format is {shown:?}; it must be json or dot");
            Err(Error::invalid(reason::QUERY_INVALID, "format", message).into())
        }
    }
}

/// The scene graph in Graphviz's language.
pub(super) async fn scene_as_dot(api: &Api, context: CallContext, request: Bytes) -> Result<Response, Refused> {
    let request: v1::GetSceneGraphRequest = decode(request)?;
    let caller = api.service.caller(context)?;
    // Who may not ask learns nothing of what is wrong with the question.
    caller.snapshot("SceneService/GetSceneGraph", &request.session_id).await?;
    let whose = scene::directions(request.directions, request.viewer_yaw_rad)?;
    let filter = scene::filter(request.filter.as_ref())?;
    let since_at = (request.since_ns.map(Timestamp), request.at_ns.map(Timestamp));
    let graph = caller.scene_graph(&request.session_id, whose, filter, since_at).await?;
    Ok(([(header::CONTENT_TYPE, "text/vnd.graphviz; charset=utf-8")], graph.to_dot()).into_response())
}

const SESSION: &[(&str, &str)] = &[("session_id", "session_id")];
const OF_SESSION: &[(&str, &str)] = &[("session_id", "session.session_id")];
const RECORDING: &[(&str, &str)] = &[("session_id", "session_id"), ("recording_id", "recording_id")];
const ROOM: &[(&str, &str)] = &[("session_id", "session_id"), ("room_id", "room_id")];
const SENSOR: &[(&str, &str)] = &[("session_id", "session_id"), ("sensor_id", "sensor_id")];
const OF_SENSOR: &[(&str, &str)] = &[("session_id", "session_id"), ("sensor_id", "spec.sensor_id")];
const SOURCE: &[(&str, &str)] = &[("session_id", "source.session_id")];
const MESSAGE: &[(&str, &str)] = &[("session_id", "message.session_id")];
const CLOUD: &[(&str, &str)] = &[("handle", "handle")];
const OPERATION: &[(&str, &str)] = &[("operation_id", "operation_id")];
const OBJECT: &[(&str, &str)] = &[("session_id", "session_id"), ("object_id", "object_id")];
const CLASS: &[(&str, &str)] = &[("session_id", "session_id"), ("label", "label")];
const DETECTOR: &[(&str, &str)] = &[("name", "name")];
const LOOP: &[(&str, &str)] = &[("session_id", "source.session_id"), ("loop_id", "loop_id")];

const fn get(
    path: &'static str,
    rpc: &'static str,
    fill: &'static [(&'static str, &'static str)],
    kind: Kind,
) -> Route {
    Route { verb: Verb::Get, path, rpc, fill, kind, body: "" }
}

const fn post(
    path: &'static str,
    rpc: &'static str,
    fill: &'static [(&'static str, &'static str)],
    kind: Kind,
) -> Route {
    Route { verb: Verb::Post, path, rpc, fill, kind, body: "" }
}

const fn delete(
    path: &'static str,
    rpc: &'static str,
    fill: &'static [(&'static str, &'static str)],
    kind: Kind,
) -> Route {
    Route { verb: Verb::Delete, path, rpc, fill, kind, body: "" }
}

const fn patch(
    path: &'static str,
    rpc: &'static str,
    fill: &'static [(&'static str, &'static str)],
    body: &'static str,
    kind: Kind,
) -> Route {
    Route { verb: Verb::Patch, path, rpc, fill, kind, body }
}

/// Every route that is an rpc. `StreamFrames` and `UploadLargeCloud` have none: a stream in needs gRPC, or zenoh.
#[rustfmt::skip]
pub(super) static ROUTES: &[Route] = &[
    get("/v1/server", "ServerService/GetServerInfo", &[], unary!(Message get_server_info)),

    post("/v1/sessions", "SessionsService/CreateSession", &[], tagged!(create_session, CreateSessionResponse, session)),
    get("/v1/sessions", "SessionsService/ListSessions", &[], unary!(Message list_sessions)),
    get("/v1/sessions/{session_id}", "SessionsService/GetSession", SESSION, tagged!(get_session, GetSessionResponse, session)),
    patch("/v1/sessions/{session_id}", "SessionsService/UpdateSession", OF_SESSION, "session", tagged!(update_session, UpdateSessionResponse, session)),
    delete("/v1/sessions/{session_id}", "SessionsService/DeleteSession", SESSION, unary!(Message delete_session)),
    get("/v1/sessions/{session_id}/pose", "SessionsService/GetPose", SESSION, unary!(Message get_pose)),
    post("/v1/sessions/{session_id}/pose", "SessionsService/SetPose", SESSION, unary!(Message set_pose)),
    get("/v1/sessions/{session_id}/transform", "SessionsService/LookupTransform", SESSION, unary!(Message lookup_transform)),
    get("/v1/sessions/{session_id}/trajectory", "SessionsService/GetTrajectory", SESSION, joined!(get_trajectory, join_trajectory)),
    get("/v1/sessions/{session_id}/keyframes", "SessionsService/ListKeyframes", SESSION, unary!(Message list_keyframes)),
    get("/v1/sessions/{session_id}/events", "SessionsService/WatchSession", SESSION, Kind::Events),
    get("/v1/events", "SessionsService/WatchSessions", &[], Kind::FleetEvents),
    post("/v1/sessions/{session_id}/recordings/start", "SessionsService/StartRecording", SESSION, unary!(Message start_recording)),
    post("/v1/sessions/{session_id}/recordings/stop", "SessionsService/StopRecording", SESSION, unary!(Message stop_recording)),
    get("/v1/sessions/{session_id}/recordings", "SessionsService/ListRecordings", SESSION, unary!(Message list_recordings)),
    delete("/v1/sessions/{session_id}/recordings/{recording_id}", "SessionsService/DeleteRecording", RECORDING, unary!(Message delete_recording)),
    get("/v1/default-params", "SessionsService/GetDefaultParams", &[], unary!(Message get_default_params)),

    post("/v1/sessions/{session_id}/sensors", "SensorsService/DeclareSensor", SESSION, tagged!(declare_sensor, DeclareSensorResponse, sensor)),
    get("/v1/sessions/{session_id}/sensors/{sensor_id}", "SensorsService/GetSensor", SENSOR, tagged!(get_sensor, GetSensorResponse, sensor)),
    patch("/v1/sessions/{session_id}/sensors/{sensor_id}", "SensorsService/UpdateSensor", OF_SENSOR, "spec", tagged!(update_sensor, UpdateSensorResponse, sensor)),
    get("/v1/sessions/{session_id}/sensors", "SensorsService/ListSensors", SESSION, unary!(Message list_sensors)),
    post("/v1/sessions/{session_id}/frames", "SensorsService/SendFrame", MESSAGE, unary!(Message send_frame)),
    get("/v1/time-sync", "SensorsService/SyncTime", &[], unary!(Message sync_time)),

    get("/v1/sessions/{session_id}/map", "MapsService/GetMapSummary", SOURCE, unary!(Message get_map_summary)),
    get("/v1/sessions/{session_id}/map/occupancy", "MapsService/GetOccupancyGrid", SOURCE, joined!(get_occupancy_grid, join_grid)),
    get("/v1/sessions/{session_id}/map/cloud", "MapsService/GetCloud", SOURCE, joined!(get_cloud, join_cloud)),
    get("/v1/sessions/{session_id}/map/loops", "MapsService/ListLoops", SOURCE, unary!(Message list_loops)),
    post("/v1/sessions/{session_id}/map/loops/{loop_id}/veto", "MapsService/SetLoopVeto", LOOP, unary!(Message set_loop_veto)),
    post("/v1/sessions/{session_id}/map/optimise", "MapsService/OptimiseMap", SOURCE, unary!(Message optimise_map)),
    post("/v1/sessions/{session_id}/map/import", "MapsService/ImportMap", SOURCE, unary!(Message import_map)),
    post("/v1/sessions/{session_id}/map/compare", "MapsService/CompareMaps", SOURCE, parts!(Picture compare_maps)),
    get("/v1/sessions/{session_id}/map/files/{name}", "MapsService/ExportMap", SOURCE, Kind::File),

    get("/v1/sessions/{session_id}/map/voxels", "LayersService/GetVoxels", SOURCE, parts!(Message get_voxels)),
    post("/v1/sessions/{session_id}/map/points", "LayersService/QueryPoints", SOURCE, parts!(Message query_points)),
    post("/v1/sessions/{session_id}/map/rays", "LayersService/CastRays", SOURCE, parts!(Message cast_rays)),
    post("/v1/sessions/{session_id}/map/boxes", "LayersService/CheckBoxes", SOURCE, parts!(Message check_boxes)),
    get("/v1/sessions/{session_id}/map/heights", "LayersService/GetHeights", SOURCE, parts!(Message get_heights)),
    get("/v1/sessions/{session_id}/map/mesh", "LayersService/GetMesh", SOURCE, parts!(Message get_mesh)),
    get("/v1/sessions/{session_id}/map/changes", "LayersService/GetChanges", SOURCE, parts!(Message get_changes)),

    get("/v1/sessions/{session_id}/objects", "SceneService/ListObjects", SESSION, unary!(Message list_objects)),
    get("/v1/sessions/{session_id}/objects/{object_id}", "SceneService/GetObject", OBJECT, unary!(Message get_object)),
    post("/v1/sessions/{session_id}/objects/{object_id}/correct", "SceneService/CorrectObject", OBJECT, unary!(Message correct_object)),
    get("/v1/sessions/{session_id}/object-classes", "SceneService/ListObjectClasses", SESSION, unary!(Message list_object_classes)),
    delete("/v1/sessions/{session_id}/object-classes/{label}", "SceneService/ForgetObjectClass", CLASS, unary!(Message forget_object_class)),
    get("/v1/sessions/{session_id}/scene-graph", "SceneService/GetSceneGraph", SESSION, parts!(SceneGraph get_scene_graph)),
    get("/v1/sessions/{session_id}/rooms", "SceneService/GetRooms", SESSION, parts!(Message get_rooms)),
    post("/v1/sessions/{session_id}/rooms/{room_id}/name", "SceneService/NameRoom", ROOM, unary!(Message name_room)),
    post("/v1/sessions/{session_id}/route", "SceneService/RouteToRoom", SESSION, unary!(Message route_to_room)),

    post("/v1/sessions/{session_id}/plan", "NavigationService/PlanPath", SOURCE, unary!(Message plan_path)),
    post("/v1/sessions/{session_id}/draw-path", "NavigationService/DrawPath", SOURCE, parts!(Picture draw_path)),
    get("/v1/sessions/{session_id}/watch-path", "NavigationService/WatchPath", SOURCE, Kind::PathEvents),
    post("/v1/sessions/{session_id}/plan-coverage", "NavigationService/PlanCoverage", SOURCE, unary!(Message plan_coverage)),
    post("/v1/sessions/{session_id}/frontiers", "NavigationService/FindFrontiers", SOURCE, unary!(Message find_frontiers)),
    post("/v1/sessions/{session_id}/plan-flight", "NavigationService/PlanFlight", SOURCE, unary!(Message plan_flight)),
    post("/v1/sessions/{session_id}/validate-path", "NavigationService/ValidatePath", SOURCE, unary!(Message validate_path)),
    post("/v1/sessions/{session_id}/navigate", "NavigationService/Navigate", MESSAGE, unary!(Message navigate)),

    post("/v1/toolbox/clouds", "ToolboxKeptCloudsService/UploadCloud", &[], unary!(Message upload_cloud)),
    get("/v1/toolbox/clouds", "ToolboxKeptCloudsService/ListClouds", &[], parts!(Message list_clouds)),
    get("/v1/toolbox/clouds/{handle}", "ToolboxKeptCloudsService/DownloadCloud", CLOUD, joined!(download_cloud, join_download)),
    delete("/v1/toolbox/clouds/{handle}", "ToolboxKeptCloudsService/DropCloud", CLOUD, unary!(Message drop_cloud)),
    post("/v1/toolbox/run-pipeline", "ToolboxPipelinesService/RunPipeline", &[], parts!(Message run_pipeline)),
    post("/v1/toolbox/plan-on-map", "ToolboxPlanningService/PlanOnMap", &[], unary!(Message plan_on_map)),
    post("/v1/toolbox/validate-on-map", "ToolboxPlanningService/ValidateOnMap", &[], unary!(Message validate_on_map)),
    post("/v1/toolbox/draw-path-on-map", "ToolboxPlanningService/DrawPathOnMap", &[], parts!(Picture draw_path_on_map)),
    post("/v1/toolbox/decode-cloud", "ToolboxCloudsService/DecodeCloud", &[], parts!(Message decode_cloud)),
    post("/v1/toolbox/encode-cloud", "ToolboxCloudsService/EncodeCloud", &[], parts!(Message encode_cloud)),
    post("/v1/toolbox/convert-depth", "ToolboxDepthService/ConvertDepth", &[], parts!(Message convert_depth)),
    post("/v1/toolbox/convert-colour", "ToolboxDepthService/ConvertColour", &[], parts!(Message convert_colour)),
    post("/v1/toolbox/remove-non-finite", "ToolboxCloudsService/RemoveNonFinite", &[], parts!(Message remove_non_finite)),
    post("/v1/toolbox/transform-cloud", "ToolboxCloudsService/TransformCloud", &[], parts!(Message transform_cloud)),
    post("/v1/toolbox/remove-radius-outliers", "ToolboxCloudsService/RemoveRadiusOutliers", &[], parts!(Message remove_radius_outliers)),
    post("/v1/toolbox/remove-statistical-outliers", "ToolboxCloudsService/RemoveStatisticalOutliers", &[], parts!(Message remove_statistical_outliers)),
    post("/v1/toolbox/downsample-voxels", "ToolboxCloudsService/DownsampleVoxels", &[], parts!(Message downsample_voxels)),
    post("/v1/toolbox/estimate-normals", "ToolboxCloudsService/EstimateNormals", &[], parts!(Message estimate_normals)),
    post("/v1/toolbox/segment-planes", "ToolboxSegmentationService/SegmentPlanes", &[], parts!(Message segment_planes)),
    post("/v1/toolbox/cluster-points", "ToolboxSegmentationService/ClusterPoints", &[], parts!(Message cluster_points)),
    post("/v1/toolbox/compute-shape-features", "ToolboxShapesService/ComputeShapeFeatures", &[], unary!(Message compute_shape_features)),
    post("/v1/toolbox/detect-objects", "ToolboxSegmentationService/DetectObjects", &[], parts!(Message detect_objects)),
    post("/v1/toolbox/register-clouds", "ToolboxRegistrationService/RegisterClouds", &[], unary!(Message register_clouds)),
    post(
        "/v1/toolbox/register-clouds-globally",
        "ToolboxRegistrationService/RegisterCloudsGlobally",
        &[],
        unary!(Message register_clouds_globally),
    ),
    post(
        "/v1/toolbox/compute-point-features",
        "ToolboxRegistrationService/ComputePointFeatures",
        &[],
        parts!(Message compute_point_features),
    ),
    post("/v1/toolbox/unproject-depth", "ToolboxDepthService/UnprojectDepth", &[], parts!(Message unproject_depth)),
    post("/v1/toolbox/estimate-essential", "ToolboxImagesService/EstimateEssential", &[], parts!(Message estimate_essential)),
    post("/v1/toolbox/estimate-homography", "ToolboxImagesService/EstimateHomography", &[], parts!(Message estimate_homography)),
    post("/v1/toolbox/estimate-two-view", "ToolboxImagesService/EstimateTwoView", &[], parts!(Message estimate_two_view)),
    post("/v1/toolbox/triangulate-points", "ToolboxImagesService/TriangulatePoints", &[], parts!(Message triangulate_points)),
    post("/v1/toolbox/detect-in-image", "ToolboxImagesService/DetectInImage", &[], parts!(Message detect_in_image)),
    get("/v1/toolbox/image-detectors", "ToolboxImagesService/ListImageDetectors", &[], parts!(Message list_image_detectors)),
    post("/v1/toolbox/solve-pnp", "ToolboxImagesService/SolvePnp", &[], parts!(Message solve_pnp)),
    post("/v1/toolbox/render-cloud", "ToolboxPicturesService/RenderCloud", &[], parts!(Message render_cloud)),
    post("/v1/toolbox/render-depth", "ToolboxPicturesService/RenderDepth", &[], parts!(Message render_depth)),
    post("/v1/toolbox/segment-ground", "ToolboxSegmentationService/SegmentGround", &[], parts!(Message segment_ground)),
    post("/v1/toolbox/grow-regions", "ToolboxSegmentationService/GrowRegions", &[], parts!(Message grow_regions)),
    post("/v1/toolbox/compute-supervoxels", "ToolboxSegmentationService/ComputeSupervoxels", &[], parts!(Message compute_supervoxels)),
    post("/v1/toolbox/group-convex", "ToolboxSegmentationService/GroupConvex", &[], parts!(Message group_convex)),
    post("/v1/toolbox/segment-objects", "ToolboxSegmentationService/SegmentObjects", &[], parts!(Message segment_objects)),
    post("/v1/toolbox/sample-points", "ToolboxCloudsService/SamplePoints", &[], parts!(Message sample_points)),
    post("/v1/toolbox/crop-cloud", "ToolboxCloudsService/CropCloud", &[], parts!(Message crop_cloud)),
    post("/v1/toolbox/find-neighbours", "ToolboxShapesService/FindNeighbours", &[], parts!(Message find_neighbours)),
    post("/v1/toolbox/compute-local-features", "ToolboxShapesService/ComputeLocalFeatures", &[], parts!(Message compute_local_features)),
    post("/v1/toolbox/fit-boxes", "ToolboxShapesService/FitBoxes", &[], unary!(Message fit_boxes)),
    post("/v1/toolbox/compute-convex-hull", "ToolboxShapesService/ComputeConvexHull", &[], parts!(Message compute_convex_hull)),
    post("/v1/toolbox/extract-features", "ToolboxImagesService/ExtractFeatures", &[], parts!(Message extract_features)),
    post("/v1/toolbox/match-features", "ToolboxImagesService/MatchFeatures", &[], parts!(Message match_features)),
    post("/v1/toolbox/filter-depth", "ToolboxDepthService/FilterDepth", &[], parts!(Message filter_depth)),
    post("/v1/toolbox/compute-depth-normals", "ToolboxDepthService/ComputeDepthNormals", &[], parts!(Message compute_depth_normals)),
    post("/v1/toolbox/segment-depth-planes", "ToolboxDepthService/SegmentDepthPlanes", &[], parts!(Message segment_depth_planes)),
    post("/v1/toolbox/find-depth-edges", "ToolboxDepthService/FindDepthEdges", &[], parts!(Message find_depth_edges)),
    post("/v1/toolbox/register-colour", "ToolboxDepthService/RegisterColour", &[], parts!(Message register_colour)),

    post("/v1/detectors", "DetectorsService/UploadDetector", &[], unary!(Message upload_detector)),
    get("/v1/detectors", "DetectorsService/ListDetectors", &[], parts!(Message list_detectors)),
    delete("/v1/detectors/{name}", "DetectorsService/DeleteDetector", DETECTOR, unary!(Message delete_detector)),

    post("/v1/operations", "OperationsService/StartOperation", &[], unary!(Message start_operation)),
    get("/v1/operations", "OperationsService/ListOperations", &[], unary!(Message list_operations)),
    get("/v1/operations/{operation_id}", "OperationsService/GetOperation", OPERATION, unary!(Message get_operation)),
    get("/v1/operations/{operation_id}/wait", "OperationsService/WaitOperation", OPERATION, unary!(Message wait_operation)),
    get("/v1/operations/{operation_id}/result", "OperationsService/ReadOperationResult", OPERATION, Kind::OperationResult),
    post("/v1/operations/{operation_id}/cancel", "OperationsService/CancelOperation", OPERATION, unary!(Message cancel_operation)),
    delete("/v1/operations/{operation_id}", "OperationsService/DeleteOperation", OPERATION, unary!(Message delete_operation)),

    post("/v1/evaluation/trajectory", "EvaluationService/EvaluateTrajectory", &[], parts!(Message evaluate_trajectory)),
    post("/v1/evaluation/relations", "EvaluationService/EvaluateRelations", &[], unary!(Message evaluate_relations)),
    post("/v1/evaluation/detections", "EvaluationService/EvaluateDetections", &[], unary!(Message evaluate_detections)),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn no_route_stands_twice() {
        let routes: BTreeSet<_> = ROUTES.iter().map(|r| (r.verb, r.path)).collect();
        let rpcs: BTreeSet<_> = ROUTES.iter().map(|r| r.rpc).collect();
        assert_eq!((routes.len(), rpcs.len()), (ROUTES.len(), ROUTES.len()));
    }

    #[test]
    fn every_rpc_but_the_stream_in_is_reachable() {
        let routed: BTreeSet<String> = ROUTES.iter().map(|r| r.rpc.to_owned()).collect();
        let rpcs = json::pool().services().flat_map(|s| {
            s.methods()
                .map(move |m| (m.is_client_streaming(), format!("{}/{}", m.parent_service().name(), m.name())))
                .collect::<Vec<_>>()
        });
        let wanted: BTreeSet<String> = rpcs.filter(|(stream_in, _)| !stream_in).map(|(_, name)| name).collect();
        assert!(wanted.len() > 25);
        assert_eq!(routed, wanted);
    }

    #[test]
    fn every_path_parameter_fills_a_field_that_exists() {
        for bound in Bound::all().unwrap() {
            let leaves: BTreeSet<String> =
                fields::leaves(&bound.rpc.input()).into_iter().map(|(path, _)| path).collect();
            for (name, field) in bound.route.fill {
                assert!(bound.route.path.contains(&format!("{{{name}}}")), "{}", bound.route.path);
                assert!(leaves.contains(*field), "{}: {field}", bound.route.path);
            }
        }
    }
}

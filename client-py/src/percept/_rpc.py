"""Every call of the contract, with its messages and whether it may be repeated without harm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from google.protobuf.message import Message

from .v1 import detectors_service_pb2 as detectors
from .v1 import evaluation_service_pb2 as evaluation
from .v1 import layers_service_pb2 as layers
from .v1 import maps_service_pb2 as maps
from .v1 import navigation_service_pb2 as navigation
from .v1 import operations_service_pb2 as operations
from .v1 import scene_service_pb2 as scene
from .v1 import sensors_service_pb2 as sensors
from .v1 import sessions_service_pb2 as sessions
from .v1 import toolbox_clouds_service_pb2 as clouds
from .v1 import toolbox_depth_service_pb2 as depth
from .v1 import toolbox_images_service_pb2 as images
from .v1 import toolbox_kept_clouds_service_pb2 as kept_clouds
from .v1 import toolbox_pictures_service_pb2 as pictures
from .v1 import toolbox_pipelines_service_pb2 as pipelines
from .v1 import toolbox_planning_service_pb2 as planning
from .v1 import toolbox_registration_service_pb2 as registration
from .v1 import toolbox_segmentation_service_pb2 as segmentation
from .v1 import toolbox_shapes_service_pb2 as shapes

Q = TypeVar("Q", bound=Message)
A = TypeVar("A", bound=Message)


@dataclass(frozen=True)
class Rpc(Generic[Q, A]):
    """A remote procedure: its name and the types of its messages."""

    service: str
    method: str
    request: type[Q]
    answer: type[A]
    #: Whether doing it twice is as good as once, so that it is tried again when the server is away.
    repeatable: bool = True
    #: Whether the answer comes in parts that are read as one.
    in_parts: bool = False

    @property
    def path(self) -> str:
        """As HTTP/2 carries it."""
        return f"/percept.v1.{self.service}/{self.method}"


_S = "SessionsService"
# Creation carries a request id, so that it can be repeated.
CREATE_SESSION = Rpc(_S, "CreateSession", sessions.CreateSessionRequest, sessions.CreateSessionResponse)
GET_SESSION = Rpc(_S, "GetSession", sessions.GetSessionRequest, sessions.GetSessionResponse)
LIST_SESSIONS = Rpc(_S, "ListSessions", sessions.ListSessionsRequest, sessions.ListSessionsResponse)
DELETE_SESSION = Rpc(
    _S, "DeleteSession", sessions.DeleteSessionRequest, sessions.DeleteSessionResponse, repeatable=False
)
# Done twice with an etag, it finds what it did itself.
UPDATE_SESSION = Rpc(
    _S, "UpdateSession", sessions.UpdateSessionRequest, sessions.UpdateSessionResponse, repeatable=False
)
START_RECORDING = Rpc(_S, "StartRecording", sessions.StartRecordingRequest, sessions.StartRecordingResponse)
STOP_RECORDING = Rpc(_S, "StopRecording", sessions.StopRecordingRequest, sessions.StopRecordingResponse)
LIST_RECORDINGS = Rpc(_S, "ListRecordings", sessions.ListRecordingsRequest, sessions.ListRecordingsResponse)
DELETE_RECORDING = Rpc(
    _S,
    "DeleteRecording",
    sessions.DeleteRecordingRequest,
    sessions.DeleteRecordingResponse,
    repeatable=False,
)
GET_POSE = Rpc(_S, "GetPose", sessions.GetPoseRequest, sessions.GetPoseResponse)
SET_POSE = Rpc(_S, "SetPose", sessions.SetPoseRequest, sessions.SetPoseResponse)
LOOKUP_TRANSFORM = Rpc(
    _S, "LookupTransform", sessions.LookupTransformRequest, sessions.LookupTransformResponse
)
GET_TRAJECTORY = Rpc(_S, "GetTrajectory", sessions.GetTrajectoryRequest, sessions.GetTrajectoryResponse)
LIST_KEYFRAMES = Rpc(_S, "ListKeyframes", sessions.ListKeyframesRequest, sessions.ListKeyframesResponse)
WATCH_SESSION = Rpc(_S, "WatchSession", sessions.WatchSessionRequest, sessions.WatchSessionResponse)
WATCH_SESSIONS = Rpc(_S, "WatchSessions", sessions.WatchSessionsRequest, sessions.WatchSessionsResponse)
GET_DEFAULT_PARAMS = Rpc(
    _S, "GetDefaultParams", sessions.GetDefaultParamsRequest, sessions.GetDefaultParamsResponse
)

_N = "SensorsService"
DECLARE_SENSOR = Rpc(_N, "DeclareSensor", sensors.DeclareSensorRequest, sensors.DeclareSensorResponse)
GET_SENSOR = Rpc(_N, "GetSensor", sensors.GetSensorRequest, sensors.GetSensorResponse)
UPDATE_SENSOR = Rpc(
    _N, "UpdateSensor", sensors.UpdateSensorRequest, sensors.UpdateSensorResponse, repeatable=False
)
LIST_SENSORS = Rpc(_N, "ListSensors", sensors.ListSensorsRequest, sensors.ListSensorsResponse)
STREAM_FRAMES = Rpc(
    _N, "StreamFrames", sensors.StreamFramesRequest, sensors.StreamFramesResponse, repeatable=False
)
# A frame that was taken in before is answered as such.
SEND_FRAME = Rpc(_N, "SendFrame", sensors.SendFrameRequest, sensors.SendFrameResponse)
SYNC_TIME = Rpc(_N, "SyncTime", sensors.SyncTimeRequest, sensors.SyncTimeResponse)

_M = "MapsService"
GET_MAP_SUMMARY = Rpc(_M, "GetMapSummary", maps.GetMapSummaryRequest, maps.GetMapSummaryResponse)
GET_OCCUPANCY_GRID = Rpc(_M, "GetOccupancyGrid", maps.GetOccupancyGridRequest, maps.GetOccupancyGridResponse)
GET_CLOUD = Rpc(_M, "GetCloud", maps.GetCloudRequest, maps.GetCloudResponse)
EXPORT_MAP = Rpc(_M, "ExportMap", maps.ExportMapRequest, maps.ExportMapResponse)
LIST_LOOPS = Rpc(_M, "ListLoops", maps.ListLoopsRequest, maps.ListLoopsResponse)
IMPORT_MAP = Rpc(_M, "ImportMap", maps.ImportMapRequest, maps.ImportMapResponse)
OPTIMISE_MAP = Rpc(_M, "OptimiseMap", maps.OptimiseMapRequest, maps.OptimiseMapResponse)
COMPARE_MAPS = Rpc(_M, "CompareMaps", maps.CompareMapsRequest, maps.CompareMapsResponse, in_parts=True)
SET_LOOP_VETO = Rpc(_M, "SetLoopVeto", maps.SetLoopVetoRequest, maps.SetLoopVetoResponse)

_Y = "LayersService"
GET_VOXELS = Rpc(_Y, "GetVoxels", layers.GetVoxelsRequest, layers.GetVoxelsResponse, in_parts=True)
QUERY_POINTS = Rpc(_Y, "QueryPoints", layers.QueryPointsRequest, layers.QueryPointsResponse, in_parts=True)
CAST_RAYS = Rpc(_Y, "CastRays", layers.CastRaysRequest, layers.CastRaysResponse, in_parts=True)
CHECK_BOXES = Rpc(_Y, "CheckBoxes", layers.CheckBoxesRequest, layers.CheckBoxesResponse, in_parts=True)
GET_HEIGHTS = Rpc(_Y, "GetHeights", layers.GetHeightsRequest, layers.GetHeightsResponse, in_parts=True)
GET_MESH = Rpc(_Y, "GetMesh", layers.GetMeshRequest, layers.GetMeshResponse, in_parts=True)
GET_CHANGES = Rpc(_Y, "GetChanges", layers.GetChangesRequest, layers.GetChangesResponse, in_parts=True)

_C = "SceneService"
LIST_OBJECTS = Rpc(_C, "ListObjects", scene.ListObjectsRequest, scene.ListObjectsResponse)
GET_OBJECT = Rpc(_C, "GetObject", scene.GetObjectRequest, scene.GetObjectResponse)
GET_ROOMS = Rpc(_C, "GetRooms", scene.GetRoomsRequest, scene.GetRoomsResponse, in_parts=True)
CORRECT_OBJECT = Rpc(_C, "CorrectObject", scene.CorrectObjectRequest, scene.CorrectObjectResponse)
LIST_OBJECT_CLASSES = Rpc(
    _C, "ListObjectClasses", scene.ListObjectClassesRequest, scene.ListObjectClassesResponse
)
FORGET_OBJECT_CLASS = Rpc(
    _C, "ForgetObjectClass", scene.ForgetObjectClassRequest, scene.ForgetObjectClassResponse
)
NAME_ROOM = Rpc(_C, "NameRoom", scene.NameRoomRequest, scene.NameRoomResponse)
ROUTE_TO_ROOM = Rpc(_C, "RouteToRoom", scene.RouteToRoomRequest, scene.RouteToRoomResponse)
GET_SCENE_GRAPH = Rpc(
    _C, "GetSceneGraph", scene.GetSceneGraphRequest, scene.GetSceneGraphResponse, in_parts=True
)

_V = "NavigationService"
PLAN_COVERAGE = Rpc(_V, "PlanCoverage", navigation.PlanCoverageRequest, navigation.PlanCoverageResponse)
FIND_FRONTIERS = Rpc(_V, "FindFrontiers", navigation.FindFrontiersRequest, navigation.FindFrontiersResponse)
PLAN_FLIGHT = Rpc(_V, "PlanFlight", navigation.PlanFlightRequest, navigation.PlanFlightResponse)
PLAN_PATH = Rpc(_V, "PlanPath", navigation.PlanPathRequest, navigation.PlanPathResponse)
DRAW_PATH = Rpc(_V, "DrawPath", navigation.DrawPathRequest, navigation.DrawPathResponse, in_parts=True)
VALIDATE_PATH = Rpc(_V, "ValidatePath", navigation.ValidatePathRequest, navigation.ValidatePathResponse)
WATCH_PATH = Rpc(_V, "WatchPath", navigation.WatchPathRequest, navigation.WatchPathResponse)
NAVIGATE = Rpc(_V, "Navigate", navigation.NavigateRequest, navigation.NavigateResponse, repeatable=False)

_T = "ToolboxKeptCloudsService"
# Uploading twice keeps two clouds.
UPLOAD_CLOUD = Rpc(
    _T, "UploadCloud", kept_clouds.UploadCloudRequest, kept_clouds.UploadCloudResponse, repeatable=False
)
UPLOAD_LARGE_CLOUD = Rpc(
    _T,
    "UploadLargeCloud",
    kept_clouds.UploadLargeCloudRequest,
    kept_clouds.UploadLargeCloudResponse,
    repeatable=False,
)
LIST_CLOUDS = Rpc(
    _T, "ListClouds", kept_clouds.ListCloudsRequest, kept_clouds.ListCloudsResponse, in_parts=True
)
DOWNLOAD_CLOUD = Rpc(_T, "DownloadCloud", kept_clouds.DownloadCloudRequest, kept_clouds.DownloadCloudResponse)
DROP_CLOUD = Rpc(
    _T, "DropCloud", kept_clouds.DropCloudRequest, kept_clouds.DropCloudResponse, repeatable=False
)

_T = "ToolboxCloudsService"
DECODE_CLOUD = Rpc(_T, "DecodeCloud", clouds.DecodeCloudRequest, clouds.DecodeCloudResponse, in_parts=True)
ENCODE_CLOUD = Rpc(_T, "EncodeCloud", clouds.EncodeCloudRequest, clouds.EncodeCloudResponse, in_parts=True)
REMOVE_NON_FINITE = Rpc(
    _T, "RemoveNonFinite", clouds.RemoveNonFiniteRequest, clouds.RemoveNonFiniteResponse, in_parts=True
)
SAMPLE_POINTS = Rpc(
    _T, "SamplePoints", clouds.SamplePointsRequest, clouds.SamplePointsResponse, in_parts=True
)
CROP_CLOUD = Rpc(_T, "CropCloud", clouds.CropCloudRequest, clouds.CropCloudResponse, in_parts=True)
TRANSFORM_CLOUD = Rpc(
    _T, "TransformCloud", clouds.TransformCloudRequest, clouds.TransformCloudResponse, in_parts=True
)
REMOVE_RADIUS_OUTLIERS = Rpc(
    _T,
    "RemoveRadiusOutliers",
    clouds.RemoveRadiusOutliersRequest,
    clouds.RemoveRadiusOutliersResponse,
    in_parts=True,
)
REMOVE_STATISTICAL_OUTLIERS = Rpc(
    _T,
    "RemoveStatisticalOutliers",
    clouds.RemoveStatisticalOutliersRequest,
    clouds.RemoveStatisticalOutliersResponse,
    in_parts=True,
)
DOWNSAMPLE_VOXELS = Rpc(
    _T, "DownsampleVoxels", clouds.DownsampleVoxelsRequest, clouds.DownsampleVoxelsResponse, in_parts=True
)
ESTIMATE_NORMALS = Rpc(
    _T, "EstimateNormals", clouds.EstimateNormalsRequest, clouds.EstimateNormalsResponse, in_parts=True
)

_T = "ToolboxShapesService"
FIND_NEIGHBOURS = Rpc(
    _T, "FindNeighbours", shapes.FindNeighboursRequest, shapes.FindNeighboursResponse, in_parts=True
)
COMPUTE_LOCAL_FEATURES = Rpc(
    _T,
    "ComputeLocalFeatures",
    shapes.ComputeLocalFeaturesRequest,
    shapes.ComputeLocalFeaturesResponse,
    in_parts=True,
)
COMPUTE_SHAPE_FEATURES = Rpc(
    _T, "ComputeShapeFeatures", shapes.ComputeShapeFeaturesRequest, shapes.ComputeShapeFeaturesResponse
)
FIT_BOXES = Rpc(_T, "FitBoxes", shapes.FitBoxesRequest, shapes.FitBoxesResponse)
COMPUTE_CONVEX_HULL = Rpc(
    _T, "ComputeConvexHull", shapes.ComputeConvexHullRequest, shapes.ComputeConvexHullResponse, in_parts=True
)

_T = "ToolboxSegmentationService"
SEGMENT_PLANES = Rpc(
    _T, "SegmentPlanes", segmentation.SegmentPlanesRequest, segmentation.SegmentPlanesResponse, in_parts=True
)
SEGMENT_GROUND = Rpc(
    _T, "SegmentGround", segmentation.SegmentGroundRequest, segmentation.SegmentGroundResponse, in_parts=True
)
CLUSTER_POINTS = Rpc(
    _T, "ClusterPoints", segmentation.ClusterPointsRequest, segmentation.ClusterPointsResponse, in_parts=True
)
GROW_REGIONS = Rpc(
    _T, "GrowRegions", segmentation.GrowRegionsRequest, segmentation.GrowRegionsResponse, in_parts=True
)
COMPUTE_SUPERVOXELS = Rpc(
    _T,
    "ComputeSupervoxels",
    segmentation.ComputeSupervoxelsRequest,
    segmentation.ComputeSupervoxelsResponse,
    in_parts=True,
)
GROUP_CONVEX = Rpc(
    _T, "GroupConvex", segmentation.GroupConvexRequest, segmentation.GroupConvexResponse, in_parts=True
)
SEGMENT_OBJECTS = Rpc(
    _T,
    "SegmentObjects",
    segmentation.SegmentObjectsRequest,
    segmentation.SegmentObjectsResponse,
    in_parts=True,
)
DETECT_OBJECTS = Rpc(
    _T, "DetectObjects", segmentation.DetectObjectsRequest, segmentation.DetectObjectsResponse, in_parts=True
)

_T = "ToolboxRegistrationService"
REGISTER_CLOUDS = Rpc(
    _T, "RegisterClouds", registration.RegisterCloudsRequest, registration.RegisterCloudsResponse
)
REGISTER_CLOUDS_GLOBALLY = Rpc(
    _T,
    "RegisterCloudsGlobally",
    registration.RegisterCloudsGloballyRequest,
    registration.RegisterCloudsGloballyResponse,
)
COMPUTE_POINT_FEATURES = Rpc(
    _T,
    "ComputePointFeatures",
    registration.ComputePointFeaturesRequest,
    registration.ComputePointFeaturesResponse,
    in_parts=True,
)

_T = "ToolboxDepthService"
UNPROJECT_DEPTH = Rpc(
    _T, "UnprojectDepth", depth.UnprojectDepthRequest, depth.UnprojectDepthResponse, in_parts=True
)
CONVERT_DEPTH = Rpc(_T, "ConvertDepth", depth.ConvertDepthRequest, depth.ConvertDepthResponse, in_parts=True)
CONVERT_COLOUR = Rpc(
    _T, "ConvertColour", depth.ConvertColourRequest, depth.ConvertColourResponse, in_parts=True
)
FILTER_DEPTH = Rpc(_T, "FilterDepth", depth.FilterDepthRequest, depth.FilterDepthResponse, in_parts=True)
COMPUTE_DEPTH_NORMALS = Rpc(
    _T,
    "ComputeDepthNormals",
    depth.ComputeDepthNormalsRequest,
    depth.ComputeDepthNormalsResponse,
    in_parts=True,
)
SEGMENT_DEPTH_PLANES = Rpc(
    _T, "SegmentDepthPlanes", depth.SegmentDepthPlanesRequest, depth.SegmentDepthPlanesResponse, in_parts=True
)
FIND_DEPTH_EDGES = Rpc(
    _T, "FindDepthEdges", depth.FindDepthEdgesRequest, depth.FindDepthEdgesResponse, in_parts=True
)
REGISTER_COLOUR = Rpc(
    _T, "RegisterColour", depth.RegisterColourRequest, depth.RegisterColourResponse, in_parts=True
)

_T = "ToolboxImagesService"
EXTRACT_FEATURES = Rpc(
    _T, "ExtractFeatures", images.ExtractFeaturesRequest, images.ExtractFeaturesResponse, in_parts=True
)
MATCH_FEATURES = Rpc(
    _T, "MatchFeatures", images.MatchFeaturesRequest, images.MatchFeaturesResponse, in_parts=True
)
ESTIMATE_ESSENTIAL = Rpc(
    _T, "EstimateEssential", images.EstimateEssentialRequest, images.EstimateEssentialResponse, in_parts=True
)
ESTIMATE_HOMOGRAPHY = Rpc(
    _T,
    "EstimateHomography",
    images.EstimateHomographyRequest,
    images.EstimateHomographyResponse,
    in_parts=True,
)
ESTIMATE_TWO_VIEW = Rpc(
    _T, "EstimateTwoView", images.EstimateTwoViewRequest, images.EstimateTwoViewResponse, in_parts=True
)
TRIANGULATE_POINTS = Rpc(
    _T, "TriangulatePoints", images.TriangulatePointsRequest, images.TriangulatePointsResponse, in_parts=True
)
SOLVE_PNP = Rpc(_T, "SolvePnp", images.SolvePnpRequest, images.SolvePnpResponse, in_parts=True)
DETECT_IN_IMAGE = Rpc(
    _T, "DetectInImage", images.DetectInImageRequest, images.DetectInImageResponse, in_parts=True
)
LIST_IMAGE_DETECTORS = Rpc(
    _T,
    "ListImageDetectors",
    images.ListImageDetectorsRequest,
    images.ListImageDetectorsResponse,
    in_parts=True,
)

_T = "ToolboxPicturesService"
RENDER_CLOUD = Rpc(
    _T, "RenderCloud", pictures.RenderCloudRequest, pictures.RenderCloudResponse, in_parts=True
)
RENDER_DEPTH = Rpc(
    _T, "RenderDepth", pictures.RenderDepthRequest, pictures.RenderDepthResponse, in_parts=True
)

_T = "ToolboxPipelinesService"
RUN_PIPELINE = Rpc(
    _T, "RunPipeline", pipelines.RunPipelineRequest, pipelines.RunPipelineResponse, in_parts=True
)

_E = "EvaluationService"
EVALUATE_TRAJECTORY = Rpc(
    _E,
    "EvaluateTrajectory",
    evaluation.EvaluateTrajectoryRequest,
    evaluation.EvaluateTrajectoryResponse,
    in_parts=True,
)
EVALUATE_RELATIONS = Rpc(
    _E, "EvaluateRelations", evaluation.EvaluateRelationsRequest, evaluation.EvaluateRelationsResponse
)
EVALUATE_DETECTIONS = Rpc(
    _E, "EvaluateDetections", evaluation.EvaluateDetectionsRequest, evaluation.EvaluateDetectionsResponse
)

_D = "DetectorsService"
# The same model again under its name is no error.
UPLOAD_DETECTOR = Rpc(_D, "UploadDetector", detectors.UploadDetectorRequest, detectors.UploadDetectorResponse)
LIST_DETECTORS = Rpc(
    _D, "ListDetectors", detectors.ListDetectorsRequest, detectors.ListDetectorsResponse, in_parts=True
)
DELETE_DETECTOR = Rpc(
    _D, "DeleteDetector", detectors.DeleteDetectorRequest, detectors.DeleteDetectorResponse, repeatable=False
)

_O = "OperationsService"
# A start carries a request id, so that it can be repeated.
START_OPERATION = Rpc(
    _O, "StartOperation", operations.StartOperationRequest, operations.StartOperationResponse
)
GET_OPERATION = Rpc(_O, "GetOperation", operations.GetOperationRequest, operations.GetOperationResponse)
LIST_OPERATIONS = Rpc(
    _O, "ListOperations", operations.ListOperationsRequest, operations.ListOperationsResponse
)
WAIT_OPERATION = Rpc(_O, "WaitOperation", operations.WaitOperationRequest, operations.WaitOperationResponse)
CANCEL_OPERATION = Rpc(
    _O, "CancelOperation", operations.CancelOperationRequest, operations.CancelOperationResponse
)
READ_OPERATION_RESULT = Rpc(
    _O,
    "ReadOperationResult",
    operations.ReadOperationResultRequest,
    operations.ReadOperationResultResponse,
)
DELETE_OPERATION = Rpc(
    _O,
    "DeleteOperation",
    operations.DeleteOperationRequest,
    operations.DeleteOperationResponse,
    repeatable=False,
)

_L = "ToolboxPlanningService"
PLAN_ON_MAP = Rpc(_L, "PlanOnMap", planning.PlanOnMapRequest, planning.PlanOnMapResponse)
DRAW_PATH_ON_MAP = Rpc(
    _L, "DrawPathOnMap", planning.DrawPathOnMapRequest, planning.DrawPathOnMapResponse, in_parts=True
)
VALIDATE_ON_MAP = Rpc(_L, "ValidateOnMap", planning.ValidateOnMapRequest, planning.ValidateOnMapResponse)

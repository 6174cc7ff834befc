"""Every call of the contract, with its messages and whether it may be repeated without harm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from google.protobuf.message import Message

from .v1 import evaluation_service_pb2 as evaluation
from .v1 import maps_service_pb2 as maps
from .v1 import navigation_service_pb2 as navigation
from .v1 import scene_service_pb2 as scene
from .v1 import sensors_service_pb2 as sensors
from .v1 import sessions_service_pb2 as sessions
from .v1 import toolbox_depth_pb2 as toolbox_depth
from .v1 import toolbox_images_pb2 as toolbox_images
from .v1 import toolbox_pictures_pb2 as toolbox_pictures
from .v1 import toolbox_service_pb2 as toolbox

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
GET_POSE = Rpc(_S, "GetPose", sessions.GetPoseRequest, sessions.GetPoseResponse)
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
OPTIMISE_MAP = Rpc(_M, "OptimiseMap", maps.OptimiseMapRequest, maps.OptimiseMapResponse)
SET_LOOP_VETO = Rpc(_M, "SetLoopVeto", maps.SetLoopVetoRequest, maps.SetLoopVetoResponse)

_C = "SceneService"
LIST_OBJECTS = Rpc(_C, "ListObjects", scene.ListObjectsRequest, scene.ListObjectsResponse)
GET_OBJECT = Rpc(_C, "GetObject", scene.GetObjectRequest, scene.GetObjectResponse)
GET_SCENE_GRAPH = Rpc(_C, "GetSceneGraph", scene.GetSceneGraphRequest, scene.GetSceneGraphResponse)

_V = "NavigationService"
PLAN_PATH = Rpc(_V, "PlanPath", navigation.PlanPathRequest, navigation.PlanPathResponse)
NAVIGATE = Rpc(_V, "Navigate", navigation.NavigateRequest, navigation.NavigateResponse, repeatable=False)

_T = "ToolboxService"
# Uploading twice keeps two clouds.
UPLOAD_CLOUD = Rpc(
    _T, "UploadCloud", toolbox.UploadCloudRequest, toolbox.UploadCloudResponse, repeatable=False
)
UPLOAD_LARGE_CLOUD = Rpc(
    _T,
    "UploadLargeCloud",
    toolbox.UploadLargeCloudRequest,
    toolbox.UploadLargeCloudResponse,
    repeatable=False,
)
LIST_CLOUDS = Rpc(_T, "ListClouds", toolbox.ListCloudsRequest, toolbox.ListCloudsResponse)
DOWNLOAD_CLOUD = Rpc(_T, "DownloadCloud", toolbox.DownloadCloudRequest, toolbox.DownloadCloudResponse)
DROP_CLOUD = Rpc(_T, "DropCloud", toolbox.DropCloudRequest, toolbox.DropCloudResponse, repeatable=False)
RUN_PIPELINE = Rpc(_T, "RunPipeline", toolbox.RunPipelineRequest, toolbox.RunPipelineResponse)
DECODE_CLOUD = Rpc(_T, "DecodeCloud", toolbox.DecodeCloudRequest, toolbox.DecodeCloudResponse)
ENCODE_CLOUD = Rpc(_T, "EncodeCloud", toolbox.EncodeCloudRequest, toolbox.EncodeCloudResponse)
CONVERT_DEPTH = Rpc(_T, "ConvertDepth", toolbox.ConvertDepthRequest, toolbox.ConvertDepthResponse)
CONVERT_COLOR = Rpc(_T, "ConvertColor", toolbox.ConvertColorRequest, toolbox.ConvertColorResponse)
REMOVE_NON_FINITE = Rpc(
    _T, "RemoveNonFinite", toolbox.RemoveNonFiniteRequest, toolbox.RemoveNonFiniteResponse
)
TRANSFORM_CLOUD = Rpc(_T, "TransformCloud", toolbox.TransformCloudRequest, toolbox.TransformCloudResponse)
REMOVE_RADIUS_OUTLIERS = Rpc(
    _T, "RemoveRadiusOutliers", toolbox.RemoveRadiusOutliersRequest, toolbox.RemoveRadiusOutliersResponse
)
REMOVE_STATISTICAL_OUTLIERS = Rpc(
    _T,
    "RemoveStatisticalOutliers",
    toolbox.RemoveStatisticalOutliersRequest,
    toolbox.RemoveStatisticalOutliersResponse,
)
DOWNSAMPLE_VOXELS = Rpc(
    _T, "DownsampleVoxels", toolbox.DownsampleVoxelsRequest, toolbox.DownsampleVoxelsResponse
)
GROUP_CONVEX = Rpc(_T, "GroupConvex", toolbox.GroupConvexRequest, toolbox.GroupConvexResponse)
ESTIMATE_NORMALS = Rpc(_T, "EstimateNormals", toolbox.EstimateNormalsRequest, toolbox.EstimateNormalsResponse)
SEGMENT_PLANES = Rpc(_T, "SegmentPlanes", toolbox.SegmentPlanesRequest, toolbox.SegmentPlanesResponse)
CLUSTER_POINTS = Rpc(_T, "ClusterPoints", toolbox.ClusterPointsRequest, toolbox.ClusterPointsResponse)
COMPUTE_SHAPE_FEATURES = Rpc(
    _T, "ComputeShapeFeatures", toolbox.ComputeShapeFeaturesRequest, toolbox.ComputeShapeFeaturesResponse
)
DETECT_OBJECTS = Rpc(_T, "DetectObjects", toolbox.DetectObjectsRequest, toolbox.DetectObjectsResponse)
REGISTER_CLOUDS = Rpc(_T, "RegisterClouds", toolbox.RegisterCloudsRequest, toolbox.RegisterCloudsResponse)
REGISTER_CLOUDS_GLOBALLY = Rpc(
    _T,
    "RegisterCloudsGlobally",
    toolbox.RegisterCloudsGloballyRequest,
    toolbox.RegisterCloudsGloballyResponse,
)
COMPUTE_POINT_FEATURES = Rpc(
    _T, "ComputePointFeatures", toolbox.ComputePointFeaturesRequest, toolbox.ComputePointFeaturesResponse
)
UNPROJECT_DEPTH = Rpc(_T, "UnprojectDepth", toolbox.UnprojectDepthRequest, toolbox.UnprojectDepthResponse)
ESTIMATE_ESSENTIAL = Rpc(
    _T, "EstimateEssential", toolbox_images.EstimateEssentialRequest, toolbox_images.EstimateEssentialResponse
)
ESTIMATE_HOMOGRAPHY = Rpc(
    _T,
    "EstimateHomography",
    toolbox_images.EstimateHomographyRequest,
    toolbox_images.EstimateHomographyResponse,
)
ESTIMATE_TWO_VIEW = Rpc(
    _T, "EstimateTwoView", toolbox_images.EstimateTwoViewRequest, toolbox_images.EstimateTwoViewResponse
)
TRIANGULATE_POINTS = Rpc(
    _T, "TriangulatePoints", toolbox_images.TriangulatePointsRequest, toolbox_images.TriangulatePointsResponse
)
SOLVE_PNP = Rpc(_T, "SolvePnp", toolbox_images.SolvePnpRequest, toolbox_images.SolvePnpResponse)
RENDER_CLOUD = Rpc(
    _T, "RenderCloud", toolbox_pictures.RenderCloudRequest, toolbox_pictures.RenderCloudResponse
)
RENDER_DEPTH = Rpc(
    _T, "RenderDepth", toolbox_pictures.RenderDepthRequest, toolbox_pictures.RenderDepthResponse
)
SEGMENT_GROUND = Rpc(_T, "SegmentGround", toolbox.SegmentGroundRequest, toolbox.SegmentGroundResponse)
GROW_REGIONS = Rpc(_T, "GrowRegions", toolbox.GrowRegionsRequest, toolbox.GrowRegionsResponse)
COMPUTE_SUPERVOXELS = Rpc(
    _T, "ComputeSupervoxels", toolbox.ComputeSupervoxelsRequest, toolbox.ComputeSupervoxelsResponse
)
SEGMENT_OBJECTS = Rpc(_T, "SegmentObjects", toolbox.SegmentObjectsRequest, toolbox.SegmentObjectsResponse)
SAMPLE_POINTS = Rpc(_T, "SamplePoints", toolbox.SamplePointsRequest, toolbox.SamplePointsResponse)
CROP_CLOUD = Rpc(_T, "CropCloud", toolbox.CropCloudRequest, toolbox.CropCloudResponse)
FIND_NEIGHBORS = Rpc(_T, "FindNeighbors", toolbox.FindNeighborsRequest, toolbox.FindNeighborsResponse)
COMPUTE_LOCAL_FEATURES = Rpc(
    _T, "ComputeLocalFeatures", toolbox.ComputeLocalFeaturesRequest, toolbox.ComputeLocalFeaturesResponse
)
FIT_BOXES = Rpc(_T, "FitBoxes", toolbox.FitBoxesRequest, toolbox.FitBoxesResponse)
COMPUTE_CONVEX_HULL = Rpc(
    _T, "ComputeConvexHull", toolbox.ComputeConvexHullRequest, toolbox.ComputeConvexHullResponse
)
EXTRACT_FEATURES = Rpc(
    _T, "ExtractFeatures", toolbox_images.ExtractFeaturesRequest, toolbox_images.ExtractFeaturesResponse
)
MATCH_FEATURES = Rpc(
    _T, "MatchFeatures", toolbox_images.MatchFeaturesRequest, toolbox_images.MatchFeaturesResponse
)
FILTER_DEPTH = Rpc(_T, "FilterDepth", toolbox_depth.FilterDepthRequest, toolbox_depth.FilterDepthResponse)
COMPUTE_DEPTH_NORMALS = Rpc(
    _T,
    "ComputeDepthNormals",
    toolbox_depth.ComputeDepthNormalsRequest,
    toolbox_depth.ComputeDepthNormalsResponse,
)
SEGMENT_DEPTH_PLANES = Rpc(
    _T,
    "SegmentDepthPlanes",
    toolbox_depth.SegmentDepthPlanesRequest,
    toolbox_depth.SegmentDepthPlanesResponse,
)
FIND_DEPTH_EDGES = Rpc(
    _T, "FindDepthEdges", toolbox_depth.FindDepthEdgesRequest, toolbox_depth.FindDepthEdgesResponse
)
REGISTER_COLOR = Rpc(
    _T, "RegisterColor", toolbox_depth.RegisterColorRequest, toolbox_depth.RegisterColorResponse
)

_E = "EvaluationService"
EVALUATE_TRAJECTORY = Rpc(
    _E, "EvaluateTrajectory", evaluation.EvaluateTrajectoryRequest, evaluation.EvaluateTrajectoryResponse
)
EVALUATE_RELATIONS = Rpc(
    _E, "EvaluateRelations", evaluation.EvaluateRelationsRequest, evaluation.EvaluateRelationsResponse
)
EVALUATE_DETECTIONS = Rpc(
    _E, "EvaluateDetections", evaluation.EvaluateDetectionsRequest, evaluation.EvaluateDetectionsResponse
)

"""Every rpc, asked by a gRPC client that was told nothing of message sizes: it takes 4 MiB, and no answer has more."""

from __future__ import annotations

import importlib
import pkgutil

import grpc
import numpy as np
import percept.v1
import pytest
from google.protobuf.message_factory import GetMessageClass
from percept import CloudFormat, PointCloud, Step

from support import world

#: What a client takes that was told nothing.
DEFAULT_BYTES = 4 << 20
#: Points whose labels of four bytes are more.
MANY = 1_100_000
#: Columns and rows of images whose colours are more.
SIDE = (1440, 1080)


def services():
    for module in pkgutil.iter_modules(percept.v1.__path__):
        if module.name.endswith("_service_pb2"):
            yield from importlib.import_module(f"percept.v1.{module.name}").DESCRIPTOR.services_by_name.values()


RPCS = {f"{s.name}/{m.name}": m for s in services() for m in s.methods}


class Site:
    """Clouds that the server keeps, images, and a session with a map."""

    def __init__(self, server, client) -> None:
        self.channel = grpc.insecure_channel(server.grpc)
        rng = np.random.default_rng(3)
        # Hilly ground of 110 x 110 m in front of the origin, a point every 0.1 m, with normals and colours.
        x, y = (a.ravel() for a in np.meshgrid(np.arange(1100) / 10 - 55, np.arange(MANY // 1100) / 10 - 50))
        z = 0.2 * np.sin(x / 5) + rng.normal(0, 0.002, x.size)
        normals = np.tile(np.array([0, 0, 1], np.float32), (x.size, 1))
        colours = rng.integers(0, 256, (x.size, 3), np.uint8)
        points = np.column_stack([x, y, z]).astype(np.float32)
        hills = PointCloud(points, normals=normals, colours=colours)
        ball = rng.normal(size=(120_000, 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        toolbox = client.toolbox
        self.hills = toolbox.upload_cloud(hills)
        # A desk of the same many points, for what works in millimetres.
        self.desk = toolbox.upload_cloud((points * (0.01, 0.01, 0)).astype(np.float32))
        few = slice(250_000)
        self.part = toolbox.upload_cloud(PointCloud(points[few], normals=normals[few], colours=colours[few]))
        self.ball = toolbox.upload_cloud(ball.astype(np.float32))
        self.few = toolbox.upload_cloud(points[::500])
        self.file = toolbox.download_file(self.hills, CloudFormat.PCD)
        self.depth = rng.uniform(1, 3, SIDE[::-1]).astype(np.float32)
        self.colour = rng.integers(0, 256, (*SIDE[::-1], 3), np.uint8)
        self.session = client.sessions.create(sensors=[world.LASER, world.LIDAR])
        for i, pose in enumerate(world.drive(5)):
            self.session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
            self.session.send_cloud("lidar", stamp_ns=world.stamp(i) + 1, points=world.cloud(pose))
        self.stamp = world.stamp(100)
        # A cloud of 250,000 points, sent back.
        all_of_it = [Step("remove_non_finite", quiet=True)]
        self.operation = toolbox.start_pipeline(self.part, all_of_it, send_cloud=True)
        self.operation.wait()

    def kept(self, handle) -> dict:
        return {"cloud": {"handle": handle.handle}}

    def camera(self) -> dict:
        width, height = SIDE
        return {
            "width_px": width,
            "height_px": height,
            "fx_px": 2000,
            "fy_px": 2000,
            "cx_px": width / 2,
            "cy_px": height / 2,
        }

    def depth_image(self) -> dict:
        # DEPTH_ENCODING_U16.
        units = (self.depth * 1000).astype("<u2").tobytes()
        return {
            "width_px": SIDE[0],
            "height_px": SIDE[1],
            "encoding": 1,
            "metres_per_unit": 0.001,
            "data": units,
        }

    def colour_image(self) -> dict:
        # COLOUR_ENCODING_RGB8.
        return {"width_px": SIDE[0], "height_px": SIDE[1], "encoding": 1, "data": self.colour.tobytes()}

    def odometry(self) -> dict:
        self.stamp += 1
        pose = {"rotation": {"w": 1.0}}
        data = {"session_id": self.session.session_id, "sensor_id": "none", "stamp_ns": self.stamp}
        return data | {"odometry": {"t_odom_base": pose}}


@pytest.fixture(scope="module")
def site(server, client):
    site = Site(server, client)
    yield site
    site.channel.close()
    for handle in (site.hills, site.desk, site.part, site.ball, site.few):
        client.toolbox.drop_cloud(handle)


def descriptors(count: int) -> bytes:
    return np.random.default_rng(1).integers(0, 256, (count, 32), np.uint8).tobytes()


def pixels(count: int, shift: float = 0.0) -> bytes:
    return (np.random.default_rng(2).uniform(0, 1000, (count, 2)) + shift).tobytes()


def poses(count: int) -> list[dict]:
    return [{"stamp_ns": i * 10**8, "pose": {"translation": {"x": i / 10, "y": i % 7 / 10}}} for i in range(count)]


def views(site: Site, count: int) -> list[dict]:
    shifted = {"translation": {"x": 0.2}}
    return [
        {"camera": site.camera(), "pixels": pixels(count)},
        {"camera": site.camera(), "pixels": pixels(count, -40.0), "t_world_camera": shifted},
    ]


def of_session(site: Site) -> dict:
    return {"session_id": site.session.session_id}


def of_operation(site: Site) -> dict:
    return {"operation_id": site.operation.operation_id}


def of_map(site: Site) -> dict:
    return {"source": {"session_id": site.session.session_id}}


def noise(side: int = 1500) -> dict:
    """A map of random cells: a picture of it is as large as pictures get."""
    cells = np.random.default_rng(5).choice(np.array([-1, 0, 100], np.int8), (side, side))
    geometry = {"resolution_m": 0.1, "origin": {}, "width": side, "height": side}
    return {"grid": {"geometry": geometry, "cells": cells.tobytes()}}


#: A request of each rpc; more than 4 MiB come back where the second says so.
REQUESTS = {
    "SessionsService/CreateSession": (lambda s: {}, False),
    "SessionsService/GetSession": (of_session, False),
    "SessionsService/ListSessions": (lambda s: {"page_size": 1000}, False),
    "SessionsService/DeleteSession": (lambda s: {"session_id": "none"}, False),
    "SessionsService/StartRecording": (of_session, False),
    "SessionsService/StopRecording": (of_session, False),
    "SessionsService/ListRecordings": (lambda s: of_session(s) | {"page_size": 1000}, False),
    "SessionsService/DeleteRecording": (lambda s: of_session(s) | {"recording_id": "1"}, False),
    "SessionsService/GetPose": (of_session, False),
    "SessionsService/SetPose": (lambda s: of_session(s) | {"t_map_base": {"rotation": {"w": 1.0}}}, False),
    "SessionsService/GetTrajectory": (of_session, False),
    "SessionsService/ListKeyframes": (of_session, False),
    "SessionsService/WatchSession": (of_session, False),
    "SessionsService/WatchSessions": (lambda s: {}, False),
    "SessionsService/UpdateSession": (lambda s: {"session": of_session(s) | {"display_name": "sizes"}}, False),
    "SessionsService/LookupTransform": (
        lambda s: of_session(s) | {"target_frame": "base", "source_frame": "laser"},
        False,
    ),
    "SessionsService/GetDefaultParams": (lambda s: {}, False),
    "SensorsService/DeclareSensor": (
        lambda s: of_session(s) | {"spec": {"sensor_id": "imu", "kind": 6}},
        False,
    ),
    "SensorsService/ListSensors": (of_session, False),
    "SensorsService/GetSensor": (lambda s: of_session(s) | {"sensor_id": "laser"}, False),
    "SensorsService/UpdateSensor": (
        lambda s: of_session(s) | {"spec": {"sensor_id": "laser", "time_offset_s": 0.0}},
        False,
    ),
    "SensorsService/StreamFrames": (lambda s: {"message": s.odometry()}, False),
    "SensorsService/SendFrame": (lambda s: {"message": s.odometry()}, False),
    "SensorsService/SyncTime": (lambda s: {}, False),
    "ServerService/GetServerInfo": (lambda s: {}, False),
    "MapsService/GetMapSummary": (of_map, False),
    # 4,400 x 4,400 cells, most of them unknown.
    "MapsService/GetOccupancyGrid": (
        lambda s: of_map(s) | {"region": {"min": {"x": -220, "y": -220}, "max": {"x": 220, "y": 220}}},
        True,
    ),
    "MapsService/GetCloud": (of_map, False),
    "MapsService/ExportMap": (lambda s: of_map(s) | {"format": 4}, False),
    "MapsService/ListLoops": (of_map, False),
    "MapsService/SetLoopVeto": (of_map, False),
    "MapsService/OptimiseMap": (of_map, False),
    "MapsService/ImportMap": (of_map, False),
    "MapsService/CompareMaps": (lambda s: of_map(s) | {"grid": noise()["grid"]}, False),
    "SceneService/ListObjects": (of_session, False),
    "SceneService/GetObject": (of_session, False),
    "SceneService/GetSceneGraph": (of_session, False),
    "SceneService/GetRooms": (of_session, False),
    "SceneService/NameRoom": (of_session, False),
    "SceneService/CorrectObject": (lambda s: of_session(s) | {"label": "x"}, False),
    "SceneService/ListObjectClasses": (of_session, False),
    "SceneService/ForgetObjectClass": (lambda s: of_session(s) | {"label": "x"}, False),
    "SceneService/RouteToRoom": (lambda s: of_session(s) | {"room_name": "x"}, False),
    "LayersService/GetVoxels": (of_map, False),
    "LayersService/QueryPoints": (lambda s: of_map(s) | {"points": [{"x": 0.5}] * 1000}, False),
    "LayersService/CastRays": (of_map, False),
    "LayersService/CheckBoxes": (of_map, False),
    "LayersService/GetHeights": (of_map, False),
    "LayersService/GetMesh": (of_map, False),
    "LayersService/GetChanges": (of_map, False),
    "NavigationService/PlanCoverage": (of_map, False),
    "NavigationService/FindFrontiers": (of_map, False),
    "NavigationService/PlanFlight": (lambda s: of_map(s) | {"goal": {"x": 1.0}}, False),
    "NavigationService/DrawPath": (lambda s: of_map(s) | {"goal": {"x": 0.5}}, False),
    "NavigationService/ValidatePath": (lambda s: of_map(s) | {"poses": [{"x_m": 0.5}]}, False),
    "NavigationService/WatchPath": (lambda s: of_map(s) | {"goal": {"x": 0.5}}, False),
    "NavigationService/PlanPath": (lambda s: of_map(s) | {"goal": {"x": 0.5}}, False),
    "NavigationService/Navigate": (lambda s: {"message": s.odometry(), "goal": {"x": 0.5}}, False),
    "ToolboxKeptCloudsService/UploadCloud": (lambda s: {"cloud": {"file": {"data": s.file}}}, False),
    "ToolboxKeptCloudsService/UploadLargeCloud": (lambda s: {"data": s.file}, False),
    "ToolboxKeptCloudsService/ListClouds": (lambda s: {}, False),
    "ToolboxKeptCloudsService/DownloadCloud": (lambda s: {"handle": s.hills.handle}, True),
    "ToolboxKeptCloudsService/DropCloud": (lambda s: {"handle": "none"}, False),
    "ToolboxCloudsService/DecodeCloud": (lambda s: {"file": {"data": s.file}}, True),
    "ToolboxCloudsService/EncodeCloud": (lambda s: s.kept(s.hills), True),
    "ToolboxCloudsService/RemoveNonFinite": (lambda s: s.kept(s.hills), True),
    "ToolboxCloudsService/SamplePoints": (lambda s: s.kept(s.hills) | {"every": 1}, True),
    "ToolboxCloudsService/CropCloud": (lambda s: s.kept(s.hills) | {"range": {"max_range_m": 200}}, True),
    "ToolboxCloudsService/TransformCloud": (lambda s: s.kept(s.hills), True),
    "ToolboxCloudsService/RemoveRadiusOutliers": (lambda s: s.kept(s.part) | {"radius_m": 0.15}, True),
    "ToolboxCloudsService/RemoveStatisticalOutliers": (
        lambda s: s.kept(s.part) | {"num_neighbours": 5},
        True,
    ),
    "ToolboxCloudsService/DownsampleVoxels": (lambda s: s.kept(s.part) | {"voxel_size_m": 0.05}, True),
    "ToolboxCloudsService/EstimateNormals": (
        lambda s: s.kept(s.part) | {"radius_m": 0.15, "max_neighbours": 5},
        True,
    ),
    "ToolboxShapesService/FindNeighbours": (lambda s: s.kept(s.part) | {"k": 8}, True),
    "ToolboxShapesService/ComputeLocalFeatures": (lambda s: s.kept(s.part) | {"k": 4}, True),
    "ToolboxShapesService/ComputeShapeFeatures": (lambda s: s.kept(s.part), False),
    "ToolboxShapesService/FitBoxes": (lambda s: s.kept(s.hills), False),
    "ToolboxShapesService/ComputeConvexHull": (lambda s: s.kept(s.ball), True),
    "ToolboxSegmentationService/SegmentPlanes": (lambda s: s.kept(s.hills) | {"distance_m": 0.3}, True),
    "ToolboxSegmentationService/SegmentGround": (lambda s: s.kept(s.hills) | {"sensor_height_m": 0.1}, False),
    "ToolboxSegmentationService/ClusterPoints": (lambda s: s.kept(s.hills) | {"eps_m": 0.12}, True),
    "ToolboxSegmentationService/GrowRegions": (lambda s: s.kept(s.part) | {"radius_m": 0.12}, False),
    "ToolboxSegmentationService/ComputeSupervoxels": (lambda s: s.kept(s.desk), True),
    "ToolboxSegmentationService/GroupConvex": (lambda s: {}, False),
    "ToolboxSegmentationService/SegmentObjects": (lambda s: s.kept(s.desk), True),
    "ToolboxSegmentationService/DetectObjects": (lambda s: s.kept(s.few), False),
    "ToolboxRegistrationService/RegisterClouds": (
        lambda s: {
            "source": {"handle": s.few.handle},
            "target": {"handle": s.few.handle},
            "max_distance_m": 1,
        },
        False,
    ),
    "ToolboxRegistrationService/RegisterCloudsGlobally": (
        lambda s: {"source": {"handle": s.few.handle}, "target": {"handle": s.few.handle}, "voxel_size_m": 4},
        False,
    ),
    "ToolboxRegistrationService/ComputePointFeatures": (
        lambda s: s.kept(s.part) | {"radius_m": 0.15, "max_neighbours": 5},
        True,
    ),
    "ToolboxDepthService/UnprojectDepth": (
        lambda s: {"depth": s.depth_image(), "intrinsics": s.camera()},
        True,
    ),
    # DEPTH_ENCODING_F32.
    "ToolboxDepthService/ConvertDepth": (lambda s: {"depth": s.depth_image(), "encoding": 2}, True),
    "ToolboxDepthService/ConvertColour": (lambda s: {"colour": s.colour_image()}, True),
    "ToolboxDepthService/FilterDepth": (
        lambda s: {"depth": s.depth_image(), "filters": [{"median": {"size_px": 3}}]},
        True,
    ),
    "ToolboxDepthService/ComputeDepthNormals": (
        lambda s: {"depth": s.depth_image(), "intrinsics": s.camera()},
        True,
    ),
    "ToolboxDepthService/SegmentDepthPlanes": (
        lambda s: {"depth": s.depth_image(), "intrinsics": s.camera()},
        True,
    ),
    "ToolboxDepthService/FindDepthEdges": (
        lambda s: {"depth": s.depth_image(), "intrinsics": s.camera()},
        False,
    ),
    "ToolboxDepthService/RegisterColour": (
        lambda s: {
            "depth": s.depth_image(),
            "colour": s.colour_image(),
            "depth_camera": s.camera(),
            "colour_camera": s.camera(),
        },
        True,
    ),
    "ToolboxPlanningService/PlanOnMap": (lambda s: {"start": {}, "goal": {"x": 0.5}}, False),
    "ToolboxPlanningService/DrawPathOnMap": (lambda s: {"map": noise(), "start": {}, "goal": {"x": 0.5}}, False),
    "ToolboxPlanningService/ValidateOnMap": (lambda s: {"poses": [{"x_m": 0.5}]}, False),
    "ToolboxImagesService/DetectInImage": (lambda s: {"detector": "none"}, False),
    "ToolboxImagesService/ListImageDetectors": (lambda s: {}, False),
    "ToolboxImagesService/ExtractFeatures": (
        lambda s: {"image": s.colour_image(), "max_features": 100_000, "fast_threshold": 5},
        True,
    ),
    "ToolboxImagesService/MatchFeatures": (
        lambda s: {
            "query": descriptors(400_000),
            "train": descriptors(50),
            "descriptor_bytes": 32,
            "ratio": 1.0,
        },
        True,
    ),
    "ToolboxImagesService/EstimateEssential": (
        lambda s: {"points_a": pixels(1000), "points_b": pixels(1000, 3), "camera_a": s.camera()},
        False,
    ),
    "ToolboxImagesService/EstimateHomography": (
        lambda s: {"points_a": pixels(1000), "points_b": pixels(1000, 3)},
        False,
    ),
    "ToolboxImagesService/EstimateTwoView": (
        lambda s: {"points_a": pixels(1000), "points_b": pixels(1000, 3), "camera_a": s.camera()},
        False,
    ),
    "ToolboxImagesService/TriangulatePoints": (lambda s: {"views": views(s, 60_000)}, True),
    "ToolboxImagesService/SolvePnp": (
        lambda s: {"points": np.zeros((5, 3)).tobytes(), "pixels": pixels(5), "camera": s.camera()},
        False,
    ),
    "ToolboxPicturesService/RenderCloud": (
        lambda s: s.kept(s.hills) | {"width_px": 1600, "height_px": 1400, "shade": False},
        True,
    ),
    "ToolboxPicturesService/RenderDepth": (
        lambda s: {"depth": s.depth_image(), "near_m": 1, "far_m": 3},
        False,
    ),
    "ToolboxPipelinesService/RunPipeline": (
        lambda s: (
            s.kept(s.part)
            | {
                "steps": [
                    {"crop_cloud": {"range": {"max_range_m": 200}}},
                    {"segment_planes": {"distance_m": 0.3}, "remainder": 3},
                    {"cluster_points": {"eps_m": 0.12}},
                ],
                "send_cloud": True,
            }
        ),
        True,
    ),
    "OperationsService/StartOperation": (lambda s: {"optimise_map": of_map(s)}, False),
    "OperationsService/GetOperation": (of_operation, False),
    "DetectorsService/UploadDetector": (lambda s: {"spec": {"name": "none", "layout": 1}}, False),
    "DetectorsService/ListDetectors": (lambda s: {}, False),
    "DetectorsService/DeleteDetector": (lambda s: {"name": "none"}, False),
    "OperationsService/ListOperations": (lambda s: {"page_size": 1000}, False),
    "OperationsService/WaitOperation": (of_operation, False),
    "OperationsService/CancelOperation": (of_operation, False),
    "OperationsService/ReadOperationResult": (of_operation, True),
    "OperationsService/DeleteOperation": (lambda s: {"operation_id": "none"}, False),
    "EvaluationService/EvaluateTrajectory": (
        lambda s: {"reference": poses(70_000), "estimate": poses(70_000), "return_pairs": True},
        True,
    ),
    "EvaluationService/EvaluateRelations": (lambda s: {"trajectory": poses(10)}, False),
    "EvaluationService/EvaluateDetections": (lambda s: {}, False),
}


def answer(site: Site, rpc: str, fields: dict) -> tuple[str, int]:
    """The code that a call ends with, and how many bytes came."""
    method = RPCS[rpc]
    shape = {
        (False, False): site.channel.unary_unary,
        (False, True): site.channel.unary_stream,
        (True, False): site.channel.stream_unary,
        (True, True): site.channel.stream_stream,
    }[method.client_streaming, method.server_streaming]
    call = shape(f"/percept.v1.{rpc}", request_serializer=lambda m: m.SerializeToString())
    request = GetMessageClass(method.input_type)(**fields)
    sent = iter([request]) if method.client_streaming else request
    try:
        answers = call(sent, timeout=120)
        if not method.server_streaming:
            return "OK", len(answers)
        if "/Watch" in rpc:
            answers.initial_metadata()
            answers.cancel()
            return "OK", 0
        sizes = [len(part) for part in answers]
        assert max(sizes, default=0) < DEFAULT_BYTES
        return "OK", sum(sizes)
    except grpc.RpcError as error:
        return f"{error.code().name} {error.details()}", 0


@pytest.mark.parametrize("rpc", sorted(RPCS))
def test_no_answer_is_larger_than_a_client_takes_that_was_told_nothing(site, rpc):
    assert rpc in REQUESTS, f"{rpc} is new: say here what asks for much of it"
    fields, is_large = REQUESTS[rpc]
    code, size = answer(site, rpc, fields(site))
    assert not code.startswith(("RESOURCE_EXHAUSTED", "OUT_OF_RANGE", "INTERNAL")), code
    if is_large:
        assert code == "OK"
        assert size > DEFAULT_BYTES

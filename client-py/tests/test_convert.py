import hashlib

import numpy as np
import pytest

from percept import (
    CameraIntrinsics,
    CloudFrame,
    DepthFrame,
    EncodedImage,
    GridMap,
    ImuFrame,
    Internal,
    InvalidArgument,
    OdometryFrame,
    PointCloud,
    Pose,
    RgbdFrame,
    ScanFrame,
    SensorSpec,
    SessionMode,
    SpeedMask,
    ZoneMask,
)
from percept._convert import drawing, geometry, maps, navigation, poses, sensors, sessions, words, zones
from percept.v1 import map_pb2, navigation_service_pb2, params_pb2, path_pb2, sensor_pb2, session_pb2


def full_cloud(n=5):
    rng = np.random.default_rng(n)
    return PointCloud(
        rng.normal(size=(n, 3)).astype(np.float32),
        colours=rng.integers(0, 255, (n, 3), dtype=np.uint8),
        intensities=rng.random(n, dtype=np.float32),
        normals=rng.normal(size=(n, 3)).astype(np.float32),
        time_offsets_s=rng.random(n, dtype=np.float32),
    )


def test_a_cloud_survives_the_round_trip_with_all_channels_or_none():
    for cloud in (full_cloud(), PointCloud(np.ones((2, 3), np.float32)), full_cloud(0)):
        assert geometry.cloud(geometry.cloud_to(cloud)) == cloud


def test_a_cloud_in_chunks_is_joined_in_order():
    whole = full_cloud(10)
    parts = [
        PointCloud(
            whole.points[a:b],
            colours=whole.colours[a:b],
            intensities=whole.intensities[a:b],
            normals=whole.normals[a:b],
            time_offsets_s=whole.time_offsets_s[a:b],
        )
        for a, b in ((0, 3), (3, 10))
    ]
    chunks = [map_pb2.CloudChunk(cloud=geometry.cloud_to(p)) for p in parts]
    chunks[0].total_points = 10
    assert maps.cloud(chunks).cloud == whole
    with pytest.raises(Internal, match="incomplete"):
        maps.cloud(chunks[:1])


def test_an_empty_map_is_an_empty_cloud_and_an_empty_grid():
    chunk = map_pb2.CloudChunk(total_points=0)
    assert maps.cloud([chunk]).cloud.num_points == 0
    grid = map_pb2.OccupancyGridChunk(geometry=map_pb2.GridGeometry(resolution_m=0.05))
    assert maps.occupancy([grid]).cells.shape == (0, 0)


def test_a_sensor_survives_the_round_trip():
    camera = CameraIntrinsics(
        width_px=640,
        height_px=480,
        fx_px=525.5,
        fy_px=526.5,
        cx_px=319.5,
        cy_px=239.5,
        distortion_model="plumb_bob",
        distortion=(0.1, 0.2, 0.3, 0.4, 0.5),
    )
    pose = Pose.from_xyz(1, 2, 3, yaw_rad=0.5)
    for spec in (
        SensorSpec("c", kind="rgbd", t_base_sensor=pose, intrinsics=camera, overload_policy="block"),
        SensorSpec("l", kind="lidar2d", time_offset_s=-0.25),
    ):
        assert sensors.spec(sensors.spec_to(spec)) == spec


def test_depth_keeps_its_bits():
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    frame = DepthFrame("d", stamp_ns=7, depth=depth, metres_per_unit=0.001)
    message = sensors.frame_to("s", frame, 9)
    assert (message.session_id, message.sensor_id, message.stamp_ns, message.sequence) == ("s", "d", 7, 9)
    assert (message.depth.width_px, message.depth.height_px) == (4, 3)
    assert message.depth.encoding == sensor_pb2.DEPTH_ENCODING_U16
    assert message.depth.data == depth.tobytes()
    metres = DepthFrame("d", stamp_ns=7, depth=depth.astype(np.float32))
    assert not sensors.frame_to("s", metres).depth.HasField("metres_per_unit")


def test_encoded_images_are_told_by_their_first_bytes():
    def colour_of(data):
        depth = np.zeros((2, 2), np.float32)
        colour = EncodedImage(data=data, width_px=2, height_px=2)
        return sensors.frame_to(
            "s", RgbdFrame("c", stamp_ns=1, depth=depth, colour=colour)
        ).rgbd.colour.encoding

    assert colour_of(b"\x89PNG....") == sensor_pb2.COLOUR_ENCODING_PNG
    assert colour_of(b"\xff\xd8\xff\xe0") == sensor_pb2.COLOUR_ENCODING_JPEG
    with pytest.raises(InvalidArgument) as error:
        colour_of(b"GIF89a")
    assert error.value.reason == "FILE_INVALID"


def test_scans_clouds_and_odometry_become_messages():
    ranges = np.array([1.0, np.inf, np.nan], np.float32)
    scan = ScanFrame(
        "l",
        stamp_ns=1,
        ranges_m=ranges,
        angle_min_rad=-1.0,
        angle_increment_rad=0.5,
        range_min_m=0.1,
        range_max_m=9.0,
    )
    assert sensors.frame_to("s", scan).scan.ranges_m == ranges.tobytes()
    assert sensors.frame_to("s", CloudFrame("l", stamp_ns=1, cloud=full_cloud(4))).cloud.num_points == 4
    odometry = OdometryFrame("o", stamp_ns=1, t_odom_base=Pose(), covariance=np.eye(6))
    message = sensors.frame_to("s", odometry).odometry
    assert np.array_equal(np.array(message.covariance.values).reshape(6, 6), np.eye(6))


def test_unknown_words_are_refused_with_those_that_are_known():
    with pytest.raises(InvalidArgument) as error:
        sessions.create("a", "", "maping", [], None, None, None)
    assert (error.value.reason, error.value.field) == ("ENUM_UNKNOWN", "mode")
    assert "mapping, ingest_only" in error.value.message


def test_a_newer_servers_words_read_as_unspecified():
    assert words.word(SessionMode, session_pb2.SessionMode, 77) == SessionMode.UNSPECIFIED


def test_creation_is_always_repeatable():
    one, two = (sessions.create(None, "", "mapping", [], None, None, None).request for _ in range(2))
    assert one.request_id
    assert one.request_id != two.request_id
    assert not one.HasField("session_id")
    assert sessions.create(None, "", "mapping", [], None, None, "mine").request.request_id == "mine"


def test_an_update_names_what_it_changes_and_none_puts_back():
    planning = {"robot_radius_m": 0.3, "inflation_radius_m": None}
    params = {"planning": planning, "relations": {"contact_m": None}}
    request = sessions.update("s", "", None, params, None, None, "tag").request
    assert list(request.update_mask.paths) == [
        "display_name",
        "params.planning.robot_radius_m",
        "params.planning.inflation_radius_m",
        "params.relations.contact_m",
    ]
    assert request.session.params.planning.robot_radius_m == 0.3
    assert not request.session.params.planning.HasField("inflation_radius_m")
    assert (request.session.session_id, request.etag) == ("s", "tag")
    cleared = sessions.update("s", None, None, None, [], [], "").request
    assert list(cleared.update_mask.paths) == ["zones", "zone_masks"]


def test_a_zone_mask_says_what_it_has_and_leaves_out_what_stays(tmp_path):
    cells = GridMap(cells=np.full((2, 3), 50, np.int8), resolution_m=0.1)
    kept_out = zones.mask_to(ZoneMask(name="a", cells=cells))
    assert (kept_out.WhichOneof("map"), kept_out.WhichOneof("kind")) == ("grid", "keep_out")
    kept = zones.mask_to(ZoneMask(name="a"))
    assert (kept.WhichOneof("map"), kept.WhichOneof("kind")) == (None, None)
    (tmp_path / "m.pgm").write_bytes(b"P5 1 1 255\n\0")
    (tmp_path / "m.yaml").write_text("image: m.pgm\n")
    speed = SpeedMask(base=100.0, multiplier=-1.0, unit="metres_per_second")
    slow = zones.mask_to(ZoneMask(name="a", cells=tmp_path / "m.yaml", speed=speed))
    assert (slow.WhichOneof("map"), slow.nav2.image) == ("nav2", b"P5 1 1 255\n\0")
    slow.geometry.resolution_m = 0.1
    told = zones.mask(slow)
    assert (told.speed, told.cells, told.geometry.resolution_m) == (speed, None, 0.1)


def test_a_picture_has_a_goal_or_a_path_and_says_what_is_drawn():
    poses = [Pose(), Pose.from_xy_yaw(1.0, 0.0, 0.0)]
    for goal, path in ((None, None), ((1.0, 2.0), poses)):
        with pytest.raises(InvalidArgument) as error:
            drawing.draw_path("s", goal, path, None, "clearance", None, None)
        assert error.value.field == "goal"
    call = drawing.draw_path("s", None, poses, None, "cost", None, None)
    assert (len(call.request.poses), call.request.colouring) == (2, path_pb2.PATH_COLOURING_COST)
    assert not call.request.HasField("goal")
    misfit = path_pb2.Misfit(pose_index=1, reason=path_pb2.MISFIT_REASON_OUTSIDE_MAP)
    picture = call.read(navigation_service_pb2.DrawPathResponse(png=b"png", misfit=misfit))
    assert (picture.png, picture.outcome, picture.misfit.reason) == (b"png", None, "outside_map")


def test_unknown_parameters_are_refused():
    with pytest.raises(InvalidArgument) as error:
        sessions.create(None, "", "mapping", [], {"no_such_group": {"x": 1}}, None, None)
    assert error.value.reason == "PARAMS_INVALID"
    assert "no_such_group" in error.value.message


def test_choices_of_a_tree_are_words_or_names_and_others_are_refused():
    def tree(value):
        return {"slam": {"odometry": {"keyframe": {"features": value}}}}

    for value in ("sift", "SIFT", "FEATURE_METHOD_SIFT"):
        message = words.message_of("params", params_pb2.PipelineParams, tree(value))
        assert words.tree_of(message) == tree("sift")
    with pytest.raises(InvalidArgument) as error:
        words.message_of("params", params_pb2.PipelineParams, tree("surf"))
    assert error.value.reason == "ENUM_UNKNOWN"
    assert error.value.field == "params.slam.odometry.keyframe.features"


def test_a_tree_survives_the_round_trip():
    tree = {"sensor_id": "c", "intrinsics": {"width_px": 5, "fx_px": 1.5, "distortion": [1.0, 2.0]}}
    assert words.tree_of(words.message_of("x", sensor_pb2.SensorSpec, tree)) == tree


def test_a_grid_is_joined_of_its_chunks_and_read_at_a_point():
    cells = np.arange(12, dtype=np.int8).reshape(3, 4)
    where = map_pb2.GridGeometry(resolution_m=0.5, width=4, height=3)
    where.origin.x, where.origin.y = -1.0, 2.0
    chunks = [
        map_pb2.OccupancyGridChunk(geometry=where, cells=cells.tobytes()[:5]),
        map_pb2.OccupancyGridChunk(offset=5, cells=cells.tobytes()[5:]),
    ]
    grid = maps.occupancy(chunks)
    assert np.array_equal(grid.cells, cells)
    assert grid.cell_at(-0.9, 2.1) == 0
    assert grid.cell_at(0.6, 3.4) == 11
    assert grid.cell_at(-1.1, 2.1) is None
    with pytest.raises(Internal, match="incomplete"):
        maps.occupancy(chunks[:1])


def test_a_file_is_compared_with_its_checksum():
    data = b"abcdef"
    header = map_pb2.FileHeader(file_name="m.ply", size_bytes=6, sha256=hashlib.sha256(data).hexdigest())
    chunks = [
        map_pb2.FileChunk(header=header, data=data[:4]),
        map_pb2.FileChunk(offset=4, data=data[4:]),
    ]
    assert maps.file(chunks).data == data
    chunks[1].data = b"eF"
    with pytest.raises(Internal) as error:
        maps.file(chunks)
    assert error.value.reason == "CHECKSUM_MISMATCH"


def test_absent_parts_of_a_result_are_none():
    result = poses.result(session_pb2.FrameResult(latency_s=0.5))
    assert (result.pose, result.keyframe_id, result.latency_s) == (None, None, 0.5)
    assert poses.result(session_pb2.FrameResult(keyframe_id=0)).keyframe_id == 0


def test_a_path_is_true_and_no_path_is_false():
    call = navigation.plan("s", (1.0, 2.0), None, None, None)
    found = navigation_service_pb2.PlanPathResponse(
        path=path_pb2.Path(waypoints=[{"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.5}], length_m=1.0)
    )
    blocked = navigation_service_pb2.PlanPathResponse(
        no_path=path_pb2.NoPath(reason=path_pb2.NO_PATH_REASON_UNREACHABLE, detail="walls")
    )
    assert call.read(found)
    assert call.read(found).waypoints.tolist() == [[1.0, 2.0]]
    assert call.read(found).yaws_rad.tolist() == [0.5]
    assert not call.read(blocked)
    assert call.read(blocked).reason == "unreachable"
    assert not call.request.HasField("start")


def test_events_are_told_apart():
    event = session_pb2.SessionEvent(token=4, resync=session_pb2.Resync(missed=3))
    assert sessions.event(event).event.missed == 3
    assert sessions.event(session_pb2.SessionEvent(token=5)).event is None
    event = session_pb2.SessionEvent(token=6, map_version=2)
    assert sessions.event(event).event.map_version == 2


@pytest.mark.parametrize("stamp_ns", [1.5, 2.0, "7", None, 2**63])
def test_a_stamp_that_is_no_whole_number_of_64_bits_is_refused(stamp_ns):
    felt = {"angular_velocity_radps": (0, 0, 0), "linear_acceleration_mps2": (0, 0, 9.81)}
    frame = ImuFrame("i", stamp_ns=stamp_ns, **felt)
    with pytest.raises(InvalidArgument) as error:
        sensors.frame_to("s", frame)
    assert (error.value.reason, error.value.field) == ("STAMP_INVALID", "stamp_ns")
    assert "time.time_ns()" in str(error.value)


def test_a_stamp_of_numpy_is_taken():
    frame = ImuFrame(
        "i", stamp_ns=np.int64(7), angular_velocity_radps=(0, 0, 0), linear_acceleration_mps2=(0, 0, 9.81)
    )
    assert sensors.frame_to("s", frame).stamp_ns == 7

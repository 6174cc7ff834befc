from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from percept import (
    CameraIntrinsics,
    EncodedImage,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    OdometryFrame,
    Pose,
    SensorSpec,
)
from percept._convert import geometry
from percept._convert import sensors as convert
from percept.v1 import sensor_pb2

from support import raw, robots, world


def test_a_sensor_is_declared_and_listed_as_it_was_declared(client):
    session = client.sessions.create()
    status = session.sensors.declare(world.CAMERA)
    assert status.spec == world.CAMERA
    assert (status.accepted, status.rate_hz, status.last_stamp_ns) == (0, None, None)
    assert (status.verdict, status.troubles) == ("no_frame", ())
    assert status.verdict_message
    session.sensors.declare("odom", kind="odometry")
    assert [s.spec.sensor_id for s in session.sensors.list()] == ["camera", "odom"]


def test_a_declaration_may_change_until_it_has_sent(client):
    session = client.sessions.create(sensors=[world.LASER])
    moved = dataclasses.replace(world.LASER, t_base_sensor=Pose.from_xy_yaw(0.1, 0, 0))
    assert session.sensors.declare(moved).spec == moved
    session.send_scan("laser", stamp_ns=1, **world.scan(world.drive(1)[0]))
    assert session.sensors.declare(moved).spec == moved, "the same again is no change"
    with pytest.raises(FailedPrecondition) as error:
        session.sensors.declare(world.LASER)
    assert error.value.reason == "SENSOR_IN_USE"


#: What a declaration of a depth camera is changed to, as the client and as the contract have it.
RIGHT = [
    {"sensor_id": "x" * 64},
    {"range_max_m": 1e4},
    {"range_max_m": 1e-9},
    {"time_offset_s": -1e6},
    {"t_base_sensor": Pose.from_xyz(1e4, -1e4, 0)},
    {"t_base_sensor": Pose(rotation=[0, 0, 0, 1.0009])},
    {"width_px": 16384},
    {"height_px": 1},
    {"cx_px": -5.0},
    {"distortion_model": "plumb_bob", "distortion": (0.1, 0, 0, 0, 0)},
    {"distortion_model": "rational", "distortion": (0.0,) * 8},
    {"distortion_model": "fisheye", "distortion": (0.0,) * 4},
]
NAN, INF = float("nan"), float("inf")
WRONG = [
    ({"sensor_id": ""}, "ID_INVALID", "sensor_id"),
    ({"sensor_id": "x" * 65}, "ID_INVALID", "sensor_id"),
    ({"sensor_id": "no spaces"}, "ID_INVALID", "sensor_id"),
    ({"sensor_id": "ü"}, "ID_INVALID", "sensor_id"),
    ({"sensor_id": "a\n"}, "ID_INVALID", "sensor_id"),
    ({"kind": "unspecified"}, "ENUM_UNKNOWN", "kind"),
    ({"intrinsics": None}, "FIELD_MISSING", "intrinsics"),
    ({"t_base_sensor": Pose(rotation=[0, 0, 0, 2.0])}, "QUATERNION_NOT_UNIT", "t_base_sensor"),
    ({"t_base_sensor": Pose(rotation=[0, 0, 0, 1.0011])}, "QUATERNION_NOT_UNIT", "t_base_sensor"),
    ({"t_base_sensor": Pose(rotation=[0, 0, NAN, 1])}, "OUT_OF_RANGE", "t_base_sensor"),
    ({"t_base_sensor": Pose.from_xyz(0, INF, 0)}, "OUT_OF_RANGE", "t_base_sensor"),
    ({"t_base_sensor": Pose.from_xyz(0, -10000.1, 0)}, "OUT_OF_RANGE", "t_base_sensor.translation"),
    ({"time_offset_s": NAN}, "OUT_OF_RANGE", "time_offset_s"),
    ({"time_offset_s": INF}, "OUT_OF_RANGE", "time_offset_s"),
    ({"range_max_m": 0.0}, "OUT_OF_RANGE", "range_max_m"),
    ({"range_max_m": NAN}, "OUT_OF_RANGE", "range_max_m"),
    ({"range_max_m": 10000.1}, "OUT_OF_RANGE", "range_max_m"),
    ({"width_px": 0}, "OUT_OF_RANGE", "width_px"),
    ({"height_px": 16385}, "OUT_OF_RANGE", "height_px"),
    ({"fx_px": 0.0}, "OUT_OF_RANGE", "fx_px"),
    ({"fy_px": INF}, "OUT_OF_RANGE", "fy_px"),
    ({"cy_px": NAN}, "OUT_OF_RANGE", "cy_px"),
    ({"distortion": (0.1,)}, "SIZE_MISMATCH", "distortion"),
    ({"distortion_model": "plumb_bob", "distortion": (0.1,) * 4}, "SIZE_MISMATCH", "distortion"),
    ({"distortion_model": "fisheye", "distortion": (0, 0, NAN, 0)}, "OUT_OF_RANGE", "distortion"),
]
LENS_FIELDS = {field.name for field in dataclasses.fields(CameraIntrinsics)}


def made(change):
    """The declaration as the client makes it."""
    lens = {k: v for k, v in change.items() if k in LENS_FIELDS}
    rest = {k: v for k, v in change.items() if k not in LENS_FIELDS}
    return dataclasses.replace(world.CAMERA, **{"intrinsics": dataclasses.replace(world.INTRINSICS, **lens), **rest})


def as_message(change):
    """The same as a caller without the client sends it."""
    out = convert.spec_to(world.CAMERA)
    for name, value in change.items():
        target = out.intrinsics if name in LENS_FIELDS else out
        if name == "intrinsics":
            out.ClearField(name)
        elif name == "t_base_sensor":
            out.t_base_sensor.CopyFrom(geometry.pose_to(value))
        elif name == "distortion":
            target.distortion[:] = value
        elif name == "distortion_model":
            target.distortion_model = sensor_pb2.DistortionModel.Value(f"DISTORTION_MODEL_{value.upper()}")
        elif name == "kind":
            out.kind = sensor_pb2.SENSOR_KIND_UNSPECIFIED
        else:
            setattr(target, name, value)
    return out


@pytest.mark.parametrize("change", RIGHT, ids=str)
def test_what_the_server_takes_can_be_made(server, client, change):
    assert client.sessions.create().sensors.declare(made(change))
    with raw.Calls(server.grpc) as calls:
        session = client.sessions.create()
        request = {"session_id": session.session_id, "spec": as_message(change)}
        assert calls("SensorsService/DeclareSensor", **request).ok


@pytest.mark.parametrize(("change", "reason", "field"), WRONG, ids=str)
def test_what_the_server_refuses_is_refused_when_it_is_made(server, client, change, reason, field):
    with pytest.raises(ValueError, match=field) as error:
        made(change)
    assert (error.value.reason, error.value.field) == (reason, field)
    session = client.sessions.create()
    with raw.Calls(server.grpc) as calls:
        request = {"session_id": session.session_id, "spec": as_message(change)}
        answer = calls("SensorsService/DeclareSensor", **request)
    assert (answer.code, answer.reason) == ("INVALID_ARGUMENT", reason)
    assert session.sensors.list() == []


def test_health_tells_rate_gaps_and_refusals(client):
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(6)):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    with pytest.raises(InvalidArgument):
        session.send_scan("laser", stamp_ns=world.stamp(2) + 1, **world.scan(pose))
    (status,) = session.sensors.list()
    assert (status.accepted, status.rejected, status.dropped) == (6, 1, 0)
    assert status.rate_hz == pytest.approx(1e9 / world.FRAME_NS, rel=1e-3)
    assert status.last_stamp_ns == world.stamp(5)
    assert status.verdict == "troubled"
    assert [t.kind for t in status.troubles] == ["rejected"]
    assert "1 frames refused" in status.troubles[0].message


GRAVITY = (0.0, 0.0, 9.81)
TURNING = (0.0, 0.0, np.radians(2.0) * 1e9 / world.FRAME_NS)


@pytest.mark.parametrize(
    ("rate", "force", "delay_ns", "kinds", "words"),
    [
        (TURNING, GRAVITY, 0, [], "good"),
        (TURNING, (0.0, 0.0, 1.0), 0, ["force_unlike_gravity"], "in g; multiply by 9.81"),
        (TURNING, (0.0, 0.0, 0.0), 0, ["force_unlike_gravity"], "send the raw reading"),
        (tuple(np.degrees(TURNING)), GRAVITY, 0, ["turns_unlike"], "in degrees; send rad/s"),
        ((TURNING[2], 0.0, 0.0), GRAVITY, 0, ["turns_unlike"], "by 90 degrees"),
        ((0.0, 0.0, -TURNING[2]), GRAVITY, 0, ["turns_unlike"], "by 180 degrees"),
        (TURNING, GRAVITY, -2 * 10**9, ["clock_apart", "samples_missing"], "before the frames"),
    ],
    ids=["right", "g", "no_gravity", "degrees", "on_its_side", "upside_down", "late"],
)
def test_what_is_wrong_with_an_imu_is_said(client, rate, force, delay_ns, kinds, words):
    session = client.sessions.create(sensors=[world.LASER, SensorSpec("imu", kind="imu")])
    every_ns, steps = world.FRAME_NS // 10, 60
    with session.stream() as stream:
        for i in range(10 * steps):
            stamp_ns = world.stamp(0) + 3 * 10**9 + i * every_ns
            stream.send_imu(
                "imu",
                stamp_ns=stamp_ns + delay_ns,
                angular_velocity_radps=rate,
                linear_acceleration_mps2=force,
            )
            if i % 10 == 0:
                stream.send_scan("laser", stamp_ns=stamp_ns, **robots.scan(i // 10))
    assert stream.summary.rejected == 0
    laser, imu = sorted(session.sensors.list(), key=lambda s: s.spec.sensor_id, reverse=True)
    assert (laser.verdict, [t.kind for t in imu.troubles]) == ("good", kinds)
    assert words in imu.verdict_message
    pose, truth = session.pose(), world.truth_in_map(list(robots.laps()))[steps - 1]
    assert pose.state == "tracking"
    assert world.position_error_m(pose.t_map_base, truth) < 0.1


def test_an_imu_alone_is_told_that_no_pose_comes_of_it(client):
    session = client.sessions.create(sensors=[SensorSpec("imu", kind="imu")])

    def sample(stamp_ns):
        session.send_imu("imu", stamp_ns=stamp_ns, angular_velocity_radps=TURNING, linear_acceleration_mps2=GRAVITY)
        return next(s for s in session.sensors.list() if s.spec.sensor_id == "imu")

    alone = sample(1)
    assert [t.kind for t in alone.troubles] == ["no_pose"]
    assert "declare a lidar" in alone.verdict_message
    session.sensors.declare(world.LASER)
    assert sample(10**7).verdict == "good"


@pytest.mark.parametrize("wanted", ["imu", "nobody"])
def test_a_pose_sensor_that_cannot_be_is_said(client, wanted):
    sensors = [world.LASER, SensorSpec("imu", kind="imu")]
    session = client.sessions.create(sensors=sensors, params={"slam": {"pose_sensor": wanted}})
    assert session.send_scan("laser", stamp_ns=1, **robots.scan(0)).pose is None
    (status,) = [s for s in session.sensors.list() if s.spec.sensor_id == "laser"]
    assert [t.kind for t in status.troubles] == ["no_pose"]
    assert "pose_sensor" in status.verdict_message


def test_a_frame_that_is_sent_again_is_answered_and_does_nothing_more(client):
    session = client.sessions.create(sensors=[world.LASER])
    scans = [world.scan(pose) for pose in world.drive(3)]
    for i, scan in enumerate(scans):
        assert not session.send_scan("laser", stamp_ns=world.stamp(i), **scan).duplicate
    for i in (1, 2, 0):
        assert session.send_scan("laser", stamp_ns=world.stamp(i), **scans[i]).duplicate
    assert len(session.trajectory()) == 3
    (status,) = session.sensors.list()
    assert (status.accepted, status.rejected) == (3, 0)


def test_another_frame_of_a_stamp_is_refused_alone_and_in_a_stream(client):
    """A clock of whole seconds: of ten scans a second nine have the stamp of the one before."""
    session = client.sessions.create(sensors=[world.LASER])
    scans = [world.scan(pose) for pose in world.drive(4)]
    start_ns = world.stamp(0)
    assert not session.send_scan("laser", stamp_ns=start_ns, **scans[0]).duplicate
    with pytest.raises(InvalidArgument) as refused:
        session.send_scan("laser", stamp_ns=start_ns, **scans[1])
    assert (refused.value.reason, refused.value.field) == ("STAMP_REPEATED", "stamp_ns")
    with session.stream() as stream:
        for scan in scans[2:]:
            stream.send_scan("laser", stamp_ns=start_ns, **scan)
        stream.send_scan("laser", stamp_ns=start_ns, **scans[0])
    assert (stream.summary.accepted, stream.summary.rejected) == (0, 3)
    assert {r.rejection.reason for r in stream.summary.rejections} == {"STAMP_REPEATED", "STAMP_NOT_INCREASING"}
    (status,) = session.sensors.list()
    assert (status.accepted, status.rejected) == (1, 3), "the one that was sent again is none"
    assert "STAMP_REPEATED" in status.verdict_message


@pytest.mark.parametrize(("divisor", "unit"), [(10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds")])
def test_stamps_of_another_unit_are_told(client, divisor, unit):
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(5)):
        stamp_ns = (1_700_000_000 * 10**9 + i * 10**8) // divisor
        session.send_scan("laser", stamp_ns=stamp_ns + (i if divisor == 10**9 else 0), **world.scan(pose))
    (status,) = session.sensors.list()
    assert [t.kind for t in status.troubles] == ["stamp_unit"]
    assert f"seem to be in {unit}" in status.verdict_message


def test_a_mount_beyond_any_robot_is_told(client):
    far = dataclasses.replace(world.LASER, t_base_sensor=Pose.from_xyz(0, 0, 1000.0))
    session = client.sessions.create(sensors=[far])
    session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    (status,) = session.sensors.list()
    assert [t.kind for t in status.troubles] == ["mount_far"]


@pytest.mark.parametrize("ahead_s", [-1_700_000_000.0, -60.0, 3.0])
def test_a_sensor_whose_clock_is_another_is_told_and_not_the_one_that_it_is_compared_with(client, ahead_s):
    session = client.sessions.create(sensors=[world.LASER, world.WHEELS])
    with session.stream() as stream:
        for i, pose in enumerate(world.drive(10)):
            stamp_ns = 1_700_000_001 * 10**9 + i * 10**8
            stream.send_odometry("wheels", stamp_ns=stamp_ns + int(ahead_s * 1e9), t_odom_base=pose)
            stream.send_scan("laser", stamp_ns=stamp_ns, **world.scan(pose))
    status = {s.spec.sensor_id: s for s in session.sensors.list()}
    assert "clock_apart" in [t.kind for t in status["wheels"].troubles]
    assert ("ahead of" if ahead_s > 0 else "behind") in status["wheels"].verdict_message
    assert status["laser"].verdict == "good"


def test_a_planar_lidar_that_stands_on_edge_moves_no_pose(client):
    """A survey robot's: whichever sends first, the level one leads; alone it tells why there is no pose."""
    half = np.sqrt(0.5)
    quarter = Pose(translation=np.array([0.0, 0.0, 0.3]), rotation=np.array([half, 0, 0, half]))
    edge = SensorSpec("edge", kind="lidar2d", t_base_sensor=quarter)
    both = client.sessions.create(sensors=[edge, world.LASER])
    alone = client.sessions.create(sensors=[edge])
    poses = world.drive(30)
    for i, pose in enumerate(poses):
        across = world.scan(pose, mount=quarter)
        both.send_scan("edge", stamp_ns=world.stamp(i), **across)
        both.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
        alone.send_scan("edge", stamp_ns=world.stamp(i), **across)
    assert world.position_error_m(both.pose().t_map_base, world.truth_in_map(poses)[-1]) < 0.03
    assert alone.pose() is None
    (status,) = alone.sensors.list()
    assert [t.kind for t in status.troubles] == ["no_pose"]
    assert "planes are steep" in status.verdict_message


def test_every_kind_of_frame_is_taken(client):
    small = CameraIntrinsics(width_px=16, height_px=12, fx_px=15, fy_px=15, cx_px=7.5, cy_px=5.5)
    kinds = ("depth", "rgbd", "camera", "lidar3d", "lidar2d", "imu", "odometry")
    specs = [SensorSpec(k, kind=k, intrinsics=small if k in ("depth", "rgbd", "camera") else None) for k in kinds]
    # Tried on a link: what each kind does to a map is another test's matter.
    session = client.sessions.create(mode="ingest_only", sensors=specs)
    pose = world.drive(1)[0]
    depth, colour = np.full((12, 16), 2000, np.uint16), np.zeros((12, 16, 3), np.uint8)
    n = 100
    points = np.random.default_rng(1).normal(size=(n, 3)).astype(np.float32)
    session.send_depth("depth", stamp_ns=1, depth=depth, metres_per_unit=0.001)
    session.send_depth("depth", stamp_ns=2, depth=depth.astype(np.float32) / 1000)
    session.send_rgbd("rgbd", stamp_ns=1, depth=depth, colour=colour, metres_per_unit=0.001)
    session.send_colour("camera", stamp_ns=1, colour=colour)
    session.send_cloud(
        "lidar3d",
        stamp_ns=1,
        points=points,
        colours=np.zeros((n, 3), np.uint8),
        intensities=np.zeros(n, np.float32),
        time_offsets_s=np.linspace(-0.1, 0, n, dtype=np.float32),
    )
    session.send_scan("lidar2d", stamp_ns=1, **world.scan(pose))
    gravity = (0.0, 0.0, 9.81)
    session.send_imu("imu", stamp_ns=1, angular_velocity_radps=(0, 0, 0), linear_acceleration_mps2=gravity)
    session.send_odometry("odometry", stamp_ns=1, t_odom_base=Pose(), covariance=np.eye(6) * 1e-4)
    accepted = {s.spec.sensor_id: s.accepted for s in session.sensors.list()}
    assert accepted == dict.fromkeys(kinds, 1) | {"depth": 2}


def test_an_encoded_image_that_lies_is_refused(client):
    small = CameraIntrinsics(width_px=16, height_px=12, fx_px=15, fy_px=15, cx_px=7.5, cy_px=5.5)
    session = client.sessions.create(sensors=[SensorSpec("c", kind="camera", intrinsics=small)])
    broken = EncodedImage(data=b"\xff\xd8\xff\xe0 and no more", width_px=16, height_px=12)
    with pytest.raises(InvalidArgument) as error:
        session.send_colour("c", stamp_ns=1, colour=broken)
    assert error.value.reason == "FILE_INVALID"


def test_what_stands_behind_glass_is_mapped_by_later_echoes(client):
    session = client.sessions.create(sensors=[world.LASER])
    pose = world.drive(1)[0]
    scan = world.scan(pose)
    wall = scan["ranges_m"]
    glass = np.abs(np.arange(360) - 180) < 6
    first = np.where(glass, 1.0, wall).astype(np.float32)
    later = np.where(glass, wall, np.nan).astype(np.float32)[None]
    session.send_scan("laser", stamp_ns=1, **{**scan, "ranges_m": first}, later_echoes_m=later)
    grid = session.map.occupancy()
    assert grid.cell_at(1.0, 0.0) > 50
    assert grid.cell_at(float(wall[180]), 0.0) > 50
    assert grid.cell_at(1.0 + (float(wall[180]) - 1.0) / 2, 0.0) < 50


def test_odometry_is_a_prior_where_scans_say_nothing(client):
    """A robot that only has wheels and a laser stands right between two scans 30 cm apart."""
    session = client.sessions.create(sensors=[world.LASER, SensorSpec("odom", kind="odometry")])
    start = world.drive(1)[0]
    end = Pose.from_xy_yaw(start.translation[0] + 0.3, 0.05, 0.1)
    for i, pose in enumerate((start, end)):
        t_odom_base = Pose.from_matrix(np.linalg.inv(start.matrix) @ pose.matrix)
        session.send(OdometryFrame("odom", stamp_ns=world.stamp(10 * i), t_odom_base=t_odom_base))
        session.send_scan("laser", stamp_ns=world.stamp(10 * i), **world.scan(pose))
    truth = world.truth_in_map([start, end])[-1]
    assert world.position_error_m(session.pose().t_map_base, truth) < 0.03


def test_unknown_sensors_are_refused_in_streams_and_alone(client):
    session = client.sessions.create(sensors=[world.LASER])
    scan = world.scan(world.drive(1)[0])
    with pytest.raises(NotFound) as error:
        session.send_scan("nobody", stamp_ns=1, **scan)
    assert error.value.reason == "SENSOR_NOT_FOUND"
    with session.stream() as stream:
        stream.send_scan("nobody", stamp_ns=1, **scan)
        stream.send_scan("laser", stamp_ns=1, **scan)
        acks = list(stream.acks())
    assert [a.rejection and a.rejection.reason for a in acks] == ["SENSOR_NOT_FOUND", None]


def test_the_clocks_of_one_machine_agree(client):
    offset = client.sync_time()
    assert offset.round_trip_ns > 0
    assert abs(offset.offset_ns) <= offset.round_trip_ns
    assert abs(time.time_ns() + offset.offset_ns - time.time_ns()) < 10**9

"""Bad input: a precise error at each door, the session unharmed, earlier data kept."""

from __future__ import annotations

import copy
import struct
import zlib

import numpy as np
import pytest
from percept import CameraIntrinsics, SensorSpec
from percept.v1 import sensor_pb2 as s

from support.doors import DOORS

W, H = 16, 12
CAMERA = CameraIntrinsics(width_px=W, height_px=H, fx_px=15.0, fy_px=15.0, cx_px=7.5, cy_px=5.5)
SENSORS = [
    SensorSpec("depth", kind="depth", intrinsics=CAMERA, overload_policy="block"),
    SensorSpec("rgbd", kind="rgbd", intrinsics=CAMERA, overload_policy="block"),
    SensorSpec("lidar", kind="lidar3d", overload_policy="block"),
    SensorSpec("laser", kind="lidar2d", overload_policy="block"),
    SensorSpec("imu", kind="imu", overload_policy="block"),
    SensorSpec("odom", kind="odometry", overload_policy="block"),
]
FIRST, SECOND = 1_000_000_000, 2_000_000_000
NAN, INF = float("nan"), float("inf")


def png16(width, height):
    """A grey 16-bit PNG, written by hand."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + b"\x07\xd0" * width for _ in range(height))
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(k, d) for k, d in parts)


def floats(*values):
    return np.array(values, np.float32).tobytes()


def depth(**changes):
    image = s.DepthImage(
        width_px=W,
        height_px=H,
        encoding=s.DEPTH_ENCODING_U16,
        metres_per_unit=0.001,
        data=np.full((H, W), 2000, np.uint16).tobytes(),
    )
    for name, value in changes.items():
        if value is None:
            image.ClearField(name)
        else:
            setattr(image, name, value)
    return image


def colour(**changes):
    image = s.ColourImage(width_px=W, height_px=H, encoding=s.COLOUR_ENCODING_RGB8, data=bytes(W * H * 3))
    for name, value in changes.items():
        setattr(image, name, value)
    return image


def of(sensor, *, stamp_ns=SECOND, **data):
    return s.SensorMessage(sensor_id=sensor, stamp_ns=stamp_ns, **data)


def of_depth(**changes):
    return of("depth", depth=depth(**changes))


def of_cloud(points, **changes):
    array = np.array(points, np.float32).reshape(-1, 3)
    message = of("lidar", cloud={"num_points": len(array), "positions": array.tobytes()})
    for name, value in changes.items():
        setattr(message.cloud, name, value)
    return message


def of_scan(**changes):
    scan = {
        "angle_min_rad": -1.0,
        "angle_increment_rad": 0.5,
        "range_min_m": 0.1,
        "range_max_m": 10.0,
        "ranges_m": floats(1, 2, 3, 4, 5),
    }
    return of("laser", scan=s.LaserScan(**(scan | changes)))


def of_odometry(rotation=(0.0, 0.0, 0.0, 1.0), translation=(0.0, 0.0, 0.0), covariance=None):
    message = of("odom")
    q, t = message.odometry.t_odom_base.rotation, message.odometry.t_odom_base.translation
    q.x, q.y, q.z, q.w = rotation
    t.x, t.y, t.z = translation
    if covariance is not None:
        message.odometry.covariance.values.extend(covariance)
    return message


def of_imu(rate):
    gravity = {"x": 0.0, "y": 0.0, "z": 9.81}
    turn = {"x": rate, "y": 0.0, "z": 0.0}
    return of("imu", imu={"angular_velocity_radps": turn, "linear_acceleration_mps2": gravity})


BAD, HUGE = "INVALID_ARGUMENT", "RESOURCE_EXHAUSTED"
LIMIT = 2**32 - 1
POINTS = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
IDENTITY = np.eye(6).ravel()
SKEWED = np.eye(6)
SKEWED[0, 1] = 0.5

# What is wrong: message, reason, field, code.
CASES = {
    "truncated image": (of_depth(data=bytes(W * H * 2 - 1)), "SIZE_MISMATCH", "depth.data", BAD),
    "too much data": (of_depth(data=bytes(W * H * 2 + 1)), "SIZE_MISMATCH", "depth.data", BAD),
    "no data": (of_depth(data=b""), "SIZE_MISMATCH", "depth.data", BAD),
    "stride too small": (
        of_depth(row_stride_bytes=2 * W - 2),
        "STRIDE_TOO_SMALL",
        "depth.row_stride_bytes",
        BAD,
    ),
    "stride that does not fit": (of_depth(row_stride_bytes=2 * W + 2), "SIZE_MISMATCH", "depth.data", BAD),
    "stride that overflows": (of_depth(row_stride_bytes=LIMIT), "SIZE_MISMATCH", "depth.data", BAD),
    "size that overflows": (
        of_depth(width_px=LIMIT, height_px=LIMIT),
        "IMAGE_TOO_LARGE",
        "depth.width_px",
        HUGE,
    ),
    "size that wraps to a small one": (
        of_depth(width_px=2**31, height_px=2**31),
        "IMAGE_TOO_LARGE",
        "depth.width_px",
        HUGE,
    ),
    "image without width": (of_depth(width_px=0), "IMAGE_EMPTY", "depth.width_px", BAD),
    "image without scale": (of_depth(metres_per_unit=None), "FIELD_MISSING", "depth.metres_per_unit", BAD),
    "scale that is no number": (of_depth(metres_per_unit=NAN), "OUT_OF_RANGE", "depth.metres_per_unit", BAD),
    "scale of zero": (of_depth(metres_per_unit=0.0), "OUT_OF_RANGE", "depth.metres_per_unit", BAD),
    "encoding left out": (of_depth(encoding=0), "ENUM_UNKNOWN", "depth.encoding", BAD),
    "encoding of the future": (of_depth(encoding=99), "ENUM_UNKNOWN", "depth.encoding", BAD),
    "png of another size": (
        of_depth(encoding=s.DEPTH_ENCODING_PNG16, data=png16(W + 1, H)),
        "IMAGE_SIZE_MISMATCH",
        "depth.width_px",
        BAD,
    ),
    "truncated png": (
        of_depth(encoding=s.DEPTH_ENCODING_PNG16, data=png16(W, H)[:50]),
        "FILE_INVALID",
        "depth.data",
        BAD,
    ),
    "noise for a png": (
        of_depth(encoding=s.DEPTH_ENCODING_PNG16, data=bytes(range(200))),
        "FILE_INVALID",
        "depth.data",
        BAD,
    ),
    "size other than declared": (
        of_depth(width_px=W // 2, data=bytes(W * H)),
        "INTRINSICS_MISMATCH",
        "width_px",
        BAD,
    ),
    "colour of another size": (
        of("rgbd", rgbd={"depth": depth(), "colour": colour(height_px=H - 1, data=bytes(W * (H - 1) * 3))}),
        "COLOUR_SIZE_MISMATCH",
        "rgbd.colour",
        BAD,
    ),
    "truncated colour": (
        of("rgbd", rgbd={"depth": depth(), "colour": colour(data=bytes(5))}),
        "SIZE_MISMATCH",
        "rgbd.colour.data",
        BAD,
    ),
    "colour that is no jpeg": (
        of("rgbd", rgbd={"depth": depth(), "colour": colour(encoding=s.COLOUR_ENCODING_JPEG)}),
        "FILE_INVALID",
        "rgbd.colour.data",
        BAD,
    ),
    "rgbd without colour": (of("rgbd", rgbd={"depth": depth()}), "FIELD_MISSING", "rgbd.colour", BAD),
    "message without data": (of("depth"), "FIELD_MISSING", "data", BAD),
    "data of another kind": (
        of("depth", cloud={"num_points": 3, "positions": floats(*np.ravel(POINTS))}),
        "SENSOR_KIND_MISMATCH",
        "data",
        BAD,
    ),
    "negative stamp": (of("depth", stamp_ns=-1, depth=depth()), "STAMP_NEGATIVE", "stamp_ns", BAD),
    "stamp that goes back": (
        of("depth", stamp_ns=FIRST - 1, depth=depth()),
        "STAMP_NOT_INCREASING",
        "stamp_ns",
        BAD,
    ),
    "cloud without points": (of_cloud([]), "CLOUD_EMPTY", "cloud", BAD),
    "cloud without returns": (of_cloud([[NAN] * 3, [INF, 0, 0]]), "CLOUD_EMPTY", "cloud", BAD),
    "cloud of one point": (of_cloud(POINTS[:1]), "CLOUD_DEGENERATE", "cloud", BAD),
    "cloud of equal points": (of_cloud([POINTS[0]] * 50), "CLOUD_DEGENERATE", "cloud", BAD),
    "cloud timed in milliseconds": (
        of_cloud(POINTS, time_offsets_s=floats(*[99.5] * len(POINTS))),
        "TIME_OFFSET_TOO_LARGE",
        "cloud.time_offsets_s",
        BAD,
    ),
    "cloud that lies": (of_cloud(POINTS, num_points=4), "SIZE_MISMATCH", "cloud.positions", BAD),
    "cloud of 4 billion points": (
        of_cloud(POINTS, num_points=LIMIT),
        "CLOUD_TOO_LARGE",
        "cloud.num_points",
        HUGE,
    ),
    "channel that is short": (
        of_cloud(POINTS, intensities=floats(1, 2)),
        "SIZE_MISMATCH",
        "cloud.intensities",
        BAD,
    ),
    "colours that are short": (of_cloud(POINTS, colours=bytes(8)), "SIZE_MISMATCH", "cloud.colours", BAD),
    "scan without beams": (of_scan(ranges_m=b""), "SCAN_EMPTY", "scan.ranges_m", BAD),
    "scan of half a beam": (of_scan(ranges_m=bytes(6)), "SCAN_EMPTY", "scan.ranges_m", BAD),
    "scan of one echo and a half": (
        of_scan(later_echoes_m=floats(1, 2)),
        "SIZE_MISMATCH",
        "scan.later_echoes_m",
        BAD,
    ),
    "scan without an angle": (of_scan(angle_min_rad=NAN), "OUT_OF_RANGE", "scan.angle_min_rad", BAD),
    "scan of one direction": (
        of_scan(angle_increment_rad=0.0),
        "OUT_OF_RANGE",
        "scan.angle_increment_rad",
        BAD,
    ),
    "scan with swapped range": (of_scan(range_max_m=0.05), "OUT_OF_RANGE", "scan.range_max_m", BAD),
    "scan with infinite range": (of_scan(range_max_m=INF), "OUT_OF_RANGE", "scan.range_max_m", BAD),
    "quaternion off by 1 percent": (
        of_odometry(rotation=(0.0, 0.0, 0.0, 1.01)),
        "QUATERNION_NOT_UNIT",
        "odometry.t_odom_base",
        BAD,
    ),
    "quaternion of zeros": (
        of_odometry(rotation=(0.0, 0.0, 0.0, 0.0)),
        "QUATERNION_NOT_UNIT",
        "odometry.t_odom_base",
        BAD,
    ),
    "position that is no number": (
        of_odometry(translation=(NAN, 0.0, 0.0)),
        "OUT_OF_RANGE",
        "odometry.t_odom_base",
        BAD,
    ),
    "covariance of 35 numbers": (
        of_odometry(covariance=IDENTITY[:35]),
        "SIZE_MISMATCH",
        "odometry.covariance",
        BAD,
    ),
    "covariance that is not symmetric": (
        of_odometry(covariance=SKEWED.ravel()),
        "COVARIANCE_NOT_SYMMETRIC",
        "odometry.covariance",
        BAD,
    ),
    "infinite turn": (of_imu(INF), "OUT_OF_RANGE", "imu.angular_velocity_radps", BAD),
    "turn in degrees": (of_imu(180.0), "OUT_OF_RANGE", "imu.angular_velocity_radps", BAD),
    "turn that no gyro measures": (of_imu(-1e200), "OUT_OF_RANGE", "imu.angular_velocity_radps", BAD),
    "wheels that are nowhere": (
        of_odometry(translation=(1e200, 0.0, 0.0)),
        "OUT_OF_RANGE",
        "odometry.t_odom_base.translation",
        BAD,
    ),
    "unknown sensor": (
        of("nobody", depth=depth()),
        "SENSOR_NOT_FOUND",
        "sensor_id",
        "NOT_FOUND",
    ),
    "message over the limit": (
        of_depth(data=bytes(33 << 20)),
        "MESSAGE_TOO_LARGE",
        "",
        HUGE,
    ),
}


@pytest.fixture(scope="module")
def session(client):
    """A session with one good depth frame at FIRST."""
    session = client.sessions.create(sensors=SENSORS)
    array = np.full((H, W), 2000, np.uint16)
    session.send_depth("depth", stamp_ns=FIRST, depth=array, metres_per_unit=0.001)
    return session


def state_of(session):
    info = session.info()
    accepted = {x.spec.sensor_id: x.accepted for x in info.sensors}
    return info.pose, info.num_keyframes, info.map_version, accepted


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("door", DOORS, indirect=True)
def test_bad_messages_are_refused_precisely(door, case, session):
    message, reason, field, code = CASES[case]
    message = copy.deepcopy(message)
    message.session_id = session.session_id
    before = state_of(session)
    outcome = door.send(message)
    assert not outcome.accepted
    if door.tells_why:
        assert (outcome.reason, outcome.field, outcome.code) == (reason, field, code)
    assert state_of(session) == before, "the session was harmed"


@pytest.mark.parametrize("door", [d for d in DOORS if d != "zenoh"], indirect=True)
def test_unknown_sessions_and_impossible_names_are_refused(door, name):
    message = of_depth()
    message.session_id = name
    outcome = door.send(message)
    assert (outcome.reason, outcome.code) == ("SESSION_NOT_FOUND", "NOT_FOUND")
    message.session_id = "no spaces"
    assert door.send(message).reason == "ID_INVALID"


def test_what_is_good_is_still_taken_afterwards(client):
    """Both sides of the checks: the messages that the bad ones were made of."""
    session = client.sessions.create(sensors=SENSORS)
    good = [
        of_depth(),
        of("rgbd", rgbd={"depth": depth(), "colour": colour()}),
        of_cloud(POINTS),
        of_scan(),
        of_odometry(covariance=IDENTITY),
        of_imu(0.1),
    ]
    padded = np.zeros((H, W + 3), np.uint16)
    padded[:, :W] = 2000
    good.append(of_depth(row_stride_bytes=2 * (W + 3), data=padded.tobytes()))
    good.append(of_depth(encoding=s.DEPTH_ENCODING_PNG16, data=png16(W, H)))
    # Norms within 1e-3 are rounding, not a mistake.
    good.append(of_odometry(rotation=(0.0, 0.0, 0.0, 1.0005)))
    from percept import _rpc
    from percept._call import Call

    for i, message in enumerate(good):
        message.session_id, message.stamp_ns = session.session_id, SECOND + i
        request = _rpc.SEND_FRAME.request(message=message)
        session._transport.call(Call(_rpc.SEND_FRAME, request, lambda answer: answer))
    assert sum(x.accepted for x in session.sensors.list()) == len(good)
    assert sum(x.rejected for x in session.sensors.list()) == 0

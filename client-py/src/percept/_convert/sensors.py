"""Sensor declarations and frames."""

from __future__ import annotations

import time

from .. import _rpc
from .._arrays import Array, stamp
from .._call import Call
from ..errors import InvalidArgument
from ..types._value import told
from ..types.frames import (
    CameraFrame,
    CloudFrame,
    DepthFrame,
    EncodedImage,
    ImuFrame,
    OdometryFrame,
    RgbdFrame,
    ScanFrame,
    SensorFrame,
)
from ..types.geometry import CameraIntrinsics, Pose
from ..types.listing import Listing
from ..types.poses import FrameResult
from ..types.sensors import (
    ClockOffset,
    OverloadPolicy,
    Refusal,
    SensorKind,
    SensorSpec,
    SensorStatus,
    StreamFigures,
    StreamNote,
    StreamTrouble,
    StreamTroubleKind,
    StreamVerdict,
)
from ..v1 import geometry_pb2, sensor_pb2, sensors_service_pb2, session_pb2
from . import geometry, poses, words

_PNG = b"\x89PNG"
_JPEG = b"\xff\xd8"


def spec_to(spec: SensorSpec) -> sensor_pb2.SensorSpec:
    """A declaration as a message."""
    return sensor_pb2.SensorSpec(
        sensor_id=spec.sensor_id,
        kind=words.number("kind", sensor_pb2.SensorKind, spec.kind),
        t_base_sensor=geometry.pose_to(spec.t_base_sensor),
        intrinsics=None if spec.intrinsics is None else geometry.intrinsics_to(spec.intrinsics),
        time_offset_s=spec.time_offset_s,
        range_max_m=spec.range_max_m,
        overload_policy=words.number("overload_policy", sensor_pb2.OverloadPolicy, spec.overload_policy),
    )


def spec(message: sensor_pb2.SensorSpec) -> SensorSpec:
    """A declaration."""
    has_intrinsics = message.HasField("intrinsics")
    return told(
        SensorSpec,
        sensor_id=message.sensor_id,
        kind=words.word(SensorKind, sensor_pb2.SensorKind, message.kind),
        t_base_sensor=geometry.pose(message.t_base_sensor),
        intrinsics=geometry.intrinsics(message.intrinsics) if has_intrinsics else None,
        time_offset_s=message.time_offset_s,
        range_max_m=message.range_max_m if message.HasField("range_max_m") else None,
        overload_policy=words.word(OverloadPolicy, sensor_pb2.OverloadPolicy, message.overload_policy),
    )


def status(message: sensor_pb2.SensorStatus) -> SensorStatus:
    """What the server sees of a stream."""
    return SensorStatus(
        spec=spec(message.spec),
        accepted=message.accepted,
        rejected=message.rejected,
        dropped=message.dropped,
        gaps=message.gaps,
        rate_hz=message.rate_hz if message.HasField("rate_hz") else None,
        last_stamp_ns=message.last_stamp_ns if message.HasField("last_stamp_ns") else None,
        verdict=words.word(StreamVerdict, sensor_pb2.StreamVerdict, message.verdict),
        troubles=tuple(_trouble(t) for t in message.troubles),
        verdict_message=message.verdict_message,
        etag=message.etag,
        clock_offset_s=message.clock_offset_s if message.HasField("clock_offset_s") else None,
        figures=_figures(message.figures),
        refusals=tuple(Refusal(reason=r.reason, count=r.count, message=r.message) for r in message.refusals),
    )


def note(message: session_pb2.StreamNote) -> StreamNote:
    """What is to be said of a stream."""
    return StreamNote(stream=message.stream, message=message.message, time_ns=message.time_ns)


def _figures(message: sensor_pb2.StreamFigures) -> StreamFigures:
    return StreamFigures(
        arrival_rate_hz=message.arrival_rate_hz if message.HasField("arrival_rate_hz") else None,
        jitter_s=message.jitter_s if message.HasField("jitter_s") else None,
        longest_interval_s=message.longest_interval_s if message.HasField("longest_interval_s") else None,
        delay_s=message.delay_s if message.HasField("delay_s") else None,
        quiet_s=message.quiet_s if message.HasField("quiet_s") else None,
        frame_bytes=message.frame_bytes if message.HasField("frame_bytes") else None,
        latency_p50_s=message.latency_p50_s if message.HasField("latency_p50_s") else None,
        latency_p95_s=message.latency_p95_s if message.HasField("latency_p95_s") else None,
        measured_ratio=message.measured_ratio if message.HasField("measured_ratio") else None,
        median_range_m=message.median_range_m if message.HasField("median_range_m") else None,
    )


def _trouble(message: sensor_pb2.StreamTrouble) -> StreamTrouble:
    kind = words.word(StreamTroubleKind, sensor_pb2.StreamTroubleKind, message.kind)
    return StreamTrouble(kind=kind, message=message.message)


def fill_depth(
    out: sensor_pb2.DepthImage, image: Array | EncodedImage, metres_per_unit: float | None
) -> None:
    """A depth image: uint16, float32, or a PNG."""
    if isinstance(image, EncodedImage):
        out.encoding, out.data = sensor_pb2.DEPTH_ENCODING_PNG16, image.data
        out.height_px, out.width_px = image.height_px, image.width_px
    else:
        units = image.dtype.kind == "u"
        out.encoding = sensor_pb2.DEPTH_ENCODING_U16 if units else sensor_pb2.DEPTH_ENCODING_F32
        out.data = image.tobytes()
        out.height_px, out.width_px = image.shape
    if metres_per_unit is not None:
        out.metres_per_unit = metres_per_unit


def fill_colour(out: sensor_pb2.ColourImage, image: Array | EncodedImage) -> None:
    """A colour image: RGB8, grey, JPEG or PNG, told by its first bytes."""
    if not isinstance(image, EncodedImage):
        grey = image.ndim == 2
        out.encoding = sensor_pb2.COLOUR_ENCODING_GREY8 if grey else sensor_pb2.COLOUR_ENCODING_RGB8
        out.data = image.tobytes()
        out.height_px, out.width_px = image.shape[:2]
        return
    if image.data.startswith(_PNG):
        out.encoding = sensor_pb2.COLOUR_ENCODING_PNG
    elif image.data.startswith(_JPEG):
        out.encoding = sensor_pb2.COLOUR_ENCODING_JPEG
    else:
        message = "colour is neither a PNG nor a JPEG by its first bytes; encode it as one of them"
        raise InvalidArgument(message, reason="FILE_INVALID", field="colour")
    out.data, out.height_px, out.width_px = image.data, image.height_px, image.width_px


def frame_to(session_id: str, frame: SensorFrame, sequence: int = 0) -> sensor_pb2.SensorMessage:
    """A frame as a message; `sequence` 0 is not numbered."""
    out = sensor_pb2.SensorMessage()
    fill_frame(out, session_id, frame, sequence)
    return out


def fill_frame(out: sensor_pb2.SensorMessage, session_id: str, frame: SensorFrame, sequence: int = 0) -> None:
    """Writes a frame where it will be sent from: an image put into one message after another is copied
    each time."""
    out.session_id, out.sensor_id = session_id, frame.sensor_id
    out.stamp_ns, out.sequence = stamp(frame.stamp_ns), sequence
    match frame:
        case DepthFrame():
            fill_depth(out.depth, frame.depth, frame.metres_per_unit)
        case RgbdFrame():
            fill_depth(out.rgbd.depth, frame.depth, frame.metres_per_unit)
            fill_colour(out.rgbd.colour, frame.colour)
        case CameraFrame():
            fill_colour(out.colour, frame.colour)
        case CloudFrame():
            geometry.fill_cloud(out.cloud, frame.cloud)
        case ScanFrame():
            out.scan.CopyFrom(_scan_to(frame))
        case ImuFrame():
            out.imu.CopyFrom(_imu_to(frame))
        case OdometryFrame():
            out.odometry.CopyFrom(_odometry_to(frame))


def _scan_to(scan: ScanFrame) -> sensor_pb2.LaserScan:
    return sensor_pb2.LaserScan(
        angle_min_rad=scan.angle_min_rad,
        angle_increment_rad=scan.angle_increment_rad,
        range_min_m=scan.range_min_m,
        range_max_m=scan.range_max_m,
        time_increment_s=scan.time_increment_s,
        ranges_m=scan.ranges_m.tobytes(),
        intensities=None if scan.intensities is None else scan.intensities.tobytes(),
        later_echoes_m=None if scan.later_echoes_m is None else scan.later_echoes_m.tobytes(),
    )


def _imu_to(imu: ImuFrame) -> sensor_pb2.ImuSample:
    return sensor_pb2.ImuSample(
        angular_velocity_radps=geometry.vector3_to("angular_velocity_radps", imu.angular_velocity_radps),
        linear_acceleration_mps2=geometry.vector3_to(
            "linear_acceleration_mps2", imu.linear_acceleration_mps2
        ),
    )


def _odometry_to(odometry: OdometryFrame) -> sensor_pb2.OdometrySample:
    out = sensor_pb2.OdometrySample(t_odom_base=geometry.pose_to(odometry.t_odom_base))
    if odometry.covariance is not None:
        out.covariance.CopyFrom(geometry_pb2.Covariance6(values=odometry.covariance.ravel().tolist()))
    return out


def declare(
    session_id: str, sensor: SensorSpec
) -> Call[sensors_service_pb2.DeclareSensorRequest, sensors_service_pb2.DeclareSensorResponse, SensorStatus]:
    request = sensors_service_pb2.DeclareSensorRequest(session_id=session_id, spec=spec_to(sensor))
    return Call(_rpc.DECLARE_SENSOR, request, lambda a: status(a.sensor))


def list_sensors(
    session_id: str,
) -> Call[
    sensors_service_pb2.ListSensorsRequest, sensors_service_pb2.ListSensorsResponse, Listing[SensorStatus]
]:
    request = sensors_service_pb2.ListSensorsRequest(session_id=session_id)
    return Call(_rpc.LIST_SENSORS, request, lambda a: Listing([status(s) for s in a.sensors]))


def get(
    session_id: str, sensor_id: str
) -> Call[sensors_service_pb2.GetSensorRequest, sensors_service_pb2.GetSensorResponse, SensorStatus]:
    request = sensors_service_pb2.GetSensorRequest(session_id=session_id, sensor_id=sensor_id)
    return Call(_rpc.GET_SENSOR, request, lambda a: status(a.sensor))


def update(
    session_id: str,
    sensor_id: str,
    t_base_sensor: Pose | None,
    intrinsics: CameraIntrinsics | None,
    time_offset_s: float | None,
    overload_policy: OverloadPolicy | str | None,
    etag: str,
) -> Call[sensors_service_pb2.UpdateSensorRequest, sensors_service_pb2.UpdateSensorResponse, SensorStatus]:
    request = sensors_service_pb2.UpdateSensorRequest(session_id=session_id, etag=etag)
    changed, paths = request.spec, request.update_mask.paths
    changed.sensor_id = sensor_id
    if t_base_sensor is not None:
        changed.t_base_sensor.CopyFrom(geometry.pose_to(t_base_sensor, "t_base_sensor"))
        paths.append("t_base_sensor")
    if intrinsics is not None:
        changed.intrinsics.CopyFrom(geometry.intrinsics_to(intrinsics))
        paths.append("intrinsics")
    if time_offset_s is not None:
        changed.time_offset_s = time_offset_s
        paths.append("time_offset_s")
    if overload_policy is not None:
        changed.overload_policy = words.number("overload_policy", sensor_pb2.OverloadPolicy, overload_policy)
        paths.append("overload_policy")
    return Call(_rpc.UPDATE_SENSOR, request, lambda a: status(a.sensor))


def send(
    session_id: str, frame: SensorFrame
) -> Call[sensors_service_pb2.SendFrameRequest, sensors_service_pb2.SendFrameResponse, FrameResult]:
    request = sensors_service_pb2.SendFrameRequest()
    fill_frame(request.message, session_id, frame)
    return Call(_rpc.SEND_FRAME, request, lambda a: poses.result(a.result))


def sync_time() -> Call[
    sensors_service_pb2.SyncTimeRequest, sensors_service_pb2.SyncTimeResponse, ClockOffset
]:
    def offset(answer: sensors_service_pb2.SyncTimeResponse) -> ClockOffset:
        received = time.time_ns()
        middle = (answer.client_send_ns + received) // 2
        return ClockOffset(
            offset_ns=answer.server_ns - middle, round_trip_ns=received - answer.client_send_ns
        )

    request = sensors_service_pb2.SyncTimeRequest(client_send_ns=time.time_ns())
    return Call(_rpc.SYNC_TIME, request, offset)

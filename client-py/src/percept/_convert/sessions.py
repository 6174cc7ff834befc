"""Sessions, poses, trajectories, events."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from .. import _rpc
from .._arrays import Array
from .._call import Call, ChunkedCall, PagedCall
from ..errors import InvalidArgument, WrongType
from ..types.geometry import Pose
from ..types.navigation import Zone, ZoneMask
from ..types.poses import PoseAt, PoseEstimate, Scale, TrackingState, Transform
from ..types.sensors import SensorSpec
from ..types.sessions import (
    AnyEvent,
    Event,
    FleetEvent,
    FleetEventKind,
    Keyframe,
    LifeStep,
    MapChanged,
    Resync,
    SessionEvent,
    SessionFault,
    SessionInfo,
    SessionLife,
    SessionMode,
    SessionState,
    SessionUpdated,
    Trajectory,
)
from ..v1 import error_pb2, params_pb2, session_pb2
from ..v1 import sessions_service_pb2 as service
from . import geometry, maps, navigation, poses, recordings, scene, sensors, words, zones


def watch(
    session_id: str,
    kinds: Sequence[FleetEventKind | str],
    label: str,
    text: str,
    low: Sequence[float] | None,
    high: Sequence[float] | None,
) -> service.WatchSessionRequest:
    """Which events are watched."""
    region = geometry.box3_to("objects.region", low, high)
    objects = service.ObjectWatch(label=label, text=text, region=region)
    return service.WatchSessionRequest(
        session_id=session_id,
        kinds=[words.number("kinds", session_pb2.FleetEventKind, kind) for kind in kinds],
        objects=objects if label or text or region is not None else None,
    )


def session_info(message: session_pb2.Session) -> SessionInfo:
    """A session."""
    return SessionInfo(
        session_id=message.session_id,
        display_name=message.display_name,
        mode=words.word(SessionMode, session_pb2.SessionMode, message.mode),
        create_time_ns=message.create_time_ns,
        params=words.tree_of(message.params) if message.HasField("params") else None,
        sensors=tuple(sensors.status(s) for s in message.sensors),
        pose=poses.pose_estimate(message.pose) if message.HasField("pose") else None,
        num_keyframes=message.num_keyframes,
        num_objects=message.num_objects,
        map_version=message.map_version,
        queue_length=message.queue_length,
        state=words.word(SessionState, session_pb2.SessionState, message.state),
        fault=_fault(message.fault) if message.HasField("fault") else None,
        last_used_ns=message.last_used_ns,
        last_stamp_ns=message.last_stamp_ns if message.HasField("last_stamp_ns") else None,
        tenant=message.tenant,
        labels=dict(message.labels),
        etag=message.etag,
        zones=tuple(navigation.zone(z) for z in message.zones),
        zone_masks=tuple(zones.mask(m) for m in message.zone_masks),
        stream_notes=tuple(sensors.note(n) for n in message.stream_notes),
        recorded=message.recorded,
        recording=recordings.recording(message.recording) if message.HasField("recording") else None,
    )


def _fault(message: error_pb2.ErrorInfo) -> SessionFault:
    return SessionFault(reason=message.reason, message=message.message)


def keyframe(message: session_pb2.Keyframe) -> Keyframe:
    """A keyframe."""
    return Keyframe(
        keyframe_id=message.keyframe_id,
        stamp_ns=message.stamp_ns,
        sensor_id=message.sensor_id,
        t_map_base=geometry.pose(message.t_map_base),
        num_points=message.num_points,
    )


def trajectory(chunks: Sequence[service.GetTrajectoryResponse]) -> Trajectory:
    """A trajectory of its chunks."""
    entries = [p for chunk in chunks for p in chunk.poses]
    states = {n: words.word(TrackingState, session_pb2.TrackingState, n) for n in {p.state for p in entries}}
    each = [geometry.pose(p.t_map_base) for p in entries]
    return Trajectory(
        stamps_ns=np.array([p.stamp_ns for p in entries], dtype=np.int64),
        positions=np.array([p.translation for p in each]).reshape(-1, 3),
        rotations=np.array([p.rotation for p in each]).reshape(-1, 4),
        states=tuple(states[p.state] for p in entries),
        scales=tuple(words.word(Scale, session_pb2.Scale, p.scale) for p in entries),
        keyframe_ids=tuple(p.keyframe_id if p.HasField("keyframe_id") else None for p in entries),
        map_version=chunks[-1].map_version if chunks else 0,
        next_page_token=chunks[-1].next_page_token if chunks else "",
    )


def event(message: session_pb2.SessionEvent) -> SessionEvent:
    """An event."""
    return SessionEvent(token=message.token, stamp_ns=message.stamp_ns, event=_event(message))


def fleet_event(message: session_pb2.FleetEvent) -> FleetEvent:
    """An event of any session."""
    return FleetEvent(
        token=message.token,
        session_id=message.session_id,
        stamp_ns=message.stamp_ns,
        event=_any_event(message),
    )


def _any_event(message: session_pb2.FleetEvent) -> AnyEvent | None:
    match message.WhichOneof("event"):
        case "life":
            return SessionLife(
                step=words.word(LifeStep, session_pb2.LifeStep, message.life.step),
                state=words.word(SessionState, session_pb2.SessionState, message.life.state),
            )
        case "new_etag":
            return SessionUpdated(etag=message.new_etag)
        case _:
            return _event(message)


def watch_sessions(
    pattern: str, kinds: Sequence[FleetEventKind | str], resume_token: int | None
) -> service.WatchSessionsRequest:
    return service.WatchSessionsRequest(
        session_pattern=pattern,
        kinds=[words.number("kinds", session_pb2.FleetEventKind, kind) for kind in kinds],
        resume_token=resume_token,
    )


def _event(message: session_pb2.SessionEvent | session_pb2.FleetEvent) -> Event | None:
    match message.WhichOneof("event"):
        case "pose":
            return poses.pose_estimate(message.pose)
        case "keyframe_added":
            return keyframe(message.keyframe_added)
        case "object_changed":
            return scene.object_change(message.object_changed)
        case "loop_changed":
            return maps.loop(message.loop_changed)
        case "map_version":
            return MapChanged(map_version=message.map_version)
        case "resync":
            return Resync(missed=message.resync.missed)
        case _:
            return None


def create(
    session_id: str | None,
    display_name: str,
    mode: SessionMode | str,
    specs: Sequence[SensorSpec],
    params: Mapping[str, object] | None,
    labels: Mapping[str, str] | None,
    request_id: str | None,
) -> Call[service.CreateSessionRequest, service.CreateSessionResponse, SessionInfo]:
    if not (session_id is None or isinstance(session_id, str)):
        message = f"session_id is {session_id!r}; give an id, e.g. 'robot-7', or none to have one chosen"
        raise WrongType(message, reason="ID_INVALID", field="session_id")
    if not isinstance(specs, Iterable) or not all(isinstance(spec, SensorSpec) for spec in specs):
        message = f"sensors is {specs!r:.200}; give a list of SensorSpec"
        raise WrongType(message, reason="ARGUMENT_INVALID", field="sensors")
    request = service.CreateSessionRequest(
        session_id=session_id,
        display_name=display_name,
        mode=words.number("mode", session_pb2.SessionMode, mode),
        sensors=[sensors.spec_to(s) for s in specs],
        params=words.message_of("params", params_pb2.PipelineParams, params),
        labels=labels,
        # Of our own making if need be, so that the call can be repeated when the answer got lost.
        request_id=uuid.uuid4().hex if request_id is None else request_id,
    )
    return Call(_rpc.CREATE_SESSION, request, lambda a: session_info(a.session))


def update(
    session_id: str,
    display_name: str | None,
    labels: Mapping[str, str] | None,
    params: Mapping[str, object] | None,
    areas: Sequence[Zone] | None,
    masks: Sequence[ZoneMask] | None,
    etag: str,
) -> Call[service.UpdateSessionRequest, service.UpdateSessionResponse, SessionInfo]:
    request = service.UpdateSessionRequest(etag=etag)
    changed, paths = request.session, request.update_mask.paths
    changed.session_id = session_id
    if display_name is not None:
        changed.display_name = display_name
        paths.append("display_name")
    if labels is not None:
        changed.labels.update(labels)
        paths.append("labels")
    if areas is not None:
        changed.zones.extend(navigation.zone_to(z) for z in areas)
        paths.append("zones")
    if masks is not None:
        changed.zone_masks.extend(zones.mask_to(m) for m in masks)
        paths.append("zone_masks")
    if params is not None:
        given, named = words.set_leaves(params)
        changed.params.CopyFrom(words.message_of("params", params_pb2.PipelineParams, given))
        paths.extend(f"params.{path}" for path in named)
    if not paths:
        message = "nothing is to change; give display_name, labels, zones, zone_masks or params"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="update_mask")
    return Call(_rpc.UPDATE_SESSION, request, lambda a: session_info(a.session))


def get(
    session_id: str,
) -> Call[service.GetSessionRequest, service.GetSessionResponse, SessionInfo]:
    request = service.GetSessionRequest(session_id=session_id)
    return Call(_rpc.GET_SESSION, request, lambda a: session_info(a.session))


def list_sessions(
    state: SessionState | str | None, pattern: str, labels: str, order_by: str, page_size: int
) -> PagedCall[service.ListSessionsRequest, service.ListSessionsResponse, SessionInfo]:
    request = service.ListSessionsRequest(
        session_pattern=pattern, label_selector=labels, order_by=order_by, page_size=page_size
    )
    if state is not None:
        request.state = words.number("state", session_pb2.SessionState, state)
    return PagedCall(_rpc.LIST_SESSIONS, request, lambda a: [session_info(s) for s in a.sessions])


def delete(
    session_id: str,
) -> Call[service.DeleteSessionRequest, service.DeleteSessionResponse, None]:
    return Call(_rpc.DELETE_SESSION, service.DeleteSessionRequest(session_id=session_id), lambda _: None)


def pose(
    session_id: str,
) -> Call[service.GetPoseRequest, service.GetPoseResponse, PoseEstimate | None]:
    request = service.GetPoseRequest(session_id=session_id)
    return Call(_rpc.GET_POSE, request, lambda a: poses.pose_estimate(a.pose) if a.HasField("pose") else None)


def pose_at(session_id: str, at_ns: int) -> Call[service.GetPoseRequest, service.GetPoseResponse, PoseAt]:
    request = service.GetPoseRequest(session_id=session_id, at_ns=at_ns)
    return Call(_rpc.GET_POSE, request, lambda a: poses.pose_at(a.pose_at))


def set_pose(
    session_id: str, t_map_base: Pose | Array
) -> Call[service.SetPoseRequest, service.SetPoseResponse, PoseEstimate]:
    request = service.SetPoseRequest(
        session_id=session_id, t_map_base=geometry.pose_to(t_map_base, "t_map_base")
    )
    return Call(_rpc.SET_POSE, request, lambda a: poses.pose_estimate(a.pose))


def transform(
    session_id: str, target_frame: str, source_frame: str, at_ns: int | None
) -> Call[service.LookupTransformRequest, service.LookupTransformResponse, Transform]:
    request = service.LookupTransformRequest(
        session_id=session_id, target_frame=target_frame, source_frame=source_frame, at_ns=at_ns
    )
    return Call(_rpc.LOOKUP_TRANSFORM, request, lambda a: poses.transform(a.transform))


def get_trajectory(
    session_id: str,
    from_ns: int | None,
    to_ns: int | None,
    max_poses: int,
    page_size: int,
    page_token: str,
) -> ChunkedCall[service.GetTrajectoryRequest, service.GetTrajectoryResponse, Trajectory]:
    request = service.GetTrajectoryRequest(
        session_id=session_id,
        from_ns=from_ns,
        to_ns=to_ns,
        max_poses=max_poses,
        page_size=page_size,
        page_token=page_token,
    )
    return ChunkedCall(_rpc.GET_TRAJECTORY, request, trajectory)


def keyframes(
    session_id: str, page_size: int
) -> PagedCall[service.ListKeyframesRequest, service.ListKeyframesResponse, Keyframe]:
    request = service.ListKeyframesRequest(session_id=session_id, page_size=page_size)
    return PagedCall(_rpc.LIST_KEYFRAMES, request, lambda a: [keyframe(k) for k in a.keyframes])


def default_params() -> Call[
    service.GetDefaultParamsRequest, service.GetDefaultParamsResponse, dict[str, object]
]:
    request = service.GetDefaultParamsRequest()
    return Call(_rpc.GET_DEFAULT_PARAMS, request, lambda a: words.tree_of(a.params))

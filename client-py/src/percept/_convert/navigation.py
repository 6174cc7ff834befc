"""Paths, or why there is none."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from .. import _rpc
from .._arrays import number
from .._call import Call
from ..errors import WrongType
from ..types.frames import SensorFrame
from ..types.geometry import FloorPoint, OrientedBox, Pose, as_pose
from ..types.maps import MapStamp
from ..types.navigation import (
    Blocking,
    BlockingState,
    Misfit,
    MisfitReason,
    Navigation,
    NoPath,
    NoPathReason,
    Path,
    PathChange,
    PathOptions,
    PathUpdate,
    RoomRoute,
    RouteStep,
    StoreyOptions,
    Zone,
)
from ..v1 import geometry_pb2, layers_service_pb2, params_pb2, path_pb2, scene_service_pb2
from ..v1 import navigation_service_pb2 as service
from . import geometry, maps, poses, scene, sensors, words


def path(message: path_pb2.Path, stamp: MapStamp | None) -> Path:
    """A path."""
    points = message.waypoints
    waypoints = np.array([(p.x_m, p.y_m) for p in points], dtype=np.float64)
    clearances = [p.clearance_m if p.HasField("clearance_m") else np.inf for p in points]
    return Path(
        waypoints=waypoints.reshape(-1, 2),
        yaws_rad=np.array([p.yaw_rad for p in points], np.float64),
        length_m=message.length_m,
        cost=message.cost,
        min_clearance_m=message.min_clearance_m,
        clearances_m=np.array(clearances, np.float64),
        times_s=np.array([p.time_s for p in points], np.float64),
        is_reverse=np.array([p.is_reverse for p in points], bool),
        clearance_cost=message.clearance_cost,
        steering_cost=message.steering_cost,
        duration_s=message.duration_s,
        bound=message.bound if message.HasField("bound") else None,
        is_final=message.is_final,
        stamp=stamp,
    )


def _blocking(message: path_pb2.Blocking) -> Blocking:
    return Blocking(
        position=geometry.vector2(message.position),
        obstacle=geometry.vector2(message.obstacle),
        state=words.word(BlockingState, path_pb2.BlockingState, message.state),
        object_id=message.object_id if message.HasField("object_id") else None,
    )


def no_path(message: path_pb2.NoPath, stamp: MapStamp | None) -> NoPath:
    """Why there is no path."""
    return NoPath(
        reason=words.word(NoPathReason, path_pb2.NoPathReason, message.reason),
        detail=message.detail,
        blocking=_blocking(message.blocking) if message.HasField("blocking") else None,
        stamp=stamp,
    )


def misfit(message: path_pb2.Misfit) -> Misfit:
    """Where a path does not fit."""
    pose = message.pose
    return Misfit(
        pose_index=message.pose_index,
        pose=Pose.from_xy_yaw(pose.x_m, pose.y_m, pose.yaw_rad),
        reason=words.word(MisfitReason, path_pb2.MisfitReason, message.reason),
        blocking=_blocking(message.blocking) if message.HasField("blocking") else None,
    )


def _corners(field: str, points: Sequence[Sequence[float]]) -> list[geometry_pb2.Vector2]:
    return [geometry.vector2_to(field, p) for p in points]


def zone_to(zone: Zone) -> path_pb2.Zone:
    """A zone as a message."""
    polygon = _corners("zones.polygon", zone.polygon)
    if zone.speed_share is None:
        return path_pb2.Zone(polygon=polygon, keep_out=True, name=zone.name)
    return path_pb2.Zone(polygon=polygon, speed_share=zone.speed_share, name=zone.name)


def zone(message: path_pb2.Zone) -> Zone:
    """A zone of a message."""
    share = message.speed_share if message.WhichOneof("kind") == "speed_share" else None
    return Zone(polygon=[(p.x, p.y) for p in message.polygon], speed_share=share, name=message.name)


def _storey(storey: StoreyOptions) -> path_pb2.StoreyOptions:
    return path_pb2.StoreyOptions(
        storey=words.number("storey", layers_service_pb2.Storey, storey.storey),
        near_z_m=storey.near_z_m,
        near_within_m=storey.near_within_m,
    )


def options_to(
    options: PathOptions | None, start: FloorPoint | None = None, goal: FloorPoint | None = None
) -> path_pb2.PathOptions | None:
    """Options as a message; headings that they leave open are those of ends that are poses."""
    if isinstance(start, Pose) or isinstance(goal, Pose):
        options = options or PathOptions()
        if isinstance(start, Pose) and options.start_yaw_rad is None:
            options = dataclasses.replace(options, start_yaw_rad=start.yaw_rad)
        if isinstance(goal, Pose) and options.goal_yaw_rad is None:
            options = dataclasses.replace(options, goal_yaw_rad=goal.yaw_rad)
    if options is None:
        return None
    speed, steering = options.speed, options.steering
    return path_pb2.PathOptions(
        planner=words.number("planner", path_pb2.Planner, options.planner),
        start_yaw_rad=options.start_yaw_rad,
        goal_yaw_rad=options.goal_yaw_rad,
        footprint=_corners("footprint", options.footprint),
        zones=[zone_to(z) for z in options.zones],
        speed=None if speed is None else path_pb2.SpeedLimits(**dataclasses.asdict(speed)),
        steering=None if steering is None else path_pb2.SteeringOptions(**dataclasses.asdict(steering)),
        deadline_ms=options.deadline_ms,
        ignore_session_zones=options.ignore_session_zones,
        map_only=options.map_only,
        storey=None if options.storey is None else _storey(options.storey),
    )


def poses_to(poses: Path | Sequence[Pose]) -> list[geometry_pb2.Pose2]:
    """Poses on the floor, or a path's, as messages."""
    if isinstance(poses, Path):
        rows = np.column_stack([poses.waypoints, poses.yaws_rad]).tolist()
    elif isinstance(poses, (Sequence, np.ndarray)) and not isinstance(poses, str):
        given = [as_pose(f"poses[{i}]", pose) for i, pose in enumerate(poses)]
        rows = [(*pose.translation[:2].tolist(), pose.yaw_rad) for pose in given]
    else:
        message = f"poses is {poses!r}; give a Path or a list of Pose"
        raise WrongType(message, reason="PATH_INVALID", field="poses")
    return [geometry_pb2.Pose2(x_m=x, y_m=y, yaw_rad=yaw) for x, y, yaw in rows]


def places_beside(box: OrientedBox, gap_m: float, start: FloorPoint | None) -> list[Pose]:
    """Poses around a box that look at its middle: at the gap from its sides, then farther, to twice that; of
    each distance, those nearest to the start first."""
    number("gap_m", gap_m, low=0, high=1e3, must="above 0 and at most 1000 m")
    here = box.centre[:2]
    if start is not None:
        place = geometry.floor_to("start", start)
        here = np.array([place.x, place.y])
    centre_x, centre_y = box.centre[:2].tolist()
    t_map_box = Pose.from_xy_yaw(centre_x, centre_y, box.t_frame_box.yaw_rad)
    ways = np.arange(12) * np.pi / 6
    along = np.stack([np.cos(ways), np.sin(ways), np.zeros(12)], axis=1)
    found = []
    for gap in (gap_m, 1.5 * gap_m, 2 * gap_m):
        # Where the ray from the middle leaves the rectangle.
        half = box.size_m[:2] / 2 + gap
        with np.errstate(divide="ignore"):
            reach = (half / np.abs(along[:, :2])).min(axis=1)
        places = t_map_box.apply(along * reach[:, None])[:, :2]
        for x, y in places[np.argsort(np.linalg.norm(places - here, axis=1), kind="stable")].tolist():
            found.append(Pose.from_xy_yaw(x, y, math.atan2(centre_y - y, centre_x - x)))
    return found


def _outcome(
    answer: service.PlanPathResponse | service.NavigateResponse | service.WatchPathResponse,
) -> Path | NoPath:
    stamp = maps.stamp(answer.stamp)
    return path(answer.path, stamp) if answer.HasField("path") else no_path(answer.no_path, stamp)


def update(answer: service.WatchPathResponse) -> PathUpdate:
    """What is told of a watched path."""
    return PathUpdate(
        change=words.word(PathChange, service.PathChange, answer.change),
        outcome=_outcome(answer),
        misfit=misfit(answer.misfit) if answer.HasField("misfit") else None,
        stamp=maps.stamp(answer.stamp),
    )


def route_to_room(
    session_id: str, to: int | str, start: FloorPoint | None
) -> Call[scene_service_pb2.RouteToRoomRequest, scene_service_pb2.RouteToRoomResponse, RoomRoute]:
    """The way to a room, by number or name."""
    request = scene_service_pb2.RouteToRoomRequest(session_id=session_id)
    if isinstance(to, str):
        request.room_name = to
    else:
        request.room_id = to
    if start is not None:
        request.start.CopyFrom(geometry.floor_to("start", start))
    return Call(_rpc.ROUTE_TO_ROOM, request, _route)


def _route(answer: scene_service_pb2.RouteToRoomResponse) -> RoomRoute:
    outcome = path(answer.path, None) if answer.HasField("path") else no_path(answer.no_path, None)
    steps = [
        RouteStep(room_id=s.room_id, label=s.label, door=scene.door(s.door) if s.HasField("door") else None)
        for s in answer.steps
    ]
    return RoomRoute(
        steps=tuple(steps), length_m=answer.length_m, goal=geometry.vector2(answer.goal), outcome=outcome
    )


def watch_request(
    session_id: str,
    goal: FloorPoint,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> service.WatchPathRequest:
    """A watch's question."""
    return service.WatchPathRequest(
        source=maps.source(session_id),
        goal=geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=options_to(options, goal=goal),
    )


def _navigation(answer: service.NavigateResponse) -> Navigation:
    return Navigation(
        frame=poses.result(answer.frame),
        pose=poses.pose_estimate(answer.pose) if answer.HasField("pose") else None,
        obstacles=tuple(scene.tracked(o) for o in answer.obstacles),
        outcome=_outcome(answer),
        stamp=maps.stamp(answer.stamp),
    )


def plan(
    session_id: str,
    goal: FloorPoint,
    start: FloorPoint | None,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.PlanPathRequest, service.PlanPathResponse, Path | NoPath]:
    request = service.PlanPathRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.floor_to("start", start),
        goal=geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=options_to(options, start, goal),
    )
    return Call(_rpc.PLAN_PATH, request, _outcome)


def validate(
    session_id: str,
    poses: Path | Sequence[Pose],
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.ValidatePathRequest, service.ValidatePathResponse, Misfit | None]:
    request = service.ValidatePathRequest(
        source=maps.source(session_id),
        poses=poses_to(poses),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=options_to(options),
    )
    return Call(_rpc.VALIDATE_PATH, request, lambda a: misfit(a.misfit) if a.HasField("misfit") else None)


def navigate(
    session_id: str,
    frame: SensorFrame,
    goal: FloorPoint,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.NavigateRequest, service.NavigateResponse, Navigation]:
    request = service.NavigateRequest(
        goal=geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=options_to(options, goal=goal),
    )
    sensors.fill_frame(request.message, session_id, frame)
    return Call(_rpc.NAVIGATE, request, _navigation)

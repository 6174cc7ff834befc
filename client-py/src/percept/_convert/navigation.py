"""Paths, or why there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .. import _rpc
from .._call import Call
from ..types.frames import SensorFrame
from ..types.navigation import Navigation, NoPath, NoPathReason, Path
from ..v1 import map_pb2, params_pb2, path_pb2
from ..v1 import navigation_service_pb2 as service
from . import geometry, maps, poses, scene, sensors, words


def path(message: path_pb2.Path, stamp: map_pb2.MapStamp) -> Path:
    """A path."""
    waypoints = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in message.waypoints], dtype=np.float64)
    return Path(
        waypoints=waypoints.reshape(-1, 3),
        length_m=message.length_m,
        cost=message.cost,
        min_clearance_m=message.min_clearance_m,
        stamp=maps.stamp(stamp),
    )


def _outcome(answer: service.PlanPathResponse | service.NavigateResponse) -> Path | NoPath:
    if answer.HasField("path"):
        return path(answer.path, answer.stamp)
    reason = words.word(NoPathReason, path_pb2.NoPathReason, answer.no_path.reason)
    return NoPath(reason=reason, detail=answer.no_path.detail, stamp=maps.stamp(answer.stamp))


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
    goal: Sequence[float],
    start: Sequence[float] | None,
    params: Mapping[str, object] | None,
) -> Call[service.PlanPathRequest, service.PlanPathResponse, Path | NoPath]:
    request = service.PlanPathRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.vector2_to("start", start),
        goal=geometry.vector2_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
    )
    return Call(_rpc.PLAN_PATH, request, _outcome)


def navigate(
    session_id: str, frame: SensorFrame, goal: Sequence[float], params: Mapping[str, object] | None
) -> Call[service.NavigateRequest, service.NavigateResponse, Navigation]:
    request = service.NavigateRequest(
        goal=geometry.vector2_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
    )
    sensors.fill_frame(request.message, session_id, frame)
    return Call(_rpc.NAVIGATE, request, _navigation)

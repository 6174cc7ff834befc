"""Pictures of paths, and of what became of a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .. import _rpc
from .._call import Call
from ..errors import InvalidArgument
from ..types.geometry import FloorPoint, Pose
from ..types.maps import MapComparison, MapStamp
from ..types.navigation import NoPath, Path, PathColouring, PathOptions, PathPicture
from ..v1 import maps_service_pb2, navigation_service_pb2, params_pb2, path_pb2, toolbox_planning_service_pb2
from . import geometry, maps, navigation, words
from .toolbox import planning


def _picture(
    answer: navigation_service_pb2.DrawPathResponse | toolbox_planning_service_pb2.DrawPathOnMapResponse,
    stamp: MapStamp | None,
) -> PathPicture:
    outcome: Path | NoPath | None = None
    if answer.HasField("path"):
        outcome = navigation.path(answer.path, stamp)
    elif answer.HasField("no_path"):
        outcome = navigation.no_path(answer.no_path, stamp)
    misfit = navigation.misfit(answer.misfit) if answer.HasField("misfit") else None
    return PathPicture(png=answer.png, outcome=outcome, misfit=misfit, stamp=stamp)


def _one_of(goal: FloorPoint | None, path: Path | Sequence[Pose] | None) -> None:
    if (goal is None) == (path is None):
        message = "give a goal to plan to, or a path to draw, and not both"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="goal")


def draw_path(
    session_id: str,
    goal: FloorPoint | None,
    path: Path | Sequence[Pose] | None,
    start: FloorPoint | None,
    colouring: PathColouring | str,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[navigation_service_pb2.DrawPathRequest, navigation_service_pb2.DrawPathResponse, PathPicture]:
    _one_of(goal, path)
    request = navigation_service_pb2.DrawPathRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.floor_to("start", start),
        goal=None if goal is None else geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=navigation.options_to(options, start, goal),
        poses=() if path is None else navigation.poses_to(path),
        colouring=words.number("colouring", path_pb2.PathColouring, colouring),
    )
    return Call(_rpc.DRAW_PATH, request, lambda a: _picture(a, maps.stamp(a.stamp)))


def draw_path_on_map(
    given: planning.Map,
    start: FloorPoint | None,
    goal: FloorPoint | None,
    path: Path | Sequence[Pose] | None,
    colouring: PathColouring | str,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[
    toolbox_planning_service_pb2.DrawPathOnMapRequest,
    toolbox_planning_service_pb2.DrawPathOnMapResponse,
    PathPicture,
]:
    _one_of(goal, path)
    request = toolbox_planning_service_pb2.DrawPathOnMapRequest(
        map=planning.map_to(given),
        start=None if start is None else geometry.floor_to("start", start),
        goal=None if goal is None else geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=navigation.options_to(options, start, goal),
        poses=() if path is None else navigation.poses_to(path),
        colouring=words.number("colouring", path_pb2.PathColouring, colouring),
    )
    return Call(_rpc.DRAW_PATH_ON_MAP, request, lambda a: _picture(a, None))


def compare_maps(
    session_id: str, before: planning.Map | None, other: str | None, tolerance_m: float | None
) -> Call[maps_service_pb2.CompareMapsRequest, maps_service_pb2.CompareMapsResponse, MapComparison]:
    if (before is None) == (other is None):
        message = "give a map to compare with, or before_session, and not both"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="before")
    request = maps_service_pb2.CompareMapsRequest(source=maps.source(session_id), tolerance_m=tolerance_m)
    if other is not None:
        request.session_id = other
    elif before is not None:
        given = planning.map_to(before)
        if given.HasField("nav2"):
            request.nav2.CopyFrom(given.nav2)
        else:
            request.grid.CopyFrom(given.grid)

    def read(answer: maps_service_pb2.CompareMapsResponse) -> MapComparison:
        return MapComparison(
            png=answer.png,
            num_appeared=answer.num_appeared,
            num_gone=answer.num_gone,
            num_newly_seen=answer.num_newly_seen,
            cell_area_m2=answer.cell_area_m2,
            stamp=maps.stamp(answer.stamp),
        )

    return Call(_rpc.COMPARE_MAPS, request, read)

"""Paths that cover, frontiers, paths in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .. import _rpc
from .._call import Call
from ..types.exploration import (
    CoverageOptions,
    CoveragePath,
    FlightOptions,
    FlightPath,
    Frontier,
    NoFlight,
)
from ..types.geometry import FloorPoint
from ..types.navigation import BlockingState, NoPath, NoPathReason, PathOptions
from ..v1 import layers_service_pb2, params_pb2, path_pb2
from ..v1 import navigation_service_pb2 as service
from . import geometry, maps, navigation, words


def coverage(
    session_id: str,
    start: FloorPoint | None,
    coverage: CoverageOptions,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.PlanCoverageRequest, service.PlanCoverageResponse, CoveragePath | NoPath]:
    request = service.PlanCoverageRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.floor_to("start", start),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=navigation.options_to(options, start),
        coverage=path_pb2.CoverageOptions(
            tool_width_m=coverage.tool_width_m,
            overlap=coverage.overlap,
            enough=coverage.enough,
            direction=words.number("direction", path_pb2.CoverageDirection, coverage.direction),
        ),
    )
    return Call(_rpc.PLAN_COVERAGE, request, _covered)


def _covered(answer: service.PlanCoverageResponse) -> CoveragePath | NoPath:
    stamp = maps.stamp(answer.stamp)
    if not answer.HasField("path"):
        return navigation.no_path(answer.no_path, stamp)
    found = answer.path
    return CoveragePath(
        path=navigation.path(found.path, stamp),
        leg_starts=np.array([leg.first_waypoint for leg in found.legs], np.int64),
        is_transit=np.array([leg.is_transit for leg in found.legs], bool),
        coverable_m2=found.coverable_m2,
        covered_share=found.covered_share,
        num_regions=found.num_regions,
    )


def frontiers(
    session_id: str,
    start: FloorPoint | None,
    min_length_m: float,
    gain: float,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.FindFrontiersRequest, service.FindFrontiersResponse, list[Frontier]]:
    request = service.FindFrontiersRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.floor_to("start", start),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        min_length_m=min_length_m,
        gain=gain,
        options=navigation.options_to(options, start),
    )
    return Call(_rpc.FIND_FRONTIERS, request, lambda a: [_frontier(f) for f in a.frontiers])


def _frontier(message: path_pb2.Frontier) -> Frontier:
    return Frontier(
        goal=geometry.vector2(message.goal),
        cost=message.cost,
        length_m=message.length_m,
        cells=np.array([(p.x, p.y) for p in message.cells], np.float64).reshape(-1, 2),
    )


def flight(
    session_id: str,
    goal: Sequence[float],
    start: Sequence[float] | None,
    region: layers_service_pb2.Box3 | None,
    options: FlightOptions,
) -> Call[service.PlanFlightRequest, service.PlanFlightResponse, FlightPath | NoFlight]:
    request = service.PlanFlightRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.vector3_to("start", start),
        goal=geometry.vector3_to("goal", goal),
        region=region,
        options=path_pb2.FlightOptions(
            planner=words.number("planner", path_pb2.FlightPlanner, options.planner),
            robot_radius_m=options.robot_radius_m,
            occupied_probability=options.occupied_probability,
            allow_unknown=options.allow_unknown,
            start_tolerance_m=options.start_tolerance_m,
            min_z_m=options.min_z_m,
            max_z_m=options.max_z_m,
            deadline_ms=options.deadline_ms,
            zones=[navigation.zone_to(z) for z in options.zones],
            ignore_session_zones=options.ignore_session_zones,
        ),
    )
    return Call(_rpc.PLAN_FLIGHT, request, _flown)


def _flown(answer: service.PlanFlightResponse) -> FlightPath | NoFlight:
    stamp = maps.stamp(answer.stamp)
    if answer.HasField("path"):
        found = answer.path
        return FlightPath(
            waypoints=np.array([(p.x, p.y, p.z) for p in found.waypoints], np.float64).reshape(-1, 3),
            length_m=found.length_m,
            min_clearance_m=found.min_clearance_m if found.HasField("min_clearance_m") else None,
            bound=found.bound,
            is_final=found.is_final,
            stamp=stamp,
        )
    none = answer.no_path
    return NoFlight(
        reason=words.word(NoPathReason, path_pb2.NoPathReason, none.reason),
        detail=none.detail,
        position=geometry.vector3(none.position) if none.HasField("position") else None,
        obstacle=geometry.vector3(none.obstacle) if none.HasField("obstacle") else None,
        state=words.word(BlockingState, path_pb2.BlockingState, none.state),
        stamp=stamp,
    )

"""Paths through maps that come with the question."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Mapping, Sequence

import numpy as np

from ... import _rpc
from ..._call import Call
from ...errors import InvalidArgument
from ...types.geometry import FloorPoint, Pose
from ...types.maps import OccupancyGrid
from ...types.navigation import GridMap, Misfit, NoPath, Path, PathOptions
from ...v1 import map_pb2, params_pb2
from ...v1 import toolbox_planning_service_pb2 as service
from .. import geometry, navigation, words

#: A map: cells with where they lie, or the yaml file of nav2's map server.
Map = GridMap | OccupancyGrid | str | os.PathLike[str]


def _files(path: pathlib.Path) -> service.Nav2Map:
    """A nav2 map's two files; the image is the one that the yaml names, beside it."""
    yaml = path.read_bytes()
    names = [
        line.split(b":", 1)[1].strip().strip(b"\"'")
        for line in yaml.splitlines()
        if line.startswith(b"image:")
    ]
    if not names:
        message = f"{path} names no image; give the yaml file of a nav2 map"
        raise InvalidArgument(message, reason="FILE_INVALID", field="map")
    return service.Nav2Map(yaml=yaml, image=(path.parent / os.fsdecode(names[0])).read_bytes())


def map_to(given: Map) -> service.GivenMap:
    """A map as a message."""
    if isinstance(given, (str, os.PathLike)):
        return service.GivenMap(nav2=_files(pathlib.Path(given)))
    cells = np.ascontiguousarray(given.cells, np.int8)
    if cells.ndim != 2:
        message = f"cells has the shape {cells.shape}; give (H, W)"
        raise InvalidArgument(message, reason="SIZE_MISMATCH", field="map.grid.cells")
    where = map_pb2.GridGeometry(
        resolution_m=given.resolution_m,
        origin=geometry.vector2_to("map.grid.geometry.origin", given.origin),
        width=cells.shape[1],
        height=cells.shape[0],
    )
    return service.GivenMap(grid=service.GridMap(geometry=where, cells=cells.tobytes()))


def plan_on_map(
    given: Map,
    start: FloorPoint,
    goal: FloorPoint,
    params: Mapping[str, object] | None,
    options: PathOptions | None,
) -> Call[service.PlanOnMapRequest, service.PlanOnMapResponse, Path | NoPath]:
    request = service.PlanOnMapRequest(
        map=map_to(given),
        start=geometry.floor_to("start", start),
        goal=geometry.floor_to("goal", goal),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=navigation.options_to(options, start, goal),
    )

    def read(answer: service.PlanOnMapResponse) -> Path | NoPath:
        if answer.HasField("path"):
            return navigation.path(answer.path, None)
        return navigation.no_path(answer.no_path, None)

    return Call(_rpc.PLAN_ON_MAP, request, read)


def validate_on_map(
    given: Map, poses: Path | Sequence[Pose], params: Mapping[str, object] | None, options: PathOptions | None
) -> Call[service.ValidateOnMapRequest, service.ValidateOnMapResponse, Misfit | None]:
    request = service.ValidateOnMapRequest(
        map=map_to(given),
        poses=navigation.poses_to(poses),
        params=words.message_of("params", params_pb2.PlanningParams, params),
        options=navigation.options_to(options),
    )
    return Call(
        _rpc.VALIDATE_ON_MAP, request, lambda a: navigation.misfit(a.misfit) if a.HasField("misfit") else None
    )

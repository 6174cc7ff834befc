"""Maps that come from elsewhere."""

from __future__ import annotations

import os
import pathlib

from .. import _rpc
from .._arrays import Array
from .._call import Call
from ..types.cloud import PointCloud
from ..types.geometry import Pose
from ..types.maps import MapImported, OccupancyGrid
from ..types.navigation import GridMap
from ..types.sensors import SensorKind
from ..types.toolbox import CloudFile, CloudHandle, SessionCloud
from ..v1 import maps_service_pb2 as service
from ..v1 import sensor_pb2
from . import geometry, maps, words
from .toolbox import planning, request

#: A map: cells of the floor, a file (nav2's yaml, OctoMap's .bt or .ot, a cloud), or points.
Importable = (
    OccupancyGrid
    | GridMap
    | PointCloud
    | Array
    | CloudHandle
    | CloudFile
    | SessionCloud
    | str
    | os.PathLike[str]
)


def _read(out: service.ImportMapRequest, path: pathlib.Path) -> None:
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        out.nav2.CopyFrom(planning.map_to(path).nav2)
    elif suffix in (".bt", ".ot"):
        out.octomap = path.read_bytes()
    else:
        request.fill_source(out.cloud, path.read_bytes())


def import_map(
    session_id: str,
    given: Importable,
    start: Pose | Array | None,
    sensor_height_m: float | None,
    voxel_size_m: float | None,
) -> Call[service.ImportMapRequest, service.ImportMapResponse, MapImported]:
    out = service.ImportMapRequest(
        source=maps.source(session_id),
        start=None if start is None else geometry.pose_to(start, "start"),
        sensor_height_m=sensor_height_m or 0.0,
        voxel_size_m=voxel_size_m or 0.0,
    )
    if isinstance(given, (str, os.PathLike)):
        _read(out, pathlib.Path(given))
    elif isinstance(given, (OccupancyGrid, GridMap)):
        out.grid.CopyFrom(planning.map_to(given).grid)
    else:
        request.fill_source(out.cloud, given)

    return Call(_rpc.IMPORT_MAP, out, imported)


def imported(answer: service.ImportMapResponse) -> MapImported:
    """What became of it."""
    return MapImported(
        num_keyframes=answer.num_keyframes,
        occupied_share=answer.occupied_share,
        free_share=answer.free_share,
        map_version=answer.map_version,
        found_by=words.word(SensorKind, sensor_pb2.SensorKind, answer.found_by),
    )

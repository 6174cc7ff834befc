"""Questions about space, and their answers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .. import _rpc
from .._call import Call
from ..errors import InvalidArgument
from ..types.geometry import OrientedBox
from ..types.layers import (
    BoxAnswers,
    Heights,
    MapChanges,
    MapLayer,
    Mesh,
    PointAnswers,
    RayAnswers,
    SpaceState,
    Storey,
    Voxels,
)
from ..types.maps import Region
from ..v1 import geometry_pb2
from ..v1 import layers_service_pb2 as service
from . import draco, geometry, maps, words


def _state(number: int) -> SpaceState:
    return words.word(SpaceState, service.SpaceState, number)


def _layer(number: int) -> MapLayer:
    return words.word(MapLayer, service.MapLayer, number)


def _rows(field: str, value: object, columns: int = 3) -> list[list[float]]:
    """(N, columns) numbers as lists."""
    try:
        rows = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] != columns:
        message = f"{field} has the shape {rows.shape}; give (N, {columns}) numbers"
        raise InvalidArgument(message, reason="SIZE_MISMATCH", field=field)
    found: list[list[float]] = rows.tolist()
    return found


def _vectors(field: str, value: object) -> list[geometry_pb2.Vector3]:
    return [geometry_pb2.Vector3(x=x, y=y, z=z) for x, y, z in _rows(field, value)]


def _triples(vectors: Sequence[geometry_pb2.Vector3]) -> list[tuple[float, float, float]]:
    return [(v.x, v.y, v.z) for v in vectors]


def voxels(message: service.GetVoxelsResponse) -> Voxels:
    """Voxels of their blocks."""
    keys = np.array([(b.x, b.y, b.z) for b in message.blocks], np.int32).reshape(-1, 3)
    cells = np.frombuffer(b"".join(b.cells for b in message.blocks), np.int8)
    return Voxels(
        keys=keys,
        cells=cells.reshape(-1, 8, 8, 8),
        voxel_size_m=message.voxel_size_m,
        stamp=maps.stamp(message.stamp),
    )


def points(message: service.QueryPointsResponse) -> PointAnswers:
    """What is at points."""
    return PointAnswers(
        states=tuple(_state(p.state) for p in message.points),
        distances_m=np.array([p.distance_m for p in message.points], np.float64),
        gradients=np.array(_triples([p.gradient for p in message.points]), np.float64).reshape(-1, 3),
        max_distance_m=message.max_distance_m,
        layer=_layer(message.layer),
        stamp=maps.stamp(message.stamp),
    )


def rays(message: service.CastRaysResponse) -> RayAnswers:
    """Where rays ended."""
    return RayAnswers(
        states=tuple(_state(r.state) for r in message.rays),
        distances_m=np.array([r.distance_m for r in message.rays], np.float64),
        points=np.array(_triples([r.point for r in message.rays]), np.float64).reshape(-1, 3),
        stamp=maps.stamp(message.stamp),
    )


def boxes(message: service.CheckBoxesResponse) -> BoxAnswers:
    """What is in boxes."""
    counts = [(b.num_occupied, b.num_free, b.num_unknown) for b in message.boxes]
    return BoxAnswers(
        states=tuple(_state(b.state) for b in message.boxes),
        counts=np.array(counts, np.int64).reshape(-1, 3),
        stamp=maps.stamp(message.stamp),
    )


def heights(message: service.GetHeightsResponse) -> Heights:
    """Heights of a region."""
    where = message.geometry
    shape = (where.height, where.width)

    def floats(data: bytes) -> npt.NDArray[np.float32]:
        return np.frombuffer(data, "<f4").reshape(shape)

    return Heights(
        ground_m=floats(message.ground_m),
        sigma_m=floats(message.sigma_m),
        top_m=floats(message.top_m),
        slope_rad=floats(message.slope_rad),
        step_m=floats(message.step_m),
        roughness_m=floats(message.roughness_m),
        traversability=floats(message.traversability),
        is_drop=np.frombuffer(message.is_drop, np.uint8).reshape(shape) > 0,
        resolution_m=where.resolution_m,
        origin=geometry.vector2(where.origin),
        stamp=maps.stamp(message.stamp),
    )


def mesh(message: service.GetMeshResponse) -> Mesh:
    """A surface."""
    if message.draco:
        found = draco.Unpacked(message.draco)
        none = np.zeros((0, 3), np.float32)
        positions, normals = found.rows(draco.POSITION, np.float32), found.rows(draco.NORMAL, np.float32)
        colours = found.rows(draco.COLOUR, np.uint8)
        return Mesh(
            positions=none if positions is None else positions,
            normals=none if normals is None else normals,
            colours=none.astype(np.uint8) if colours is None else colours,
            triangles=found.triangles,
            stamp=maps.stamp(message.stamp),
        )
    return Mesh(
        positions=np.frombuffer(message.positions, "<f4").reshape(-1, 3),
        normals=np.frombuffer(message.normals, "<f4").reshape(-1, 3),
        colours=np.frombuffer(message.colours, np.uint8).reshape(-1, 3),
        triangles=np.frombuffer(message.triangles, "<u4").reshape(-1, 3),
        stamp=maps.stamp(message.stamp),
    )


def changes(message: service.GetChangesResponse) -> MapChanges:
    """Where the map changed."""
    return MapChanges(
        regions=tuple(Region(r.min.x, r.min.y, r.max.x, r.max.y) for r in message.regions),
        layer=_layer(message.layer),
        stamp=maps.stamp(message.stamp),
    )


def get_voxels(
    session_id: str,
    low: Sequence[float] | None,
    high: Sequence[float] | None,
    occupied_only: bool,
    since_version: int,
) -> Call[service.GetVoxelsRequest, service.GetVoxelsResponse, Voxels]:
    request = service.GetVoxelsRequest(
        source=maps.source(session_id),
        region=geometry.box3_to("region", low, high),
        occupied_only=occupied_only,
        since_version=since_version,
    )
    return Call(_rpc.GET_VOXELS, request, voxels)


def query_points(
    session_id: str, positions: object, layer: MapLayer | str
) -> Call[service.QueryPointsRequest, service.QueryPointsResponse, PointAnswers]:
    request = service.QueryPointsRequest(
        source=maps.source(session_id),
        points=_vectors("points", positions),
        layer=words.number("layer", service.MapLayer, layer),
    )
    return Call(_rpc.QUERY_POINTS, request, points)


def cast_rays(
    session_id: str, origins: object, directions: object, max_range_m: float, unknown_ends: bool
) -> Call[service.CastRaysRequest, service.CastRaysResponse, RayAnswers]:
    starts, ways = _vectors("origins", origins), _vectors("directions", directions)
    if len(starts) == 1:
        starts = starts * len(ways)
    if len(starts) != len(ways):
        message = f"there are {len(starts)} origins and {len(ways)} directions; give as many, or one origin"
        raise InvalidArgument(message, reason="SIZE_MISMATCH", field="directions")
    both = zip(starts, ways, strict=True)
    asked = [service.SpaceRay(origin=o, direction=d, max_range_m=max_range_m) for o, d in both]
    request = service.CastRaysRequest(source=maps.source(session_id), rays=asked, unknown_ends=unknown_ends)
    return Call(_rpc.CAST_RAYS, request, rays)


def check_boxes(
    session_id: str, asked: Sequence[OrientedBox]
) -> Call[service.CheckBoxesRequest, service.CheckBoxesResponse, BoxAnswers]:
    request = service.CheckBoxesRequest(
        source=maps.source(session_id), boxes=[geometry.box_to(b) for b in asked]
    )
    return Call(_rpc.CHECK_BOXES, request, boxes)


def get_heights(
    session_id: str, region: Region | None, storey: Storey | str, near_z_m: float, near_within_m: float
) -> Call[service.GetHeightsRequest, service.GetHeightsResponse, Heights]:
    request = service.GetHeightsRequest(
        source=maps.source(session_id),
        region=maps.region_to(region),
        storey=words.number("storey", service.Storey, storey),
        near_z_m=near_z_m,
        near_within_m=near_within_m,
    )
    return Call(_rpc.GET_HEIGHTS, request, heights)


def get_mesh(
    session_id: str,
    low: Sequence[float] | None,
    high: Sequence[float] | None,
    max_triangles: int,
    max_error_m: float | None,
) -> Call[service.GetMeshRequest, service.GetMeshResponse, Mesh]:
    request = service.GetMeshRequest(
        source=maps.source(session_id),
        region=geometry.box3_to("region", low, high),
        max_triangles=max_triangles,
        draco_max_error_m=draco.needed(max_error_m),
    )
    return Call(_rpc.GET_MESH, request, mesh)


def get_changes(
    session_id: str, since_version: int, layer: MapLayer | str
) -> Call[service.GetChangesRequest, service.GetChangesResponse, MapChanges]:
    request = service.GetChangesRequest(
        source=maps.source(session_id),
        layer=words.number("layer", service.MapLayer, layer),
        since_version=since_version,
    )
    return Call(_rpc.GET_CHANGES, request, changes)

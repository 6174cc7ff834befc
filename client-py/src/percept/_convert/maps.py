"""Grids, clouds and files of their chunks."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pathlib
import re
from collections.abc import Sequence

import numpy as np

from .. import _rpc
from .._call import Call, ChunkedCall, PagedCall
from ..errors import Internal, InvalidArgument
from ..types.cloud import PointCloud
from ..types.maps import (
    GridGeometry,
    Loop,
    LoopState,
    LoopVeto,
    MapCloud,
    MapFile,
    MapFormat,
    MapMemory,
    MapOptimised,
    MapStamp,
    MapSummary,
    OccupancyGrid,
    Region,
)
from ..v1 import map_pb2
from ..v1 import maps_service_pb2 as service
from . import draco, geometry, words

#: How nav2's yaml begins: with the name of its image.
_IMAGE = b"image: "


def source(session_id: str) -> map_pb2.MapSource:
    """The live map of a session."""
    return map_pb2.MapSource(session_id=session_id)


def region_to(region: Region | None) -> map_pb2.Region2 | None:
    """A region as a message."""
    if region is None:
        return None
    low = geometry.vector2_to("region.min", (region.min_x_m, region.min_y_m))
    high = geometry.vector2_to("region.max", (region.max_x_m, region.max_y_m))
    return map_pb2.Region2(min=low, max=high)


def stamp(message: map_pb2.MapStamp) -> MapStamp:
    """From which state of the map."""
    return MapStamp(map_version=message.map_version, stamp_ns=message.stamp_ns, frame_id=message.frame_id)


def grid_geometry(message: map_pb2.GridGeometry) -> GridGeometry:
    """Where a grid lies."""
    return GridGeometry(
        resolution_m=message.resolution_m,
        origin=geometry.vector2(message.origin),
        width=message.width,
        height=message.height,
    )


def summary(message: service.GetMapSummaryResponse) -> MapSummary:
    """Sizes of a map."""
    mapped = message.HasField("occupancy")
    return MapSummary(
        stamp=stamp(message.stamp),
        occupancy=grid_geometry(message.occupancy) if mapped else None,
        num_points=message.num_points,
        voxel_size_m=message.voxel_size_m,
        num_keyframes=message.num_keyframes,
        memory=MapMemory(
            scans_bytes=message.memory.scans_bytes,
            submaps_bytes=message.memory.submaps_bytes,
            composed_bytes=message.memory.composed_bytes,
            places_bytes=message.memory.places_bytes,
            graph_bytes=message.memory.graph_bytes,
            odometry_bytes=message.memory.odometry_bytes,
            live_bytes=message.memory.live_bytes,
        ),
        missing_submaps=tuple(message.missing_submaps),
    )


def loop(message: map_pb2.Loop) -> Loop:
    """A loop."""
    return Loop(
        loop_id=message.loop_id,
        from_keyframe_id=message.from_keyframe_id,
        to_keyframe_id=message.to_keyframe_id,
        t_from_to=geometry.pose(message.t_from_to),
        inlier_ratio=message.inlier_ratio,
        state=words.word(LoopState, map_pb2.LoopState, message.state),
    )


def loop_veto(message: service.SetLoopVetoResponse) -> LoopVeto:
    """What a veto did."""
    return LoopVeto(
        loop=loop(message.loop),
        num_keyframes_moved=message.num_keyframes_moved,
        map_version=message.map_version,
    )


def optimised(message: service.OptimiseMapResponse) -> MapOptimised:
    """What an optimisation did."""
    return MapOptimised(num_keyframes_moved=message.num_keyframes_moved, map_version=message.map_version)


def _incomplete(what: str) -> Internal:
    return Internal(f"the {what} came incomplete; ask again", reason="ANSWER_INCOMPLETE")


def occupancy(chunks: Sequence[map_pb2.OccupancyGridChunk]) -> OccupancyGrid:
    """A grid of its chunks."""
    if not chunks or not chunks[0].HasField("geometry"):
        raise _incomplete("grid")
    where = chunks[0].geometry
    cells = np.frombuffer(b"".join(c.cells for c in chunks), np.int8)
    if cells.size != where.width * where.height:
        raise _incomplete("grid")
    return OccupancyGrid(
        cells=cells.reshape(where.height, where.width),
        resolution_m=where.resolution_m,
        origin=geometry.vector2(where.origin),
        stamp=stamp(chunks[0].stamp),
    )


def cloud(chunks: Sequence[map_pb2.CloudChunk]) -> MapCloud:
    """A cloud of its chunks."""
    joined = geometry.joined_cloud([c.cloud for c in chunks])
    if not chunks or joined.num_points != chunks[0].total_points:
        raise _incomplete("cloud")
    head = chunks[0]
    size_m = head.voxel_size_m if head.HasField("voxel_size_m") else None
    return MapCloud(cloud=joined, stamp=stamp(head.stamp), voxel_size_m=size_m)


def unpacked_cloud(answers: Sequence[service.GetCloudResponse]) -> MapCloud:
    """A cloud that was packed."""
    found = draco.Unpacked(b"".join(a.draco for a in answers))
    points = found.rows(draco.POSITION, np.float32)
    points = np.zeros((0, 3), np.float32) if points is None else points
    if not answers or len(points) != answers[0].chunk.total_points:
        raise _incomplete("cloud")
    intensities = found.rows(draco.GENERIC, np.float32, 1)
    cloud = PointCloud(
        points,
        colours=found.rows(draco.COLOUR, np.uint8),
        intensities=None if intensities is None else intensities[:, 0],
        normals=found.rows(draco.NORMAL, np.float32),
    )
    head = answers[0].chunk
    return MapCloud(cloud=cloud, stamp=stamp(head.stamp), voxel_size_m=head.voxel_size_m)


def file(chunks: Sequence[map_pb2.FileChunk]) -> MapFile:
    """A file of its chunks, checksum compared."""
    if not chunks or not chunks[0].HasField("header"):
        raise _incomplete("file")
    header, data = chunks[0].header, b"".join(c.data for c in chunks)
    if len(data) != header.size_bytes or hashlib.sha256(data).hexdigest() != header.sha256:
        message = f"file {header.file_name} differs from its checksum; ask again"
        raise Internal(message, reason="CHECKSUM_MISMATCH")
    return MapFile(
        data=data,
        file_name=header.file_name,
        media_type=header.media_type,
        sha256=header.sha256,
        stamp=stamp(header.stamp),
        path=None,
    )


def get_summary(
    session_id: str,
) -> Call[service.GetMapSummaryRequest, service.GetMapSummaryResponse, MapSummary]:
    return Call(_rpc.GET_MAP_SUMMARY, service.GetMapSummaryRequest(source=source(session_id)), summary)


def list_loops(
    session_id: str, page_size: int
) -> PagedCall[service.ListLoopsRequest, service.ListLoopsResponse, Loop]:
    request = service.ListLoopsRequest(source=source(session_id), page_size=page_size)
    return PagedCall(_rpc.LIST_LOOPS, request, lambda a: [loop(x) for x in a.loops])


def set_loop_veto(
    session_id: str, loop_id: int, vetoed: bool
) -> Call[service.SetLoopVetoRequest, service.SetLoopVetoResponse, LoopVeto]:
    request = service.SetLoopVetoRequest(source=source(session_id), loop_id=loop_id, vetoed=vetoed)
    return Call(_rpc.SET_LOOP_VETO, request, loop_veto)


def optimise(
    session_id: str,
) -> Call[service.OptimiseMapRequest, service.OptimiseMapResponse, MapOptimised]:
    return Call(_rpc.OPTIMISE_MAP, service.OptimiseMapRequest(source=source(session_id)), optimised)


def get_occupancy(
    session_id: str, region: Region | None, resolution_m: float | None, live: bool
) -> ChunkedCall[service.GetOccupancyGridRequest, service.GetOccupancyGridResponse, OccupancyGrid]:
    request = service.GetOccupancyGridRequest(
        source=source(session_id), region=region_to(region), resolution_m=resolution_m, live=live
    )
    return ChunkedCall(_rpc.GET_OCCUPANCY_GRID, request, lambda a: occupancy([x.chunk for x in a]))


def get_cloud(
    session_id: str,
    centre: Sequence[float] | None,
    radius_m: float | None,
    voxel_size_m: float | None,
    max_points: int | None,
    max_error_m: float | None,
) -> ChunkedCall[service.GetCloudRequest, service.GetCloudResponse, MapCloud]:
    if (centre is None) != (radius_m is None):
        message = "centre and radius_m belong together; give both or neither"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="radius_m")
    request = service.GetCloudRequest(
        source=source(session_id),
        radius_m=radius_m,
        voxel_size_m=voxel_size_m,
        max_points=max_points,
        draco_max_error_m=draco.needed(max_error_m),
    )
    if centre is not None:
        request.centre.CopyFrom(geometry.vector3_to("centre", centre))
    if max_error_m is not None:
        return ChunkedCall(_rpc.GET_CLOUD, request, unpacked_cloud)
    return ChunkedCall(_rpc.GET_CLOUD, request, lambda a: cloud([x.chunk for x in a]))


def export(
    session_id: str, file_format: MapFormat | str, max_error_m: float | None
) -> ChunkedCall[service.ExportMapRequest, service.ExportMapResponse, MapFile]:
    request = service.ExportMapRequest(
        source=source(session_id),
        format=words.number("format", map_pb2.MapFormat, file_format),
        max_error_m=max_error_m,
    )

    def read(answers: Sequence[service.ExportMapResponse]) -> MapFile:
        came = file([x.chunk for x in answers])
        return called(came, came.file_name)

    return ChunkedCall(_rpc.EXPORT_MAP, request, read)


def called(came: MapFile, file_name: str) -> MapFile:
    """The file under this name: nav2's yaml names its image, which lies beside it and is called alike."""
    if not came.data.startswith(_IMAGE):
        return came
    image = pathlib.PurePath(file_name).with_suffix(".pgm").name
    # Quoted as JSON is, which YAML reads, too, where it could be anything else than a name.
    written = image if re.fullmatch(r"[A-Za-z][\w.-]*", image) else json.dumps(image)
    data = _IMAGE + written.encode() + b"\n" + came.data.partition(b"\n")[2]
    return dataclasses.replace(came, data=data, sha256=hashlib.sha256(data).hexdigest())

# Written by client-py/generate from _async/maps.py; change that.
"""Maps: read what a session built."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections.abc import Sequence
from typing import Literal, overload

from .._arrays import Array
from .._convert import drawing
from .._convert import map_import as convert_import
from .._convert import maps as convert
from .._convert.map_import import Importable
from .._convert.toolbox.planning import Map
from ..types.geometry import Pose
from ..types.maps import (
    Loop,
    LoopVeto,
    MapCloud,
    MapComparison,
    MapFile,
    MapFormat,
    MapImported,
    MapOptimised,
    MapSummary,
    OccupancyGrid,
    Region,
)
from .bound import SessionBound
from .operations import Operation, started
from .pages import Pages


def _written(file: MapFile, path: str | os.PathLike[str] | None) -> MapFile:
    """Writes the file whole or not at all; a folder gets the suggested name."""
    if path is None:
        return file
    target = pathlib.Path(path)
    if target.is_dir():
        target = target / file.file_name
    file = convert.called(file, target.name)
    part = target.with_name(f"{target.name}.part")
    part.write_bytes(file.data)
    part.replace(target)
    return dataclasses.replace(file, path=target)


class Maps(SessionBound):
    """The live map of a session."""

    def summary(self) -> MapSummary:
        """Sizes and version, without the content."""
        return self._transport.call(convert.get_summary(self.session_id))

    def occupancy(
        self,
        *,
        region: Region | None = None,
        resolution_m: float | None = None,
        live: bool = False,
    ) -> OccupancyGrid:
        """The occupancy grid, whole or a region; resolution_m a multiple of the map's own.

        live: with what the newest frames see laid over the map, as paths are planned on it: who stands
        before the robot is occupied, what they see through is free.
        """
        call = convert.get_occupancy(self.session_id, region, resolution_m, live)
        return self._transport.chunks(call)

    def cloud(
        self,
        *,
        centre: Sequence[float] | None = None,
        radius_m: float | None = None,
        voxel_size_m: float | None = None,
        max_points: int | None = None,
        max_error_m: float | None = None,
    ) -> MapCloud:
        """The fused cloud, whole or within radius_m of a point of the map.

        voxel_size_m: a point for each voxel of this edge, if that is coarser than the map keeps it.
        max_points: at most so many points, by the finest voxels that leave no more; which those are is in
        the answer's voxel_size_m.
        max_error_m: packed on the way, a quarter of the bytes, points off by at most so many metres (0.0001
        to 1) and in another order; needs DracoPy, `pip install 'percept[draco]'`.
        """
        call = convert.get_cloud(self.session_id, centre, radius_m, voxel_size_m, max_points, max_error_m)
        return self._transport.chunks(call)

    def loops(self, *, page_size: int = 0) -> Pages[Loop]:
        """Loops that were found, believed or not, by number; pages are asked for as they are used."""
        return self._transport.pages(convert.list_loops(self.session_id, page_size))

    def veto_loop(self, loop_id: int) -> LoopVeto:
        """Takes a loop out of the map, which follows at once; allow_loop() undoes it."""
        return self._transport.call(convert.set_loop_veto(self.session_id, loop_id, True))

    def allow_loop(self, loop_id: int) -> LoopVeto:
        """Lets a loop that was vetoed into the map again."""
        return self._transport.call(convert.set_loop_veto(self.session_id, loop_id, False))

    def optimise(self) -> MapOptimised:
        """Solves the pose graph once more and moves every keyframe to where it belongs, now.

        Corrections of millimetres wait for more while frames come in.
        """
        return self._transport.call(convert.optimise(self.session_id))

    def compare(
        self,
        before: Map | None = None,
        *,
        before_session: str | None = None,
        tolerance_m: float | None = None,
    ) -> MapComparison:
        """What appeared in the occupancy grid since an older map of the place, and what has gone: counted,
        and as a picture.

        before: a grid (`OccupancyGrid`, `GridMap`) or the yaml file of a nav2 map, in the map frame; or
        before_session, the id of another session, whose map is read as it is now. tolerance_m: walls that are
        off by this much have not changed, at most ten cells; one cell of the finer map if left out.
        """
        call = drawing.compare_maps(self.session_id, before, before_session, tolerance_m)
        return self._transport.call(call)

    @overload
    def import_map(
        self,
        given: Importable,
        *,
        start: Pose | Array | None = None,
        sensor_height_m: float | None = None,
        voxel_size_m: float | None = None,
        wait: Literal[True] = True,
        request_id: str | None = None,
    ) -> MapImported: ...

    @overload
    def import_map(
        self,
        given: Importable,
        *,
        start: Pose | Array | None = None,
        sensor_height_m: float | None = None,
        voxel_size_m: float | None = None,
        wait: Literal[False],
        request_id: str | None = None,
    ) -> Operation[MapImported]: ...

    def import_map(
        self,
        given: Importable,
        *,
        start: Pose | Array | None = None,
        sensor_height_m: float | None = None,
        voxel_size_m: float | None = None,
        wait: bool = True,
        request_id: str | None = None,
    ) -> MapImported | Operation[MapImported]:
        """Begins this session, which must be empty, with a map that comes from elsewhere.

        given: cells (`OccupancyGrid`, `GridMap`), points (a cloud, a handle, another session's), or a file:
        nav2's yaml with its image beside it, OctoMap's .bt or .ot, a cloud (PLY, PCD, LAS, ...), z up.
        Declare the robot's sensors first: a planar lidar is found in a floor plan, a 3D one in voxels and
        points of rooms; on a street it has to be told. start: base to map, a pose or its (4, 4) matrix,
        where that is known within a metre; a robot with another sensor needs it, and one whose lidar sees at
        first what does not fit there is looked for all the same. sensor_height_m: above the ground, as
        declared if left out. voxel_size_m: of the voxels by which points hide each other, 0.1 if left out.

        It is an operation, which goes on whoever hangs up, and is waited for; with wait=False it is what is
        given, to be watched, cancelled, and its result() read. The session is as empty as it was if it fails
        or is cancelled.
        """
        call = convert_import.import_map(self.session_id, given, start, sensor_height_m, voxel_size_m)
        operation = started(self._transport, call, request_id)
        if not wait:
            return operation
        operation.wait()
        try:
            return operation.result()
        finally:
            operation.delete()

    def export(
        self,
        file_format: MapFormat | str,
        *,
        path: str | os.PathLike[str] | None = None,
        max_error_m: float | None = None,
    ) -> MapFile:
        """The map as a file, checksum compared; with `path` (file or folder) it is written there.

        A map for nav2 is two files: export "nav2_yaml" to hall.yaml and "nav2_pgm" to hall.pgm, which the
        first names, or both to one folder.

        max_error_m: of the Draco formats, by how much positions may be off, 0.0001 to 1; None: 0.001.
        """
        file = self._transport.chunks(convert.export(self.session_id, file_format, max_error_m))
        return _written(file, path)

    def start_export(
        self,
        file_format: MapFormat | str,
        *,
        max_error_m: float | None = None,
        request_id: str | None = None,
    ) -> Operation[MapFile]:
        """export() as an operation, which goes on whoever hangs up: wait() for it, and read its result().
        The same request_id gives the same operation."""
        call = convert.export(self.session_id, file_format, max_error_m)
        return started(self._transport, call, request_id)

    def start_optimise(self, *, request_id: str | None = None) -> Operation[MapOptimised]:
        """optimise() as an operation."""
        return started(self._transport, convert.optimise(self.session_id), request_id)

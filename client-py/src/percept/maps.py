"""Maps: read what a session built."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections.abc import Sequence

from ._aio_transport import AsyncTransport
from ._convert import maps as convert
from ._transport import Transport
from .types.maps import MapCloud, MapFile, MapFormat, MapSummary, OccupancyGrid, Region


def _written(file: MapFile, path: str | os.PathLike[str] | None) -> MapFile:
    """Writes the file whole or not at all; a folder gets the suggested name."""
    if path is None:
        return file
    target = pathlib.Path(path)
    if target.is_dir():
        target = target / file.file_name
    part = target.with_name(f"{target.name}.part")
    part.write_bytes(file.data)
    part.replace(target)
    return dataclasses.replace(file, path=target)


class Maps:
    """The live map of a session."""

    def __init__(self, transport: Transport, session_id: str) -> None:
        self._transport = transport
        self._session_id = session_id

    def summary(self) -> MapSummary:
        """Sizes and version, without the content."""
        return self._transport.call(convert.get_summary(self._session_id))

    def occupancy(self, *, region: Region | None = None, resolution_m: float | None = None) -> OccupancyGrid:
        """The occupancy grid, whole or a region; resolution_m a multiple of the map's own."""
        return self._transport.chunks(convert.get_occupancy(self._session_id, region, resolution_m))

    def cloud(self, *, center: Sequence[float] | None = None, radius_m: float | None = None) -> MapCloud:
        """The fused cloud, whole or within radius_m of a point of the map."""
        return self._transport.chunks(convert.get_cloud(self._session_id, center, radius_m))

    def export(self, file_format: MapFormat | str, *, path: str | os.PathLike[str] | None = None) -> MapFile:
        """The map as a file, checksum compared; with `path` (file or folder) it is written there."""
        file = self._transport.chunks(convert.export(self._session_id, file_format))
        return _written(file, path)


class AsyncMaps:
    """The live map of a session."""

    def __init__(self, transport: AsyncTransport, session_id: str) -> None:
        self._transport = transport
        self._session_id = session_id

    async def summary(self) -> MapSummary:
        """Sizes and version, without the content."""
        return await self._transport.call(convert.get_summary(self._session_id))

    async def occupancy(
        self, *, region: Region | None = None, resolution_m: float | None = None
    ) -> OccupancyGrid:
        """The occupancy grid, whole or a region; resolution_m a multiple of the map's own."""
        return await self._transport.chunks(convert.get_occupancy(self._session_id, region, resolution_m))

    async def cloud(
        self, *, center: Sequence[float] | None = None, radius_m: float | None = None
    ) -> MapCloud:
        """The fused cloud, whole or within radius_m of a point of the map."""
        return await self._transport.chunks(convert.get_cloud(self._session_id, center, radius_m))

    async def export(
        self, file_format: MapFormat | str, *, path: str | os.PathLike[str] | None = None
    ) -> MapFile:
        """The map as a file, checksum compared; with `path` (file or folder) it is written there."""
        file = await self._transport.chunks(convert.export(self._session_id, file_format))
        return _written(file, path)

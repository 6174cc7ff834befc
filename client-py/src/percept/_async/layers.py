"""Space: what the map says about points, boxes, rays and voxels."""

from __future__ import annotations

from collections.abc import Sequence

from .._convert import layers as convert
from ..types.geometry import OrientedBox
from ..types.layers import (
    BoxAnswers,
    Heights,
    MapChanges,
    MapLayer,
    Mesh,
    PointAnswers,
    RayAnswers,
    Storey,
    Voxels,
)
from ..types.maps import Region
from .bound import AsyncSessionBound


class AsyncSpace(AsyncSessionBound):
    """Questions about the space that a session's live map is of.

    Rays, boxes and voxels need a session that keeps voxels: create it with
    params={"map": {"voxels": {"enabled": True}}}. Points and changes are answered by the grid otherwise.
    heights() needs {"height": {"enabled": True}} in the same place, mesh() {"surface": {"enabled": True}}.
    """

    async def voxels(
        self,
        *,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        occupied_only: bool = False,
        since_version: int = 0,
    ) -> Voxels:
        """The voxels within the box from low to high (x, y, z, metres, map frame), or all; of those only that
        lie where the map changed after since_version."""
        call = convert.get_voxels(self.session_id, low, high, occupied_only, since_version)
        return await self._transport.call(call)

    async def points(self, points: object, *, layer: MapLayer | str = MapLayer.UNSPECIFIED) -> PointAnswers:
        """What is at (N, 3) points, metres, map frame: free, occupied or unknown, how far the nearest
        obstacle is (to 2 m), and which way."""
        return await self._transport.call(convert.query_points(self.session_id, points, layer))

    async def rays(
        self, origins: object, directions: object, *, max_range_m: float, unknown_ends: bool = False
    ) -> RayAnswers:
        """What (N, 3) rays hit first; one origin does for all. Directions may have any length but zero."""
        call = convert.cast_rays(self.session_id, origins, directions, max_range_m, unknown_ends)
        return await self._transport.call(call)

    async def boxes(self, boxes: Sequence[OrientedBox]) -> BoxAnswers:
        """Whether boxes (t_frame_box: box to map) are free."""
        return await self._transport.call(convert.check_boxes(self.session_id, boxes))

    async def heights(
        self,
        *,
        region: Region | None = None,
        storey: Storey | str = Storey.LOWEST,
        near_z_m: float = 0.0,
        near_within_m: float = 0.0,
    ) -> Heights:
        """How high the ground is, and where a robot can drive. Storey "nearest" is that whose ground is
        nearest to near_z_m, within near_within_m (0: 1.5)."""
        call = convert.get_heights(self.session_id, region, storey, near_z_m, near_within_m)
        return await self._transport.call(call)

    async def mesh(
        self,
        *,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        max_triangles: int = 0,
        max_error_m: float | None = None,
    ) -> Mesh:
        """The surface as triangles: those with a corner in the box from low to high, or all.

        max_error_m: packed on the way, an eighth of the bytes, vertices off by at most so many metres (0.0001
        to 1); needs DracoPy, `pip install 'percept[draco]'`.
        """
        call = convert.get_mesh(self.session_id, low, high, max_triangles, max_error_m)
        return await self._transport.call(call)

    async def changes(
        self, since_version: int = 0, *, layer: MapLayer | str = MapLayer.UNSPECIFIED
    ) -> MapChanges:
        """Where a layer changed after a version; the answer's stamp.map_version is the next to ask with."""
        return await self._transport.call(convert.get_changes(self.session_id, since_version, layer))

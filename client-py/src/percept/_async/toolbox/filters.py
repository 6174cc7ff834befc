"""Filters, sampling, normals."""

from __future__ import annotations

from collections.abc import Sequence

from ..._arrays import Array
from ..._convert.toolbox import filters as convert
from ..._convert.toolbox.request import Cloud
from ...types.cloud import PointCloud
from ...types.geometry import OrientedBox, Pose
from ...types.toolbox import FilteredCloud, NormalOrientation
from ..bound import AsyncBound


class AsyncFilters(AsyncBound):
    """Fewer points, or points with more to say."""

    async def remove_statistical_outliers(
        self, cloud: Cloud, *, num_neighbours: int | None = None, std_ratio: float | None = None
    ) -> FilteredCloud:
        """Points whose mean distance to num_neighbours (20) others is up to mean + std_ratio (2) sigma."""
        return await self._transport.call(
            convert.remove_statistical_outliers(cloud, num_neighbours, std_ratio)
        )

    async def remove_radius_outliers(
        self, cloud: Cloud, *, radius_m: float | None = None, min_neighbours: int | None = None
    ) -> FilteredCloud:
        """Points with at least min_neighbours (5) others within radius_m (0.1)."""
        return await self._transport.call(convert.remove_radius_outliers(cloud, radius_m, min_neighbours))

    async def remove_non_finite(self, cloud: Cloud) -> PointCloud:
        """Points whose coordinates are all finite, in order."""
        return await self._transport.call(convert.remove_non_finite(cloud))

    async def sample_points(
        self,
        cloud: Cloud,
        *,
        every: int | None = None,
        random: int | None = None,
        farthest: int | None = None,
        seed: int = 0,
    ) -> FilteredCloud:
        """Every so-many-th finite point, so many at random, or so many far from each other: give one of them.
        Same seed, same points."""
        return await self._transport.call(convert.sample_points(cloud, every, random, farthest, seed))

    async def crop_cloud(
        self,
        cloud: Cloud,
        *,
        box: OrientedBox | None = None,
        range_m: tuple[float, float] | None = None,
        centre: Sequence[float] | None = None,
        polygon: Array | None = None,
        z_m: tuple[float | None, float | None] = (None, None),
        outside: bool = False,
    ) -> FilteredCloud:
        """The points in a box, at distances range_m (low, high) from centre (the origin), or in a polygon
        (N, 2) of the xy plane between the heights z_m: give one of them. `outside` keeps the others."""
        call = convert.crop_cloud(cloud, box, range_m, centre, polygon, z_m, outside)
        return await self._transport.call(call)

    async def transform_cloud(self, cloud: Cloud, *, t_a_b: Pose | Array) -> PointCloud:
        """The cloud in frame a, from frame b; normals turn along."""
        return await self._transport.call(convert.transform_cloud(cloud, t_a_b))

    async def downsample_voxels(self, cloud: Cloud, *, voxel_size_m: float | None = None) -> PointCloud:
        """One centroid a voxel of edge voxel_size_m (0.05); channels are averaged."""
        return await self._transport.call(convert.downsample_voxels(cloud, voxel_size_m))

    async def estimate_normals(
        self,
        cloud: Cloud,
        *,
        radius_m: float | None = None,
        max_neighbours: int | None = None,
        min_neighbours: int | None = None,
        viewpoint_m: Sequence[float] | None = None,
        orientation: NormalOrientation | str = NormalOrientation.VIEWPOINT,
        tree_neighbours: int | None = None,
    ) -> PointCloud:
        """The cloud with unit normals, zero where they are undefined.

        Of at most max_neighbours (30; 0: all) within radius_m (0.1; inf: however far), itself among them, and
        at least min_neighbours (5). They look towards the viewpoint (the origin), or to one side of the
        surface: spanning_tree compares each with tree_neighbours (12) around; the highest point's looks up.
        """
        call = convert.estimate_normals(
            cloud,
            radius_m=radius_m,
            max_neighbours=max_neighbours,
            min_neighbours=min_neighbours,
            viewpoint_m=viewpoint_m,
            orientation=orientation,
            tree_neighbours=tree_neighbours,
        )
        return await self._transport.call(call)

"""Ground, smooth regions, convex parts; pictures."""

from __future__ import annotations

from collections.abc import Sequence

from ..._arrays import Array
from ..._convert.toolbox import regions as convert
from ..._convert.toolbox.request import Cloud
from ...types.cloud import Labels
from ...types.frames import EncodedImage
from ...types.toolbox import CloudColouring, CloudView, Clusters, Ground, Supervoxels, SupportedObjects
from ..bound import AsyncBound


class AsyncRegions(AsyncBound):
    """What goes on smoothly, and pictures to look at."""

    async def segment_ground(
        self,
        cloud: Cloud,
        *,
        sensor_height_m: float | None = None,
        min_range_m: float | None = None,
        max_range_m: float | None = None,
        distance_m: float | None = None,
        max_slope_rad: float | None = None,
    ) -> Ground:
        """The ground of a lidar scan in the sensor's frame, z up, sensor_height_m (1.73) above the ground;
        points up to distance_m (0.125) above the fitted patches belong to it."""
        call = convert.segment_ground(
            cloud,
            sensor_height_m=sensor_height_m,
            min_range_m=min_range_m,
            max_range_m=max_range_m,
            distance_m=distance_m,
            max_slope_rad=max_slope_rad,
        )
        return await self._transport.call(call)

    async def grow_regions(
        self,
        cloud: Cloud,
        *,
        radius_m: float | None = None,
        max_neighbours: int | None = None,
        max_angle_rad: float | None = None,
        min_points: int | None = None,
    ) -> Clusters:
        """Regions of at least min_points (50) in which normals turn by less than max_angle_rad (0.1) between
        neighbours within radius_m (0.05); normals are estimated if the cloud has none."""
        call = convert.grow_regions(
            cloud,
            radius_m=radius_m,
            max_neighbours=max_neighbours,
            max_angle_rad=max_angle_rad,
            min_points=min_points,
        )
        return await self._transport.call(call)

    async def compute_supervoxels(
        self,
        cloud: Cloud,
        *,
        voxel_size_m: float | None = None,
        seed_size_m: float | None = None,
        normal_radius_m: float | None = None,
        spatial_weight: float | None = None,
        normal_weight: float | None = None,
        viewpoint_m: Sequence[float] | None = None,
    ) -> Supervoxels:
        """Small patches of even surface, seeded every seed_size_m (0.04) over voxels of voxel_size_m
        (0.0075); their normals look towards the viewpoint (the origin)."""
        call = convert.compute_supervoxels(
            cloud,
            voxel_size_m=voxel_size_m,
            seed_size_m=seed_size_m,
            normal_radius_m=normal_radius_m,
            spatial_weight=spatial_weight,
            normal_weight=normal_weight,
            viewpoint_m=viewpoint_m,
        )
        return await self._transport.call(call)

    async def group_convex(
        self,
        parts: Supervoxels,
        *,
        seed_size_m: float | None = None,
        concavity_tolerance_rad: float | None = None,
        max_step_m: float | None = None,
        min_supervoxels: int | None = None,
    ) -> Clusters:
        """A label for each of M supervoxels: those joined by convex edges, or by ones concave by less than
        concavity_tolerance_rad (0.1745). A point has that of its supervoxel."""
        call = convert.group_convex(
            parts,
            seed_size_m=seed_size_m,
            concavity_tolerance_rad=concavity_tolerance_rad,
            max_step_m=max_step_m,
            min_supervoxels=min_supervoxels,
        )
        return await self._transport.call(call)

    async def segment_objects(
        self,
        cloud: Cloud,
        *,
        viewpoint_m: Sequence[float] | None = None,
        plane_distance_m: float | None = None,
        min_height_m: float | None = None,
        min_points: int | None = None,
        voxel_size_m: float | None = None,
        seed_size_m: float | None = None,
        concavity_tolerance_rad: float | None = None,
        seed: int = 0,
    ) -> SupportedObjects:
        """What stands on the largest plane, seen from the viewpoint (the origin): supervoxels joined where
        the surface is convex. Objects may touch and stand on each other."""
        call = convert.segment_objects(
            cloud,
            viewpoint_m=viewpoint_m,
            plane_distance_m=plane_distance_m,
            min_height_m=min_height_m,
            min_points=min_points,
            voxel_size_m=voxel_size_m,
            seed_size_m=seed_size_m,
            concavity_tolerance_rad=concavity_tolerance_rad,
            seed=seed,
        )
        return await self._transport.call(call)

    async def render_cloud(
        self,
        cloud: Cloud,
        *,
        view: CloudView | str = CloudView.TOP,
        colouring: CloudColouring | str | None = None,
        labels: Labels | None = None,
        width_px: int | None = None,
        height_px: int | None = None,
        point_size_px: int | None = None,
    ) -> bytes:
        """A PNG of 1024 x 768 pixels: the cloud in its own colours, else by labels, else by intensity, else
        by height. labels: Clusters, Supervoxels or SupportedObjects of this cloud, or whole numbers (N,), -1
        for none."""
        call = convert.render_cloud(
            cloud,
            labels,
            colouring,
            view=view,
            width_px=width_px,
            height_px=height_px,
            point_size_px=point_size_px,
        )
        return await self._transport.call(call)

    async def render_depth(
        self,
        depth: Array | EncodedImage | bytes,
        *,
        metres_per_unit: float | None = None,
        near_m: float | None = None,
        far_m: float | None = None,
    ) -> bytes:
        """A PNG: near blue, far red, black where nothing was measured."""
        call = convert.render_depth(depth, metres_per_unit, near_m=near_m, far_m=far_m)
        return await self._transport.call(call)

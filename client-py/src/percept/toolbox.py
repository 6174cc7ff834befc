"""The perception toolbox: one cloud or image in, facts out; no session. Absent parameters take the
server's defaults, which the contract names."""

from __future__ import annotations

from collections.abc import Sequence

from ._aio_transport import AsyncTransport
from ._arrays import Array
from ._convert import toolbox as convert
from ._transport import Transport
from .types.frames import EncodedImage
from .types.geometry import CameraIntrinsics, PointCloud, Pose
from .types.scene import Detection
from .types.toolbox import (
    ClusterMethod,
    Clusters,
    FilteredCloud,
    PlaneSegment,
    Registration,
    RegistrationMethod,
    Shape,
)


class Toolbox:
    """Clouds are PointCloud, or their points as (N, 3) float32 metres."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def remove_statistical_outliers(
        self, cloud: PointCloud | Array, *, num_neighbors: int | None = None, std_ratio: float | None = None
    ) -> FilteredCloud:
        """Points whose mean distance to their neighbours is no outlier."""
        call = convert.remove_statistical_outliers(cloud, num_neighbors, std_ratio)
        return self._transport.call(call)

    def downsample_voxels(
        self, cloud: PointCloud | Array, *, voxel_size_m: float | None = None
    ) -> PointCloud:
        """One centroid a voxel; channels are averaged."""
        return self._transport.call(convert.downsample_voxels(cloud, voxel_size_m))

    def estimate_normals(
        self,
        cloud: PointCloud | Array,
        *,
        radius_m: float | None = None,
        max_neighbors: int | None = None,
        viewpoint_m: Sequence[float] | None = None,
    ) -> PointCloud:
        """The cloud with normals that look towards the viewpoint; zero where they are undefined."""
        call = convert.estimate_normals(cloud, radius_m, max_neighbors, viewpoint_m)
        return self._transport.call(call)

    def segment_planes(
        self,
        cloud: PointCloud | Array,
        *,
        distance_m: float | None = None,
        max_iterations: int | None = None,
        max_planes: int | None = None,
        min_points: int | None = None,
        seed: int = 0,
    ) -> list[PlaneSegment]:
        """Planes by RANSAC, largest first. Same seed, same answer."""
        call = convert.segment_planes(cloud, distance_m, max_iterations, max_planes, min_points, seed)
        return self._transport.call(call)

    def cluster_points(
        self,
        cloud: PointCloud | Array,
        *,
        method: ClusterMethod | str = ClusterMethod.EUCLIDEAN,
        eps_m: float | None = None,
        min_points: int | None = None,
    ) -> Clusters:
        """Connected groups of points."""
        return self._transport.call(convert.cluster_points(cloud, method, eps_m, min_points))

    def compute_shape_features(self, cloud: PointCloud | Array) -> Shape:
        """Centroid, extent, eigenvalues and what follows from them; smallest upright box."""
        return self._transport.call(convert.compute_shape_features(cloud))

    def detect_objects(self, cloud: PointCloud | Array) -> list[Detection]:
        """Objects in a cloud with z up and the floor near z = 0."""
        return self._transport.call(convert.detect_objects(cloud))

    def register_clouds(
        self,
        source: PointCloud | Array,
        *,
        target: PointCloud | Array,
        initial_guess: Pose | Array | None = None,
        method: RegistrationMethod | str = RegistrationMethod.POINT_TO_PLANE,
        max_distance_m: float | None = None,
        max_iterations: int | None = None,
    ) -> Registration:
        """Lays source over target (ICP), starting from t_target_source = initial_guess."""
        call = convert.register_clouds(source, target, initial_guess, method, max_distance_m, max_iterations)
        return self._transport.call(call)

    def unproject_depth(
        self,
        depth: Array | EncodedImage,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        color: Array | EncodedImage | None = None,
        stride: int | None = None,
        min_depth_m: float | None = None,
        max_depth_m: float | None = None,
    ) -> PointCloud:
        """Depth image to cloud in the optical frame."""
        call = convert.unproject_depth(
            depth, intrinsics, metres_per_unit, color, stride, min_depth_m, max_depth_m
        )
        return self._transport.call(call)


class AsyncToolbox:
    """Clouds are PointCloud, or their points as (N, 3) float32 metres."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport

    async def remove_statistical_outliers(
        self, cloud: PointCloud | Array, *, num_neighbors: int | None = None, std_ratio: float | None = None
    ) -> FilteredCloud:
        """Points whose mean distance to their neighbours is no outlier."""
        call = convert.remove_statistical_outliers(cloud, num_neighbors, std_ratio)
        return await self._transport.call(call)

    async def downsample_voxels(
        self, cloud: PointCloud | Array, *, voxel_size_m: float | None = None
    ) -> PointCloud:
        """One centroid a voxel; channels are averaged."""
        return await self._transport.call(convert.downsample_voxels(cloud, voxel_size_m))

    async def estimate_normals(
        self,
        cloud: PointCloud | Array,
        *,
        radius_m: float | None = None,
        max_neighbors: int | None = None,
        viewpoint_m: Sequence[float] | None = None,
    ) -> PointCloud:
        """The cloud with normals that look towards the viewpoint; zero where they are undefined."""
        call = convert.estimate_normals(cloud, radius_m, max_neighbors, viewpoint_m)
        return await self._transport.call(call)

    async def segment_planes(
        self,
        cloud: PointCloud | Array,
        *,
        distance_m: float | None = None,
        max_iterations: int | None = None,
        max_planes: int | None = None,
        min_points: int | None = None,
        seed: int = 0,
    ) -> list[PlaneSegment]:
        """Planes by RANSAC, largest first. Same seed, same answer."""
        call = convert.segment_planes(cloud, distance_m, max_iterations, max_planes, min_points, seed)
        return await self._transport.call(call)

    async def cluster_points(
        self,
        cloud: PointCloud | Array,
        *,
        method: ClusterMethod | str = ClusterMethod.EUCLIDEAN,
        eps_m: float | None = None,
        min_points: int | None = None,
    ) -> Clusters:
        """Connected groups of points."""
        return await self._transport.call(convert.cluster_points(cloud, method, eps_m, min_points))

    async def compute_shape_features(self, cloud: PointCloud | Array) -> Shape:
        """Centroid, extent, eigenvalues and what follows from them; smallest upright box."""
        return await self._transport.call(convert.compute_shape_features(cloud))

    async def detect_objects(self, cloud: PointCloud | Array) -> list[Detection]:
        """Objects in a cloud with z up and the floor near z = 0."""
        return await self._transport.call(convert.detect_objects(cloud))

    async def register_clouds(
        self,
        source: PointCloud | Array,
        *,
        target: PointCloud | Array,
        initial_guess: Pose | Array | None = None,
        method: RegistrationMethod | str = RegistrationMethod.POINT_TO_PLANE,
        max_distance_m: float | None = None,
        max_iterations: int | None = None,
    ) -> Registration:
        """Lays source over target (ICP), starting from t_target_source = initial_guess."""
        call = convert.register_clouds(source, target, initial_guess, method, max_distance_m, max_iterations)
        return await self._transport.call(call)

    async def unproject_depth(
        self,
        depth: Array | EncodedImage,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        color: Array | EncodedImage | None = None,
        stride: int | None = None,
        min_depth_m: float | None = None,
        max_depth_m: float | None = None,
    ) -> PointCloud:
        """Depth image to cloud in the optical frame."""
        call = convert.unproject_depth(
            depth, intrinsics, metres_per_unit, color, stride, min_depth_m, max_depth_m
        )
        return await self._transport.call(call)

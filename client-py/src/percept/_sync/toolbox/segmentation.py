# Written by client-py/generate from _async/toolbox/segmentation.py; change that.
"""Planes, clusters, shapes, objects."""

from __future__ import annotations

import numpy.typing as npt

from ..._convert.toolbox import segmentation as convert
from ..._convert.toolbox.request import Cloud
from ...types.scene import Detection
from ...types.toolbox import ClusterMethod, Clusters, Environment, PlaneSegment, Shape
from ..bound import Bound


class Segmentation(Bound):
    """What belongs together."""

    def segment_planes(
        self,
        cloud: Cloud,
        *,
        distance_m: float | None = None,
        max_iterations: int | None = None,
        max_planes: int | None = None,
        min_points: int | None = None,
        seed: int = 0,
        early_stop: bool | None = None,
        up: npt.ArrayLike | None = None,
    ) -> list[PlaneSegment]:
        """Up to max_planes (1) planes by RANSAC, largest first. Inliers are nearer than distance_m
        (0.02). Same seed, same answer; early_stop=False draws all max_iterations (1000). Floor, wall, ceiling
        and table are told by up, (3,), against gravity in the cloud's frame ((0, 0, 1)); (0, -1, 0) for a
        camera's optical frame that looks ahead. Where all are "other", their tilt_rad says why."""
        call = convert.segment_planes(
            cloud, distance_m, max_iterations, max_planes, min_points, seed, early_stop, up
        )
        return self._transport.call(call)

    def cluster_points(
        self,
        cloud: Cloud,
        *,
        method: ClusterMethod | str = ClusterMethod.EUCLIDEAN,
        eps_m: float | None = None,
        min_points: int | None = None,
        eps_slope: float | None = None,
    ) -> Clusters:
        """Connected groups of at least min_points (10) points, connected up to eps_m (0.05); euclidean ones
        may reach eps_slope farther for each metre of distance from the origin."""
        return self._transport.call(convert.cluster_points(cloud, method, eps_m, min_points, eps_slope))

    def compute_shape_features(self, cloud: Cloud) -> Shape:
        """Centroid, extent, eigenvalues and what follows from them; smallest upright box."""
        return self._transport.call(convert.compute_shape_features(cloud))

    def detect_objects(
        self,
        cloud: Cloud,
        *,
        environment: Environment | str = Environment.INDOOR,
        sensor_height_m: float | None = None,
    ) -> list[Detection]:
        """Objects in a cloud with z up.

        Indoors the floor is near z = 0. Outdoors the cloud is one scan of a 3D lidar in its own frame,
        sensor_height_m (1.73) above the ground, and objects are vehicles, people and what stands by itself.
        """
        return self._transport.call(convert.detect_objects(cloud, environment, sensor_height_m))

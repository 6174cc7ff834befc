# Written by client-py/generate from _async/toolbox/depth_images.py; change that.
"""Depth images cleaned up and taken apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..._arrays import Array
from ..._convert.toolbox import depth_images as convert
from ...types.frames import EncodedImage
from ...types.geometry import CameraIntrinsics, Pose
from ...types.shapes import DepthPlanes
from ..bound import Bound


class DepthImages(Bound):
    """Depth is (H, W) float32 metres, uint16 units of metres_per_unit, or the bytes of a PNG of such."""

    def filter_depth(
        self,
        depth: Array | EncodedImage | bytes,
        filters: Sequence[tuple[str, Mapping[str, object]]],
        *,
        metres_per_unit: float | None = None,
    ) -> Array:
        """Filters in turn, each a name with its parameters: ("median", {"size_px": 5}), ("bilateral", {}),
        ("remove_outliers", {"ratio": 2.0}), ("fill_holes", {}). Answers (H, W) float32 metres."""
        return self._transport.call(convert.filter_depth(depth, metres_per_unit, filters))

    def compute_depth_normals(
        self,
        depth: Array | EncodedImage | bytes,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        step_px: int | None = None,
        max_jump_fraction: float | None = None,
        max_incidence_rad: float | None = None,
    ) -> Array:
        """Metric normals in the optical frame, towards the camera, (H, W, 3) float32; zero where there is
        none. Pixels step_px (2) apart are compared."""
        call = convert.compute_depth_normals(
            depth,
            intrinsics,
            metres_per_unit,
            step_px=step_px,
            max_jump_fraction=max_jump_fraction,
            max_incidence_rad=max_incidence_rad,
        )
        return self._transport.call(call)

    def segment_depth_planes(
        self,
        depth: Array | EncodedImage | bytes,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        cell_px: int | None = None,
        noise_at_1m_m: float | None = None,
        max_angle_rad: float | None = None,
        max_distance_m: float | None = None,
        min_pixels: int | None = None,
    ) -> DepthPlanes:
        """Connected planes of at least min_pixels (2000), optical frame, grown from cells of cell_px (10)."""
        call = convert.segment_depth_planes(
            depth,
            intrinsics,
            metres_per_unit,
            cell_px=cell_px,
            noise_at_1m_m=noise_at_1m_m,
            max_angle_rad=max_angle_rad,
            max_distance_m=max_distance_m,
            min_pixels=min_pixels,
        )
        return self._transport.call(call)

    def find_depth_edges(
        self,
        depth: Array | EncodedImage | bytes,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        min_jump_fraction: float | None = None,
        max_search_px: int | None = None,
        min_bend_rad: float | None = None,
        bend_step_px: int | None = None,
    ) -> npt.NDArray[np.uint8]:
        """(H, W) uint8: 0 none, 1 occluding, 2 occluded, 3 returns end here, 4 the surface bends sharply."""
        call = convert.find_depth_edges(
            depth,
            intrinsics,
            metres_per_unit,
            min_jump_fraction=min_jump_fraction,
            max_search_px=max_search_px,
            min_bend_rad=min_bend_rad,
            bend_step_px=bend_step_px,
        )
        return self._transport.call(call)

    def register_colour(
        self,
        depth: Array | EncodedImage | bytes,
        colour: Array | EncodedImage | bytes,
        *,
        depth_camera: CameraIntrinsics,
        colour_camera: CameraIntrinsics,
        t_colour_depth: Pose | Array,
        metres_per_unit: float | None = None,
        max_jump_fraction: float | None = None,
    ) -> tuple[Array, npt.NDArray[np.bool_]]:
        """The colour of each depth pixel from another camera, (H, W, 3) uint8, and whether that sees it,
        (H, W) bool; hidden is what lies more than max_jump_fraction (0.05) of its depth behind."""
        call = convert.register_colour(
            depth, depth_camera, colour, colour_camera, t_colour_depth, metres_per_unit, max_jump_fraction
        )
        return self._transport.call(call)

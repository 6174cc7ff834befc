"""Several views of one scene."""

from __future__ import annotations

from collections.abc import Sequence

from .._arrays import Array
from .._convert.toolbox import images as convert
from ..types.geometry import CameraIntrinsics
from ..types.images import (
    EssentialEstimate,
    HomographyEstimate,
    PnpEstimate,
    PosedView,
    Ransac,
    TriangulatedPoints,
    TwoViewEstimate,
)
from ._base import Async, Sync


class Images(Sync):
    """Pixels are (N, 2) float64 or float32: columns and rows of the full image."""

    def estimate_essential(
        self,
        points_a: Array,
        points_b: Array,
        *,
        camera_a: CameraIntrinsics,
        camera_b: CameraIntrinsics | None = None,
        ransac: Ransac | None = None,
    ) -> EssentialEstimate:
        """How camera a stood to camera b (as camera_a if not given), from pixels that show the same points;
        the scale stays unknown."""
        return self._transport.call(
            convert.estimate_essential(points_a, points_b, camera_a, camera_b, ransac)
        )

    def estimate_homography(
        self, points_a: Array, points_b: Array, *, ransac: Ransac | None = None
    ) -> HomographyEstimate:
        """The map between two images of one plane, or of any scene from one place; undistorted pixels."""
        return self._transport.call(convert.estimate_homography(points_a, points_b, ransac))

    def estimate_two_view(
        self,
        points_a: Array,
        points_b: Array,
        *,
        camera_a: CameraIntrinsics,
        camera_b: CameraIntrinsics | None = None,
        ransac: Ransac | None = None,
    ) -> TwoViewEstimate:
        """Essential matrix and homography, which of them explains more, and what follows for the pose."""
        return self._transport.call(convert.estimate_two_view(points_a, points_b, camera_a, camera_b, ransac))

    def triangulate_points(self, views: Sequence[PosedView]) -> TriangulatedPoints:
        """Points from their pixels in 2 to 64 views with known poses."""
        return self._transport.call(convert.triangulate_points(views))

    def solve_pnp(
        self,
        points: Array,
        pixels: Array,
        *,
        camera: CameraIntrinsics,
        ransac: Ransac | None = None,
    ) -> PnpEstimate:
        """A camera's pose among known points, (N, 3) in the world."""
        return self._transport.call(convert.solve_pnp(points, pixels, camera, ransac))


class AsyncImages(Async):
    """Pixels are (N, 2) float64 or float32: columns and rows of the full image."""

    async def estimate_essential(
        self,
        points_a: Array,
        points_b: Array,
        *,
        camera_a: CameraIntrinsics,
        camera_b: CameraIntrinsics | None = None,
        ransac: Ransac | None = None,
    ) -> EssentialEstimate:
        """How camera a stood to camera b (as camera_a if not given), from pixels that show the same points;
        the scale stays unknown."""
        return await self._transport.call(
            convert.estimate_essential(points_a, points_b, camera_a, camera_b, ransac)
        )

    async def estimate_homography(
        self, points_a: Array, points_b: Array, *, ransac: Ransac | None = None
    ) -> HomographyEstimate:
        """The map between two images of one plane, or of any scene from one place; undistorted pixels."""
        return await self._transport.call(convert.estimate_homography(points_a, points_b, ransac))

    async def estimate_two_view(
        self,
        points_a: Array,
        points_b: Array,
        *,
        camera_a: CameraIntrinsics,
        camera_b: CameraIntrinsics | None = None,
        ransac: Ransac | None = None,
    ) -> TwoViewEstimate:
        """Essential matrix and homography, which of them explains more, and what follows for the pose."""
        return await self._transport.call(
            convert.estimate_two_view(points_a, points_b, camera_a, camera_b, ransac)
        )

    async def triangulate_points(self, views: Sequence[PosedView]) -> TriangulatedPoints:
        """Points from their pixels in 2 to 64 views with known poses."""
        return await self._transport.call(convert.triangulate_points(views))

    async def solve_pnp(
        self,
        points: Array,
        pixels: Array,
        *,
        camera: CameraIntrinsics,
        ransac: Ransac | None = None,
    ) -> PnpEstimate:
        """A camera's pose among known points, (N, 3) in the world."""
        return await self._transport.call(convert.solve_pnp(points, pixels, camera, ransac))

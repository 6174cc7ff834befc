"""Several views of one scene."""

from __future__ import annotations

from collections.abc import Sequence

from ..._arrays import Array
from ..._convert.toolbox import images as convert
from ...types.frames import EncodedImage
from ...types.geometry import CameraIntrinsics
from ...types.images import (
    EssentialEstimate,
    FeatureMatches,
    FeatureMethod,
    HomographyEstimate,
    ImageDetection,
    ImageDetectorInfo,
    ImageFeatures,
    PnpEstimate,
    PosedView,
    Ransac,
    TriangulatedPoints,
    TwoViewEstimate,
)
from ..bound import AsyncBound


class AsyncImages(AsyncBound):
    """Pixels are (N, 2) float64 or float32: columns and rows of the full image."""

    async def extract_features(
        self,
        image: Array | EncodedImage | bytes,
        *,
        method: FeatureMethod | str = FeatureMethod.ORB,
        max_features: int | None = None,
        num_levels: int | None = None,
        scale_factor: float | None = None,
        fast_threshold: int | None = None,
        contrast_threshold: float | None = None,
        edge_threshold: float | None = None,
        root: bool = False,
    ) -> ImageFeatures:
        """Up to max_features (1000) of an image, (H, W) or (H, W, 3) uint8. num_levels (8), scale_factor
        (1.2) and fast_threshold (14) are for orb; contrast_threshold (0.04), edge_threshold (10) and root for
        sift."""
        call = convert.extract_features(
            image,
            method,
            max_features=max_features,
            num_levels=num_levels,
            scale_factor=scale_factor,
            fast_threshold=fast_threshold,
            contrast_threshold=contrast_threshold,
            edge_threshold=edge_threshold,
            root=root,
        )
        return await self._transport.call(call)

    async def match_features(
        self,
        query: Array,
        train: Array,
        *,
        ratio: float | None = None,
        mutual: bool = False,
        max_distance: float | None = None,
    ) -> FeatureMatches:
        """Each descriptor's nearest of the other image, if nearer than ratio (0.75) times the second."""
        return await self._transport.call(convert.match_features(query, train, ratio, mutual, max_distance))

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

    async def detect_in_image(
        self, detector: str, image: Array | EncodedImage | bytes
    ) -> tuple[ImageDetection, ...]:
        """Things in an image, (H, W, 3) or (H, W) uint8, by a learned detector; best score first."""
        return await self._transport.call(convert.detect_in_image(detector, image))

    async def image_detectors(self) -> tuple[ImageDetectorInfo, ...]:
        """The learned detectors of the server, by name."""
        return await self._transport.call(convert.list_image_detectors())

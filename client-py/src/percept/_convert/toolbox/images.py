"""Several views of one scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...types.frames import EncodedImage
from ...types.geometry import CameraIntrinsics, Floats
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
    TwoViewModel,
    TwoViewOutcome,
)
from ...v1 import toolbox_images_service_pb2 as images_pb
from .. import geometry, words
from .depth import put_colour
from .request import floats, of, uint32s


def _packed(field: str, value: Array, columns: int) -> bytes:
    """(N, columns) float32 or float64 as packed float64."""
    return checked(field, value, ("N", columns), np.float64, np.float32).astype("<f8").tobytes()


def _float64s(data: bytes, *shape: int) -> Floats:
    return np.frombuffer(data, "<f8").reshape(shape or (-1,))


def _ransac(value: Ransac | None) -> images_pb.RansacParams:
    value = value or Ransac()
    return of(
        images_pb.RansacParams,
        threshold_px=value.threshold_px,
        confidence=value.confidence,
        max_iterations=value.max_iterations,
        seed=value.seed,
    )


def estimate_essential(
    points_a: Array,
    points_b: Array,
    camera_a: CameraIntrinsics,
    camera_b: CameraIntrinsics | None,
    ransac: Ransac | None,
) -> Call[images_pb.EstimateEssentialRequest, images_pb.EstimateEssentialResponse, EssentialEstimate]:
    request = of(
        images_pb.EstimateEssentialRequest,
        points_a=_packed("points_a", points_a, 2),
        points_b=_packed("points_b", points_b, 2),
        camera_a=camera_a,
        camera_b=camera_b,
        ransac=_ransac(ransac),
    )
    return Call(_rpc.ESTIMATE_ESSENTIAL, request, _essential)


def _essential(answer: images_pb.EstimateEssentialResponse) -> EssentialEstimate:
    return EssentialEstimate(
        essential=np.array(answer.essential).reshape(3, 3),
        t_b_a=geometry.pose(answer.t_b_a),
        inliers=uint32s(answer.inliers),
        num_with_parallax=answer.num_with_parallax,
        rmse_px=answer.rmse_px,
        iterations=answer.iterations,
    )


def estimate_homography(
    points_a: Array, points_b: Array, ransac: Ransac | None
) -> Call[images_pb.EstimateHomographyRequest, images_pb.EstimateHomographyResponse, HomographyEstimate]:
    request = of(
        images_pb.EstimateHomographyRequest,
        points_a=_packed("points_a", points_a, 2),
        points_b=_packed("points_b", points_b, 2),
        ransac=_ransac(ransac),
    )
    return Call(_rpc.ESTIMATE_HOMOGRAPHY, request, _homography)


def _homography(answer: images_pb.EstimateHomographyResponse) -> HomographyEstimate:
    return HomographyEstimate(
        homography=np.array(answer.homography).reshape(3, 3),
        inliers=uint32s(answer.inliers),
        rmse_px=answer.rmse_px,
        iterations=answer.iterations,
    )


def estimate_two_view(
    points_a: Array,
    points_b: Array,
    camera_a: CameraIntrinsics,
    camera_b: CameraIntrinsics | None,
    ransac: Ransac | None,
) -> Call[images_pb.EstimateTwoViewRequest, images_pb.EstimateTwoViewResponse, TwoViewEstimate]:
    def read(answer: images_pb.EstimateTwoViewResponse) -> TwoViewEstimate:
        return TwoViewEstimate(
            model=words.word(TwoViewModel, images_pb.TwoViewModel, answer.model),
            outcome=words.word(TwoViewOutcome, images_pb.TwoViewOutcome, answer.outcome),
            essential=_essential(answer.essential),
            homography=_homography(answer.homography) if answer.HasField("homography") else None,
            gric_essential=answer.gric_essential,
            gric_homography=answer.gric_homography,
        )

    request = of(
        images_pb.EstimateTwoViewRequest,
        points_a=_packed("points_a", points_a, 2),
        points_b=_packed("points_b", points_b, 2),
        camera_a=camera_a,
        camera_b=camera_b,
        ransac=_ransac(ransac),
    )
    return Call(_rpc.ESTIMATE_TWO_VIEW, request, read)


def triangulate_points(
    views: Sequence[PosedView],
) -> Call[images_pb.TriangulatePointsRequest, images_pb.TriangulatePointsResponse, TriangulatedPoints]:
    def read(answer: images_pb.TriangulatePointsResponse) -> TriangulatedPoints:
        return TriangulatedPoints(
            positions=_float64s(answer.positions, -1, 3),
            covariances=_float64s(answer.covariances, -1, 3, 3),
            parallax_rad=_float64s(answer.parallax_rad),
            rmse_px=_float64s(answer.rmse_px),
            in_front=np.frombuffer(answer.in_front, np.uint8).astype(bool),
        )

    request = images_pb.TriangulatePointsRequest()
    for view in views:
        request.views.append(
            of(
                images_pb.PosedView,
                camera=view.camera,
                t_world_camera=view.t_world_camera,
                pixels=_packed("pixels", view.pixels, 2),
            )
        )
    return Call(_rpc.TRIANGULATE_POINTS, request, read)


def solve_pnp(
    points: Array, pixels: Array, camera: CameraIntrinsics, ransac: Ransac | None
) -> Call[images_pb.SolvePnpRequest, images_pb.SolvePnpResponse, PnpEstimate]:
    def read(answer: images_pb.SolvePnpResponse) -> PnpEstimate:
        return PnpEstimate(
            t_world_camera=geometry.pose(answer.t_world_camera),
            covariance=geometry.covariance(answer.covariance),
            inliers=uint32s(answer.inliers),
            rmse_px=answer.rmse_px,
            iterations=answer.iterations,
        )

    request = of(
        images_pb.SolvePnpRequest,
        points=_packed("points", points, 3),
        pixels=_packed("pixels", pixels, 2),
        camera=camera,
        ransac=_ransac(ransac),
    )
    return Call(_rpc.SOLVE_PNP, request, read)


def extract_features(
    image: Array | EncodedImage | bytes, method: FeatureMethod | str, **fields: object
) -> Call[images_pb.ExtractFeaturesRequest, images_pb.ExtractFeaturesResponse, ImageFeatures]:
    def read(answer: images_pb.ExtractFeaturesResponse) -> ImageFeatures:
        return ImageFeatures(
            points=floats(answer.points, -1, 2),
            sizes_px=floats(answer.sizes_px),
            angles_rad=floats(answer.angles_rad),
            responses=floats(answer.responses),
            octaves=np.frombuffer(answer.octaves, "<i4"),
            descriptors=np.frombuffer(answer.descriptors, np.uint8).reshape(-1, answer.descriptor_bytes),
        )

    request = of(images_pb.ExtractFeaturesRequest, method=method, **fields)
    if isinstance(image, np.ndarray) and image.ndim == 2:
        image = np.repeat(checked("image", image, ("H", "W"), np.uint8)[:, :, None], 3, axis=2)
    put_colour(request.image, image)
    return Call(_rpc.EXTRACT_FEATURES, request, read)


def match_features(
    query: Array, train: Array, ratio: float | None, mutual: bool, max_distance: float | None
) -> Call[images_pb.MatchFeaturesRequest, images_pb.MatchFeaturesResponse, FeatureMatches]:
    def read(answer: images_pb.MatchFeaturesResponse) -> FeatureMatches:
        return FeatureMatches(pairs=uint32s(answer.pairs).reshape(-1, 2), distances=floats(answer.distances))

    first = checked("query", query, ("K", "B"), np.uint8)
    second = checked("train", train, ("L", first.shape[1]), np.uint8)
    request = of(
        images_pb.MatchFeaturesRequest,
        query=first.tobytes(),
        train=second.tobytes(),
        descriptor_bytes=first.shape[1],
        ratio=ratio,
        mutual=mutual,
        max_distance=max_distance,
    )
    return Call(_rpc.MATCH_FEATURES, request, read)


def detect_in_image(
    detector: str, image: Array | EncodedImage | bytes
) -> Call[images_pb.DetectInImageRequest, images_pb.DetectInImageResponse, tuple[ImageDetection, ...]]:
    request = images_pb.DetectInImageRequest(detector=detector)
    put_colour(request.image, image)
    return Call(_rpc.DETECT_IN_IMAGE, request, lambda a: tuple(_image_detection(d) for d in a.detections))


def _image_detection(message: images_pb.ImageDetection) -> ImageDetection:
    edges = (message.left_px, message.top_px, message.right_px, message.bottom_px)
    return ImageDetection(label=message.label, score=message.score, edges_px=np.array(edges))


def list_image_detectors() -> Call[
    images_pb.ListImageDetectorsRequest,
    images_pb.ListImageDetectorsResponse,
    tuple[ImageDetectorInfo, ...],
]:
    request = images_pb.ListImageDetectorsRequest()
    return Call(
        _rpc.LIST_IMAGE_DETECTORS,
        request,
        lambda a: tuple(ImageDetectorInfo(name=d.name, labels=tuple(d.labels)) for d in a.detectors),
    )

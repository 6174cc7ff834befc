"""Several views of one scene. Pixels are (N, 2): columns and rows of the full image."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .geometry import CameraIntrinsics, Floats, Pose


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Ransac(Value):
    """How a model is sought among correspondences of which some are wrong. None: the server's default."""

    #: Correspondences that are off by more do not belong to the model (1).
    threshold_px: float | None = None
    #: Sampling ends when a better model is missed with at most 1 minus this (0.999).
    confidence: float | None = None
    #: Samples at most (2000).
    max_iterations: int | None = None
    #: Same seed, same answer.
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EssentialEstimate(Value):
    """How one camera stood to another."""

    #: (3, 3): b' E a = 0 for normalised points; Frobenius norm 1.
    essential: Floats
    #: Camera a in camera b; the translation has length 1, its true length is unknown.
    t_b_a: Pose
    #: Of the correspondences that fit, (M,) uint32, ascending.
    inliers: npt.NDArray[np.uint32]
    #: Of those, how many show a parallax that tells about the translation.
    num_with_parallax: int
    #: Of the inliers.
    rmse_px: float
    #: Samples that were drawn.
    iterations: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class HomographyEstimate(Value):
    """A plane-to-plane map."""

    #: (3, 3): b ~ H a for homogeneous points.
    homography: Floats
    #: Of the correspondences that fit, (M,) uint32, ascending.
    inliers: npt.NDArray[np.uint32]
    #: Of the inliers.
    rmse_px: float
    #: Samples that were drawn.
    iterations: int


class TwoViewModel(Name):
    """Which model explains more of the correspondences."""

    UNSPECIFIED = "unspecified"
    ESSENTIAL = "essential"
    HOMOGRAPHY = "homography"


class TwoViewOutcome(Name):
    """What two images allow."""

    UNSPECIFIED = "unspecified"
    #: The relative pose is known, but for the length of the translation.
    POSE = "pose"
    #: Nearly all rays are parallel: only the rotation is known.
    LITTLE_PARALLAX = "little_parallax"
    #: A plane fills the images: the pose is the likelier one of two.
    PLANAR = "planar"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TwoViewEstimate(Value):
    """Both models and the choice between them."""

    model: TwoViewModel
    outcome: TwoViewOutcome
    essential: EssentialEstimate
    #: Of rays at depth 1; None if nothing fits one.
    homography: HomographyEstimate | None
    #: Costs by Torr's criterion; the model with less is chosen.
    gric_essential: float
    #: The same for the homography.
    gric_homography: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosedView(Value):
    """A camera with a known pose, and what it sees."""

    #: Its lens.
    camera: CameraIntrinsics
    #: Optical frame to world.
    t_world_camera: Pose
    #: (N, 2) float64; NaN where it does not see a point.
    pixels: Floats


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TriangulatedPoints(Value):
    """N points; NaN where fewer than two views see one, or their rays are parallel."""

    #: World frame, (N, 3).
    positions: Floats
    #: (N, 3, 3), for pixels that are off by one pixel.
    covariances: Floats = field(repr=False)
    #: Largest angle between two rays, radians, (N,).
    parallax_rad: Floats
    #: Root mean square of the reprojection errors, (N,).
    rmse_px: Floats
    #: Whether a point lies in front of every camera, (N,) bool.
    in_front: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PnpEstimate(Value):
    """Where a camera is among known points."""

    #: Camera (optical frame) in the world.
    t_world_camera: Pose
    #: Of a right perturbation in the camera, (6, 6).
    covariance: Floats
    #: Of the correspondences that fit, (M,) uint32, ascending.
    inliers: npt.NDArray[np.uint32]
    #: Of the inliers.
    rmse_px: float
    #: Samples that were drawn.
    iterations: int


class FeatureMethod(Name):
    """How features are found."""

    #: Oriented FAST corners, 256 bits.
    ORB = "orb"
    #: Blobs in scale space, 128 numbers.
    SIFT = "sift"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageFeatures(Value):
    """K distinct places of an image."""

    #: Columns and rows, (K, 2) float32.
    points: npt.NDArray[np.float32]
    #: Diameter of what was described, pixels, (K,) float32.
    sizes_px: npt.NDArray[np.float32]
    #: Main direction from x towards y (down), (K,) float32.
    angles_rad: npt.NDArray[np.float32]
    #: How distinct, (K,) float32.
    responses: npt.NDArray[np.float32]
    #: Pyramid level (ORB) or octave (SIFT), (K,) int32.
    octaves: npt.NDArray[np.int32]
    #: (K, 32) uint8 of bits (ORB), (K, 128) uint8 (SIFT).
    descriptors: npt.NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FeatureMatches(Value):
    """Features that look alike."""

    #: Index in the first set, index in the second, (M, 2) uint32.
    pairs: npt.NDArray[np.uint32]
    #: Differing bits, or Euclidean, (M,) float32.
    distances: npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageDetection(Value):
    """A thing in an image, whose top left corner is (0, 0), and the bottom right one (width, height)."""

    label: str
    #: 0 to 1.
    score: float
    #: Left, top, right and bottom edge of its box, pixels, (4,).
    edges_px: Floats


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageDetectorInfo(Value):
    """A learned detector of the server."""

    name: str
    #: What it tells apart.
    labels: tuple[str, ...]

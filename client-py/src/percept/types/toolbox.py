"""Answers of the perception toolbox."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .cloud import PointCloud
from .geometry import Floats, OrientedBox, Plane, Pose
from .scene import Detection, ShapeFeatures


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CloudHandle(Value):
    """A cloud that the server keeps; toolbox calls take it in place of a cloud."""

    #: Its name on the server.
    handle: str
    num_points: int
    #: What it takes of the server's budget.
    size_bytes: int
    #: Not forgotten before, nanoseconds since the Unix epoch by the server's clock; each use starts its
    #: time anew.
    expires_ns: int


@dataclass(frozen=True)
class SessionCloud:
    """What a session has mapped, or the part of it within radius_m of a point of the map; toolbox calls take
    it in place of a cloud, which then does not travel."""

    session_id: str
    #: Metres, map frame.
    centre: Sequence[float] | None = None
    #: About the centre.
    radius_m: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class KeptClouds(Value):
    """The clouds that a server keeps."""

    #: Oldest first.
    clouds: tuple[CloudHandle, ...]
    #: What they take of the budget.
    used_bytes: int
    #: The budget.
    max_bytes: int


class CloudFormat(Name):
    """Files that a cloud is read from or written to."""

    #: Reading: any PLY. Writing: binary little-endian.
    PLY = "ply"
    PLY_ASCII = "ply_ascii"
    PLY_BIG_ENDIAN = "ply_big_endian"
    #: Reading: any PCD. Writing: binary.
    PCD = "pcd"
    PCD_ASCII = "pcd_ascii"
    PCD_COMPRESSED = "pcd_compressed"
    #: Text: x y z a line, then colours and normals, or intensities.
    XYZ = "xyz"
    #: float32 x y z intensity, without a header.
    KITTI_BIN = "kitti_bin"
    #: Colours and intensities; millimetres.
    LAS = "las"
    #: LAS packed by LASzip.
    LAZ = "laz"


@dataclass(frozen=True)
class CloudFile:
    """A cloud's file; toolbox calls take it, or its bytes, in place of a cloud. The format is told by the
    content if it is not said."""

    data: bytes
    file_format: CloudFormat | str | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DecodedCloud(Value):
    """What a file holds."""

    #: Relative to origin_m.
    cloud: PointCloud
    #: What to add to every position in float64, metres, (3,); zero unless float32 would spoil them.
    origin_m: Floats


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FilteredCloud(Value):
    """What a filter kept."""

    cloud: PointCloud
    #: Of the kept points in the input, (M,) uint32.
    indices: npt.NDArray[np.uint32]


class NormalOrientation(Name):
    """To which side normals look."""

    VIEWPOINT = "viewpoint"
    #: To one side of the surface, from neighbour to neighbour.
    SPANNING_TREE = "spanning_tree"


class PlaneKind(Name):
    """What a plane is, by its direction and height."""

    UNSPECIFIED = "unspecified"
    FLOOR = "floor"
    WALL = "wall"
    CEILING = "ceiling"
    TABLE = "table"
    OTHER = "other"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PlaneSegment(Value):
    """A plane that was found."""

    #: In the frame of the input.
    plane: Plane
    kind: PlaneKind
    #: Between its normal and up, radians: 0 lies level, pi/2 stands.
    tilt_rad: float = 0.0
    #: Of its points in the input, ascending, (M,) uint32.
    indices: npt.NDArray[np.uint32]


class ClusterMethod(Name):
    """What connects points."""

    EUCLIDEAN = "euclidean"
    DBSCAN = "dbscan"


class Environment(Name):
    """What surrounds the objects that are looked for."""

    INDOOR = "indoor"
    OUTDOOR = "outdoor"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Clusters(Value):
    """Connected groups of points."""

    #: Number of each point's cluster, -1 for noise, (N,) int32.
    labels: npt.NDArray[np.int32]
    #: Clusters that were found.
    num_clusters: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Shape(Value):
    """Shape of a cloud."""

    features: ShapeFeatures
    #: Smallest upright box, frame of the input.
    upright_box: OrientedBox


class RegistrationMethod(Name):
    """What registration minimises."""

    POINT_TO_POINT = "point_to_point"
    POINT_TO_PLANE = "point_to_plane"
    #: Differences weighted by the surfaces of both clouds.
    GICP = "gicp"
    #: GICP against the mean surface of the target's voxels.
    VGICP = "vgicp"
    #: Tangent planes and brightness; both clouds need colours.
    COLOURED = "coloured"


class RobustKernel(Name):
    """How much a residual counts."""

    NONE = "none"
    HUBER = "huber"
    CAUCHY = "cauchy"
    GEMAN_MCCLURE = "geman_mcclure"
    TUKEY = "tukey"


class RegistrationOutcome(Name):
    """How registration ended."""

    UNSPECIFIED = "unspecified"
    CONVERGED = "converged"
    #: Converged, but the pairs leave directions open: see degenerate_axes.
    DEGENERATE = "degenerate"
    MAX_ITERATIONS = "max_iterations"
    TOO_FEW_PAIRS = "too_few_pairs"
    DIVERGED = "diverged"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Registration(Value):
    """How a source cloud lies over a target cloud."""

    #: Takes coordinates of the source to those of the target.
    t_target_source: Pose
    #: Share of source points with a partner, 0 to 1.
    fitness: float
    #: Of those pairs, metres.
    rmse_m: float
    #: Of a right perturbation in source, (6, 6).
    covariance: Floats
    #: Steps of the solver.
    iterations: int
    #: Whether the last step was below the tolerances, and the pairs fix the whole pose.
    converged: bool
    #: Why not converged, if not.
    outcome: RegistrationOutcome
    #: Axes (x, y, z, rotation x, y, z) that the clouds do not fix.
    degenerate_axes: tuple[bool, ...]


class GlobalRegistrationMethod(Name):
    """How sets of right pairs of points are found among wrong ones."""

    CONSISTENCY = "consistency"
    RANSAC = "ransac"


class GlobalRegistrationOutcome(Name):
    """Whether an answer with no first guess is to be believed."""

    UNSPECIFIED = "unspecified"
    FOUND = "found"
    #: The best found, but not enough of the clouds coincides to be sure.
    DOUBTFUL = "doubtful"
    #: Two different ways fit nearly as well: the place repeats itself.
    AMBIGUOUS = "ambiguous"
    NOT_FOUND = "not_found"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GlobalRegistration(Value):
    """How a source cloud lies over a target cloud, found with no guess."""

    #: Use the transform only if FOUND.
    outcome: GlobalRegistrationOutcome
    #: Takes coordinates of the source to those of the target.
    t_target_source: Pose
    #: Of a right perturbation in source, (6, 6); zero without refinement.
    covariance: Floats
    #: Share of the source that coincides with the target, 0 to 1.
    overlap: float
    #: The same of the way that differs from the answer and for which most speaks.
    rival_overlap: float
    #: Of the points that coincide, metres.
    rmse_m: float
    #: Pairs of points with like features.
    num_pairs: int
    #: Of these, the pairs that agree with the answer.
    num_agreeing: int
    #: Axes (x, y, z, rotation x, y, z) that the clouds do not fix; all False without refinement.
    degenerate_axes: tuple[bool, ...]
    #: Natural logarithm of how much likelier what the clouds show is if the answer is right than if it is
    #: chance; 0 if there is none. FOUND takes 25.
    evidence: float
    #: The same of the best way that differs from the answer, the answer slid along among them. FOUND takes
    #: no more than half of the answer's.
    rival_evidence: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GroundPatch(Value):
    """A piece of ground."""

    #: Normal upward.
    plane: Plane
    #: Mean of its points, metres, (3,).
    centre: Floats
    num_points: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Ground(Value):
    """What of a scan is ground."""

    #: Of its points in the input, ascending, (M,) uint32.
    indices: npt.NDArray[np.uint32]
    #: From the sensor outward.
    patches: tuple[GroundPatch, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Supervoxels(Value):
    """Small patches of even surface."""

    #: Number of each point's patch, -1 for none, (N,) int32.
    labels: npt.NDArray[np.int32]
    #: Means of their points, metres, (M, 3) float32.
    centres: npt.NDArray[np.float32]
    #: Unit length, (M, 3) float32.
    normals: npt.NDArray[np.float32]
    #: Pairs that touch, the smaller number first, (E, 2) uint32.
    edges: npt.NDArray[np.uint32]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SupportedObjects(Value):
    """What stands on the largest plane."""

    #: Number of each point's object, -1 for none, (N,) int32.
    labels: npt.NDArray[np.int32]
    #: Objects that were found.
    num_objects: int
    #: What they stand on; None if no plane was found.
    support: Plane | None


class CloudView(Name):
    """From where a cloud is seen."""

    TOP = "top"
    FRONT = "front"
    SIDE = "side"
    PERSPECTIVE = "perspective"
    #: As the camera at the origin of an optical frame.
    CAMERA = "camera"


class CloudColouring(Name):
    """In which colours a cloud is drawn."""

    OWN = "own"
    HEIGHT = "height"
    NORMAL = "normal"
    LABEL = "label"
    INTENSITY = "intensity"


class PlaneRemainder(Name):
    """Which points go on after planes, or ground, were found."""

    REST = "rest"
    PLANES = "planes"
    ALL = "all"


class Step(Value):
    """An operation of a pipeline by its name, with the parameters of the method of that name.

        Step("segment_planes", max_planes=3, remainder="rest"), Step("cluster_points", eps_m=0.08, quiet=True)

    `quiet` leaves what it found out of the answer; `remainder` (segment_planes) says which points go on.
    """

    def __init__(
        self,
        operation: str,
        *,
        quiet: bool = False,
        remainder: PlaneRemainder | str | None = None,
        **params: object,
    ) -> None:
        self.operation = operation
        self.quiet = quiet
        self.remainder = remainder
        #: Of the operation, by name.
        self.params: Mapping[str, object] = params

    def __repr__(self) -> str:
        params = "".join(f", {name}={value!r}" for name, value in self.params.items())
        return f"Step({self.operation!r}{params})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Step) and vars(self) == vars(other)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ClusterShape(Value):
    """Shape of one cluster."""

    label: int
    features: ShapeFeatures
    #: Smallest upright box, frame of the input.
    upright_box: OrientedBox


#: Indices of kept points (M,) uint32, planes, clusters or regions, shape of the cloud, shapes of its
#: clusters, objects, ground, objects on a support.
StepAnswer: TypeAlias = (
    npt.NDArray[np.uint32]
    | list[PlaneSegment]
    | Clusters
    | Shape
    | list[ClusterShape]
    | list[Detection]
    | Ground
    | SupportedObjects
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StepResult(Value):
    """What became of a step. Indices and labels are of the points that it was given."""

    #: Name of the step.
    operation: str
    #: Points that it was given.
    num_points_in: int
    #: Points that it passed on.
    num_points_out: int
    #: On the server.
    elapsed_ms: float
    #: None if it was quiet, or the cloud is all there is.
    answer: StepAnswer | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PipelineResult(Value):
    """What a pipeline found."""

    #: One a step.
    steps: tuple[StepResult, ...]
    #: What the last step left, if asked for.
    cloud: PointCloud | None
    #: The same, kept on the server, if asked for.
    kept: CloudHandle | None

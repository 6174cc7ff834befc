"""Answers of the perception toolbox."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .geometry import Floats, OrientedBox, Plane, PointCloud, Pose
from .scene import ShapeFeatures


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FilteredCloud(Value):
    """What a filter kept."""

    cloud: PointCloud
    #: Of the kept points in the input, (M,) uint32.
    indices: npt.NDArray[np.uint32]


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

    plane: Plane
    kind: PlaneKind
    #: Of its points in the input, ascending, (M,) uint32.
    indices: npt.NDArray[np.uint32]


class ClusterMethod(Name):
    """What connects points."""

    EUCLIDEAN = "euclidean"
    DBSCAN = "dbscan"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Clusters(Value):
    """Connected groups of points."""

    #: Number of each point's cluster, -1 for noise, (N,) int32.
    labels: npt.NDArray[np.int32]
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Registration(Value):
    """How a source cloud lies over a target cloud."""

    t_target_source: Pose
    #: Share of source points with a partner, 0 to 1.
    fitness: float
    #: Of those pairs, metres.
    rmse_m: float
    #: Of a right perturbation in source, (6, 6).
    covariance: Floats
    iterations: int
    converged: bool
    #: Axes (x, y, z, rotation x, y, z) that the clouds do not fix.
    degenerate_axes: tuple[bool, ...]

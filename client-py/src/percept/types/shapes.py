"""Neighbours, local features, boxes and hulls of clouds; planes of depth images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ._value import Value
from .geometry import Floats, OrientedBox, Plane


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Neighbours(Value):
    """Neighbours of Q queries, nearest first."""

    #: The neighbours of query i are at offsets[i] to offsets[i + 1] of the other two, (Q + 1,) uint32.
    offsets: npt.NDArray[np.uint32]
    #: Of the cloud's points, uint32.
    indices: npt.NDArray[np.uint32]
    #: Metres, float32.
    distances_m: npt.NDArray[np.float32]

    def of(self, query: int) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.float32]]:
        """Indices and distances of one query's neighbours."""
        part = slice(int(self.offsets[query]), int(self.offsets[query + 1]))
        return self.indices[part], self.distances_m[part]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LocalFeatures(Value):
    """The surface about each point, (N,) float32; NaN where it is undefined. Eigenvalues l1 >= l2 >= l3."""

    #: (l1 - l2) / l1.
    linearity: npt.NDArray[np.float32]
    #: (l2 - l3) / l1.
    planarity: npt.NDArray[np.float32]
    #: l3 / l1.
    scattering: npt.NDArray[np.float32]
    #: 1 - |n . z| of the normal n.
    verticality: npt.NDArray[np.float32]
    #: l3 / (l1 + l2 + l3).
    curvature: npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Boxes(Value):
    """Boxes around a cloud."""

    #: Along the axes of the input's frame.
    axis_aligned: OrientedBox
    #: Upright along z, of least area.
    upright: OrientedBox
    #: Of least volume; x, y, z along the longest, middle and shortest edge.
    minimal: OrientedBox


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ConvexHull(Value):
    """The convex hull of a cloud."""

    #: Corners, metres, (V, 3).
    vertices: Floats
    #: Of corners, counter-clockwise from outside, (T, 3) uint32; none if the cloud is flat.
    triangles: npt.NDArray[np.uint32]
    #: 0 if flat.
    volume_m3: float
    #: Both sides if flat.
    area_m2: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DepthPlane(Value):
    """A connected plane of a depth image, optical frame."""

    plane: Plane
    #: Mean of its points, metres, (3,).
    centre: Floats
    num_pixels: int
    #: Of its points from the plane, metres.
    rms_m: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DepthPlanes(Value):
    """Planes of a depth image."""

    planes: tuple[DepthPlane, ...]
    #: Number of each pixel's plane, -1 for none, (H, W) int32.
    labels: npt.NDArray[np.int32]

"""Poses, boxes, clouds, cameras. Metres, radians; `t_a_b` maps coordinates in b to coordinates in a."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .._arrays import Array, checked, same_length, vector
from ..errors import InvalidArgument
from ._value import Name, Value

Floats = npt.NDArray[np.float64]


def _identity_rotation() -> Floats:
    return np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class Pose(Value):
    """A rigid transform. Its name, where it is a field, says from where to where."""

    # A matrix beside `@` is a mistake: the product would be an array of poses.
    __array_ufunc__ = None

    #: Metres, (3,) float64.
    translation: Floats = field(default_factory=lambda: np.zeros(3))
    #: Unit quaternion x, y, z, w, (4,) float64.
    rotation: Floats = field(default_factory=_identity_rotation)

    def __post_init__(self) -> None:
        object.__setattr__(self, "translation", vector("translation", self.translation, 3))
        object.__setattr__(self, "rotation", vector("rotation", self.rotation, 4))

    @property
    def matrix(self) -> Floats:
        """(4, 4) float64, homogeneous."""
        out = np.eye(4)
        out[:3, :3] = rotation_matrices(self.rotation[None])[0]
        out[:3, 3] = self.translation
        return out

    @property
    def yaw_rad(self) -> float:
        """Heading about z, in (-pi, pi]."""
        x, y, z, w = self.rotation
        return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    @classmethod
    def from_matrix(cls, matrix: Array) -> Pose:
        """From a (4, 4) homogeneous matrix whose rotation is orthonormal within 1e-3."""
        m = checked("matrix", matrix, (4, 4), np.float64, np.float32).astype(np.float64)
        r = m[:3, :3]
        if not np.allclose(r @ r.T, np.eye(3), atol=1e-3) or np.linalg.det(r) < 0:
            message = "matrix holds no rotation: its upper left 3 x 3 is not orthonormal; normalise it"
            raise InvalidArgument(message, reason="ROTATION_INVALID", field="matrix")
        return cls(m[:3, 3], _quaternion(r))

    @classmethod
    def from_yaw(cls, x_m: float, y_m: float, yaw_rad: float, *, z_m: float = 0.0) -> Pose:
        """Upright, heading yaw_rad about z."""
        half = yaw_rad / 2
        return cls(np.array([x_m, y_m, z_m]), np.array([0.0, 0.0, np.sin(half), np.cos(half)]))

    def inverse(self) -> Pose:
        """The way back: `t_a_b.inverse()` is `t_b_a`."""
        rotation = self.rotation * np.array([-1.0, -1.0, -1.0, 1.0])
        return Pose(-(rotation_matrices(rotation[None])[0] @ self.translation), rotation)

    def __matmul__(self, other: Pose) -> Pose:
        """One after the other: `t_a_b @ t_b_c` is `t_a_c`."""
        if not isinstance(other, Pose):
            return NotImplemented
        (ax, ay, az), aw = self.rotation[:3], self.rotation[3]
        (bx, by, bz), bw = other.rotation[:3], other.rotation[3]
        rotation = np.array(
            [
                aw * bx + ax * bw + ay * bz - az * by,
                aw * by - ax * bz + ay * bw + az * bx,
                aw * bz + ax * by - ay * bx + az * bw,
                aw * bw - ax * bx - ay * by - az * bz,
            ]
        )
        turned = rotation_matrices(self.rotation[None])[0] @ other.translation
        return Pose(self.translation + turned, rotation / np.linalg.norm(rotation))

    def apply(self, points: Array) -> Floats:
        """(N, 3) or (3,) points, metres, of frame b in frame a, where this is `t_a_b`; float64."""
        p = np.asarray(points, dtype=np.float64)
        if p.ndim not in (1, 2) or p.shape[-1] != 3:
            message = f"points has the shape {p.shape}; give (N, 3) or (3,)"
            raise InvalidArgument(message, reason="ARRAY_INVALID", field="points")
        moved: Floats = p @ rotation_matrices(self.rotation[None])[0].T + self.translation
        return moved


def rotation_matrices(quaternions: Floats) -> Floats:
    """(N, 3, 3) of (N, 4) unit quaternions x, y, z, w."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _quaternion(r: Floats) -> Floats:
    """x, y, z, w of a rotation matrix: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [0, r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [0, 0, r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [0, 0, 0, r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    q: Floats = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    return -q if q[3] < 0 else q


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OrientedBox(Value):
    """A box with a pose, in the frame named by its holder."""

    #: Box coordinates (origin at the centre) to the holder's frame.
    t_frame_box: Pose
    #: Edge lengths along the box's own axes, metres, (3,).
    size_m: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_m", vector("size_m", self.size_m, 3))

    @property
    def centre(self) -> Floats:
        """Metres, (3,)."""
        return self.t_frame_box.translation


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Plane(Value):
    """normal . p + offset_m = 0."""

    #: Unit length, (3,).
    normal: Floats
    offset_m: float


class DistortionModel(Name):
    """Lens distortion, as ROS and OpenCV name it."""

    NONE = "none"
    PLUMB_BOB = "plumb_bob"
    RATIONAL = "rational"
    FISHEYE = "fisheye"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CameraIntrinsics(Value):
    """A pinhole camera; the centre of the top-left pixel is (0, 0)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion_model: DistortionModel | str = DistortionModel.NONE
    #: In the model's order: plumb_bob k1 k2 p1 p2 k3, rational k1 k2 p1 p2 k3 to k6, fisheye k1 to k4.
    distortion: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud(Value):
    """N points with optional channels, one entry a point. Non-finite points mean no return."""

    #: Metres, (N, 3) float32.
    points: Array
    #: RGB, (N, 3) uint8.
    colours: Array | None = field(default=None, kw_only=True)
    #: As the sensor gives them, (N,) float32.
    intensities: Array | None = field(default=None, kw_only=True)
    #: Unit length, zero where undefined, (N, 3) float32.
    normals: Array | None = field(default=None, kw_only=True)
    #: Seconds after the message's stamp, (N,) float32.
    time_offsets_s: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self._check("points", ("N", 3), np.float32)
        self._check("colours", ("N", 3), np.uint8)
        self._check("intensities", ("N",), np.float32)
        self._check("normals", ("N", 3), np.float32)
        self._check("time_offsets_s", ("N",), np.float32)

    def _check(self, name: str, shape: tuple[int | str, ...], dtype: npt.DTypeLike) -> None:
        value = getattr(self, name)
        if value is None and name != "points":
            return
        array = checked(name, value, shape, dtype)
        same_length(name, array, len(self.points))
        object.__setattr__(self, name, array)

    @property
    def num_points(self) -> int:
        """N."""
        return len(self.points)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, chosen: Array | slice | Sequence[int]) -> PointCloud:
        """Some of the points with all their channels: by a mask (N,) of bool, by indices, or by a slice."""
        index = chosen if isinstance(chosen, slice) else np.asarray(chosen)
        if not isinstance(index, slice) and index.shape == (0,):
            index = index.astype(np.int64)
        if not isinstance(index, slice):
            is_mask = index.dtype == bool
            if index.ndim != 1 or (is_mask and len(index) != len(self)) or index.dtype.kind not in "biu":
                wanted = f"a mask of bool ({len(self)},), indices (M,) or a slice"
                message = f"chosen is {index.dtype} {index.shape}; give {wanted}"
                raise InvalidArgument(message, reason="ARRAY_INVALID", field="chosen")
            if not is_mask and index.size and not -len(self) <= index.min() <= index.max() < len(self):
                message = f"chosen holds {index.min()} to {index.max()}, and there are {len(self)} points"
                raise InvalidArgument(message, reason="OUT_OF_RANGE", field="chosen")
        channels = (self.colours, self.intensities, self.normals, self.time_offsets_s)
        colours, intensities, normals, times = (None if c is None else c[index] for c in channels)
        return PointCloud(
            self.points[index],
            colours=colours,
            intensities=intensities,
            normals=normals,
            time_offsets_s=times,
        )

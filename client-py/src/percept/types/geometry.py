"""Poses, boxes, cameras. Metres, radians; `t_a_b` maps coordinates in b to coordinates in a."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from .._arrays import Array, checked, number, vector
from ..errors import InvalidArgument, WrongType
from ._show import flat, table
from ._value import Name, Value, one_of

Floats = npt.NDArray[np.float64]


def _identity_rotation() -> Floats:
    return np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Pose(Value):
    """A rigid transform. Its name, where it is a field, says from where to where: `t_a_b` takes coordinates
    of frame b, metres, to coordinates of frame a.

        Pose.from_xy_yaw(2.0, 1.0, 0.5)                  # a robot on the floor
        Pose.from_xyz(0.2, 0.0, 0.3, pitch_rad=0.1)      # a mount
        Pose.from_matrix(t_map_base)                     # (4, 4)
        Pose(translation=(0, 0, 1), rotation=(0, 0, 0, 1))

    Nothing is taken by position: three bare numbers are x, y, z to one reader and x, y, yaw to the next.
    """

    # A matrix beside `@` is a mistake: the product would be an array of poses.
    __array_ufunc__ = None

    #: Metres, (3,) float64.
    translation: Floats = field(default_factory=lambda: np.zeros(3))
    #: Unit quaternion x, y, z, w, (4,) float64.
    rotation: Floats = field(default_factory=_identity_rotation)

    def __new__(cls, *bare: object, **_fields: object) -> Pose:
        """Refuses what is given by position (WrongType, which is a TypeError)."""
        if bare:
            raise _no_pose("Pose", bare[0] if len(bare) == 1 else bare)
        return super().__new__(cls)

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

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw about the fixed axes x, y, z, as `from_xyz` takes them; pitch within a quarter
        turn."""
        r = rotation_matrices(self.rotation[None])[0]
        pitch = math.asin(max(-1.0, min(1.0, -float(r[2, 0]))))
        return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])

    def _flat(self) -> dict[str, object]:
        names = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
        return dict(zip(names, (*self.translation.tolist(), *self.rpy_rad), strict=True))

    def _repr_html_(self) -> str:
        return table([self._flat()], caption="Pose")

    @classmethod
    def from_matrix(cls, matrix: Array) -> Pose:
        """From a (4, 4) homogeneous matrix whose rotation is orthonormal within 1e-3."""
        m = checked("matrix", matrix, (4, 4), np.float64, np.float32).astype(np.float64)
        r = m[:3, :3]
        if not np.allclose(r @ r.T, np.eye(3), atol=1e-3) or np.linalg.det(r) < 0:
            message = "matrix holds no rotation: its upper left 3 x 3 is not orthonormal; normalise it"
            raise InvalidArgument(message, reason="ROTATION_INVALID", field="matrix")
        return cls(translation=m[:3, 3], rotation=_quaternion(r))

    @classmethod
    def from_xy_yaw(cls, x_m: float, y_m: float, yaw_rad: float) -> Pose:
        """Upright on the floor: at (x_m, y_m, 0), heading yaw_rad about z, from x towards y."""
        return cls.from_xyz(x_m, y_m, 0.0, yaw_rad=yaw_rad)

    @classmethod
    def from_xyz(
        cls,
        x_m: float,
        y_m: float,
        z_m: float,
        *,
        roll_rad: float = 0.0,
        pitch_rad: float = 0.0,
        yaw_rad: float = 0.0,
    ) -> Pose:
        """At (x_m, y_m, z_m), turned about the fixed axes x, y, z, in this order (REP-103, URDF's rpy)."""
        half = np.array([roll_rad, pitch_rad, yaw_rad], dtype=np.float64) / 2
        # What is infinite becomes NaN, which whoever uses the pose refuses.
        with np.errstate(invalid="ignore"):
            (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
        rotation = [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
        return cls(translation=np.array([x_m, y_m, z_m]), rotation=np.array(rotation))

    def inverse(self) -> Pose:
        """The way back: `t_a_b.inverse()` is `t_b_a`."""
        rotation = self.rotation * np.array([-1.0, -1.0, -1.0, 1.0])
        turned = rotation_matrices(rotation[None])[0] @ self.translation
        return Pose(translation=-turned, rotation=rotation)

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
        return Pose(translation=self.translation + turned, rotation=rotation / np.linalg.norm(rotation))

    def apply(self, points: Array) -> Floats:
        """(N, 3) or (3,) points, metres, of frame b in frame a, where this is `t_a_b`; float64."""
        p = np.asarray(points, dtype=np.float64)
        if p.ndim not in (1, 2) or p.shape[-1] != 3:
            message = f"points has the shape {p.shape}; give (N, 3) or (3,)"
            raise InvalidArgument(message, reason="ARRAY_INVALID", field="points")
        moved: Floats = p @ rotation_matrices(self.rotation[None])[0].T + self.translation
        return moved


#: A place on the floor, map frame: (x, y) in metres, or a pose there.
FloorPoint: TypeAlias = Sequence[float] | Pose


def as_pose(name: str, value: object) -> Pose:
    """A pose, or the one of its (4, 4) matrix; anything else could be misread, and is refused."""
    if isinstance(value, Pose):
        return value
    if isinstance(value, np.ndarray) and value.shape == (4, 4):
        return Pose.from_matrix(value)
    raise _no_pose(name, value)


def _no_pose(name: str, value: object) -> WrongType:
    remedy = "x, y, z and x, y, yaw look alike: give Pose.from_xyz(x, y, z), Pose.from_xy_yaw(x, y, yaw), "
    message = (
        f"{name} is {value!r}, which is no pose; {remedy}Pose(translation=, rotation=) or a (4, 4) array"
    )
    return WrongType(message, reason="POSE_INVALID", field="" if name == "Pose" else name)


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
        object.__setattr__(self, "t_frame_box", as_pose("t_frame_box", self.t_frame_box))
        object.__setattr__(self, "size_m", vector("size_m", self.size_m, 3))

    @property
    def centre(self) -> Floats:
        """Metres, (3,)."""
        return self.t_frame_box.translation

    def _flat(self) -> dict[str, object]:
        sizes = {f"size_{axis}_m": size for axis, size in zip("xyz", self.size_m.tolist(), strict=True)}
        return {**flat(self.t_frame_box), **sizes}


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


_NUM_COEFFICIENTS = {"none": 0, "plumb_bob": 5, "rational": 8, "fisheye": 4}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CameraIntrinsics(Value):
    """A pinhole camera; the centre of the top-left pixel is (0, 0). Checked when made, by the server's rules:
    raises InvalidArgument, which is a ValueError, with field, value and remedy."""

    #: 1 to 16384.
    width_px: int
    #: 1 to 16384.
    height_px: int
    #: Focal lengths, above 0.
    fx_px: float
    fy_px: float
    #: Principal point.
    cx_px: float
    cy_px: float
    distortion_model: DistortionModel | str = DistortionModel.NONE
    #: In the model's order: plumb_bob k1 k2 p1 p2 k3, rational k1 k2 p1 p2 k3 to k6, fisheye k1 to k4; none
    #: without a model.
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            must = "a whole number of pixels from 1 to 16384"
            number(name, value, low=0, high=16384, must=must)
            if value != int(value):
                raise InvalidArgument(
                    f"{name} is {value!r}; it must be {must}", reason="OUT_OF_RANGE", field=name
                )
            object.__setattr__(self, name, int(value))
        for name in ("fx_px", "fy_px"):
            number(name, getattr(self, name), low=0, must="a number of pixels above 0")
        for name in ("cx_px", "cy_px"):
            number(name, getattr(self, name), must="a finite number of pixels")
        one_of("distortion_model", self.distortion_model, DistortionModel)
        coefficients = [number("distortion", value, must="finite numbers") for value in self.distortion]
        wanted = _NUM_COEFFICIENTS[str(self.distortion_model).lower()]
        if len(coefficients) != wanted:
            message = (
                f"distortion holds {len(coefficients)} coefficients, and {self.distortion_model} has "
                f"{wanted}; give exactly these, zeros for those that are unknown"
            )
            raise InvalidArgument(message, reason="SIZE_MISMATCH", field="distortion")
        object.__setattr__(self, "distortion", tuple(coefficients))

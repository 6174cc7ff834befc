"""What sensors send: one timestamped message each. Stamps are nanoseconds since the Unix epoch of the
sensor's clock, each greater than the one before of its sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from .._arrays import Array, checked, number, same_length, vector
from ..errors import InvalidArgument
from ._value import Value
from .cloud import PointCloud
from .geometry import Floats, Pose, as_pose


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EncodedImage(Value):
    """A compressed image as its file's bytes: PNG (16-bit grey for depth) or, for colour, JPEG."""

    #: The file's bytes.
    data: bytes
    #: Columns.
    width_px: int
    #: Rows.
    height_px: int


def _depth(image: Array | EncodedImage, metres_per_unit: float | None) -> Array | EncodedImage:
    units = isinstance(image, EncodedImage)
    if not isinstance(image, EncodedImage):
        image = checked("depth", image, ("H", "W"), np.uint16, np.float32)
        units = image.dtype.kind == "u"
    if units and metres_per_unit is None:
        message = "metres_per_unit is missing; depth in integer units needs it, e.g. 0.001 for millimetres"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="metres_per_unit")
    if metres_per_unit is not None:
        must = "a number of metres above 0, e.g. 0.001 for millimetres"
        scale = number("metres_per_unit", metres_per_unit, low=0, must=must)
        # It would be left aside without a word, and depth in millimetres taken for metres.
        if isinstance(image, np.ndarray) and not units and scale != 1:
            message = (
                f"metres_per_unit is {metres_per_unit!r}, but depth of float32 is in metres; leave it out, "
                "and multiply depth by it if that is in other units"
            )
            raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field="metres_per_unit")
    return image


def _colour(image: Array | EncodedImage) -> Array | EncodedImage:
    return image if isinstance(image, EncodedImage) else checked("colour", image, ("H", "W", 3), np.uint8)


def _colour_or_grey(image: Array | EncodedImage) -> Array | EncodedImage:
    is_grey = isinstance(image, np.ndarray) and image.ndim == 2
    return checked("colour", image, ("H", "W"), np.uint8) if is_grey else _colour(image)


@dataclass(frozen=True, eq=False, repr=False)
class DepthFrame(Value):
    """A depth image: (H, W) uint16 with metres_per_unit (0 and 65535: no return), or float32 metres."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    depth: Array | EncodedImage = field(kw_only=True)
    metres_per_unit: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "depth", _depth(self.depth, self.metres_per_unit))


@dataclass(frozen=True, eq=False, repr=False)
class RgbdFrame(Value):
    """Depth, as in DepthFrame, with the colour image of the same size: (H, W, 3) uint8 RGB, or encoded."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    depth: Array | EncodedImage = field(kw_only=True)
    colour: Array | EncodedImage = field(kw_only=True)
    #: Metres of one unit of depth; needed if that is in integers.
    metres_per_unit: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "depth", _depth(self.depth, self.metres_per_unit))
        object.__setattr__(self, "colour", _colour(self.colour))


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrame(Value):
    """An image: (H, W, 3) uint8 RGB, (H, W) uint8 grey, or encoded."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    colour: Array | EncodedImage = field(kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "colour", _colour_or_grey(self.colour))


@dataclass(frozen=True, eq=False, repr=False)
class CloudFrame(Value):
    """A cloud in the sensor frame."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    #: Metres; its time_offsets_s count from stamp_ns.
    cloud: PointCloud = field(kw_only=True)


@dataclass(frozen=True, eq=False, repr=False)
class ScanFrame(Value):
    """A sweep of a planar lidar; beam i points along angle_min_rad + i * angle_increment_rad."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    #: Metres, (B,) float32; +inf no return, NaN or -inf invalid (REP-117).
    ranges_m: Array = field(kw_only=True)
    #: Of the first beam, counter-clockwise from the sensor's x axis.
    angle_min_rad: float = field(kw_only=True)
    angle_increment_rad: float = field(kw_only=True)
    #: Ranges below it are no measurement.
    range_min_m: float = field(kw_only=True)
    #: Ranges at or beyond it mean free up to it.
    range_max_m: float = field(kw_only=True)
    #: From beam to beam; 0: all at once.
    time_increment_s: float = field(default=0.0, kw_only=True)
    #: (B,) float32.
    intensities: Array | None = field(default=None, kw_only=True)
    #: (E, B) float32: what each beam met behind `ranges_m` (glass, rain), metres; NaN or inf where nothing.
    later_echoes_m: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ranges_m", checked("ranges_m", self.ranges_m, ("B",), np.float32))
        if self.intensities is not None:
            array = checked("intensities", self.intensities, ("B",), np.float32)
            same_length("intensities", array, len(self.ranges_m))
            object.__setattr__(self, "intensities", array)
        if self.later_echoes_m is not None:
            echoes = checked("later_echoes_m", self.later_echoes_m, ("E", "B"), np.float32)
            same_length("later_echoes_m", echoes.T, len(self.ranges_m))
            object.__setattr__(self, "later_echoes_m", echoes)


@dataclass(frozen=True, eq=False, repr=False)
class ImuFrame(Value):
    """One inertial sample in the sensor frame."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    #: rad/s, (3,).
    angular_velocity_radps: Floats = field(kw_only=True)
    #: Specific force, m/s^2, (3,): at rest it points up with 9.81.
    linear_acceleration_mps2: Floats = field(kw_only=True)

    def __post_init__(self) -> None:
        for name in ("angular_velocity_radps", "linear_acceleration_mps2"):
            object.__setattr__(self, name, vector(name, getattr(self, name), 3))


@dataclass(frozen=True, eq=False, repr=False)
class OdometryFrame(Value):
    """One odometry sample."""

    #: Of the session; it was declared before.
    sensor_id: str
    #: Nanoseconds by the sensor's clock, later than those before.
    stamp_ns: int = field(kw_only=True)
    #: Base in the odometry's own, drifting frame.
    t_odom_base: Pose = field(kw_only=True)
    #: Of the step since the sample before, in base, (6, 6): x, y, z, rotation x, y, z.
    covariance: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_odom_base", as_pose("t_odom_base", self.t_odom_base))
        if self.covariance is not None:
            array = checked("covariance", self.covariance, (6, 6), np.float64)
            object.__setattr__(self, "covariance", array)


SensorFrame: TypeAlias = (
    DepthFrame | RgbdFrame | CameraFrame | CloudFrame | ScanFrame | ImuFrame | OdometryFrame
)

"""Point clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .._arrays import Array, checked, same_length
from ..errors import InvalidArgument
from ._value import Value


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

"""Point clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from .._arrays import Array, checked, same_length
from .._optional import needed
from ..errors import InvalidArgument, WrongType
from ._show import png
from ._value import Value
from .geometry import OrientedBox


class Indexed(Protocol):
    """What says which points it is of: PlaneSegment, Ground, FilteredCloud."""

    @property
    def indices(self) -> npt.NDArray[np.uint32]:
        """Of points in the input, (M,)."""


class Labelled(Protocol):
    """What numbers the part that each point belongs to: Clusters, Supervoxels, SupportedObjects."""

    @property
    def labels(self) -> npt.NDArray[np.int32]:
        """-1 for none, (N,)."""


#: Numbers of points' parts, or an answer that has them.
Labels: TypeAlias = Labelled | Array


def labels_of(value: Labels, num_points: int | None = None) -> npt.NDArray[np.int32]:
    """(N,) int32; of other types of whole numbers, too."""
    array = np.asarray(getattr(value, "labels", value))
    if array.ndim != 1 or array.dtype.kind not in "iu" or num_points not in (None, len(array)):
        wanted = "N" if num_points is None else num_points
        message = (
            f"labels is {array.dtype} {array.shape}; give whole numbers ({wanted},), one a point, or the "
            "Clusters, Supervoxels or SupportedObjects of this cloud"
        )
        raise InvalidArgument(message, reason="ARRAY_INVALID", field="labels")
    return array.astype(np.int32)


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
        """Some of the points with all their channels: by a mask (N,) of bool, by indices, or by a slice. What
        fits none of these is an InvalidArgument."""
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

    def select(
        self, part: Indexed | Labelled | OrientedBox, *, label: int | None = None, rest: bool = False
    ) -> PointCloud:
        """The points that belong to a part, with all their channels; with `rest` all others.

        part: what was found in this cloud: a plane, ground or filtered points; clusters, supervoxels or
        objects on a support, of which `label` says which (-1: what belongs to none); or a box in the frame
        of the cloud, its faces included.

            floor = cloud.select(planes[0])
            cup = cloud.select(clusters, label=3)
        """
        mask = np.zeros(len(self), bool)
        if isinstance(part, OrientedBox):
            inside = np.abs(part.t_frame_box.inverse().apply(self.points)) <= part.size_m / 2
            mask[inside.all(axis=1)] = True
        elif hasattr(part, "labels"):
            if label is None:
                message = "label is missing: the part numbers its clusters or objects, say which; -1 is none"
                raise InvalidArgument(message, reason="FIELD_MISSING", field="label")
            mask[labels_of(part.labels, len(self)) == label] = True
        elif hasattr(part, "indices"):
            chosen = np.asarray(part.indices)
            if chosen.size and chosen.max() >= len(self):
                message = f"part has point {chosen.max()}, and there are {len(self)}: it is of another cloud"
                raise InvalidArgument(message, reason="OUT_OF_RANGE", field="part")
            mask[chosen] = True
        else:
            message = (
                f"part is {type(part).__name__}; give a PlaneSegment, Ground, FilteredCloud, Clusters, "
                "Supervoxels, SupportedObjects or OrientedBox, and masks and indices as cloud[mask]"
            )
            raise WrongType(message, reason="PART_INVALID", field="part")
        if label is not None and not hasattr(part, "labels"):
            message = f"label is {label}, and a {type(part).__name__} has none; leave it out"
            raise InvalidArgument(message, reason="FIELD_UNKNOWN", field="label")
        return self[~mask if rest else mask]

    def to_open3d(self) -> Any:  # noqa: ANN401
        """An open3d.geometry.PointCloud with points, colours (0 to 1) and normals; what Open3D has no channel
        for, intensities and times, is left. ImportError without Open3D."""
        o3d = needed("open3d", "to_open3d()", "open3d")
        out = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.points.astype(np.float64)))
        if self.colours is not None:
            out.colors = o3d.utility.Vector3dVector(self.colours / 255.0)
        if self.normals is not None:
            out.normals = o3d.utility.Vector3dVector(self.normals.astype(np.float64))
        return out

    def to_pandas(self) -> Any:  # noqa: ANN401
        """A pandas.DataFrame with a row a point: x_m, y_m, z_m, and of the channels that it has red, green,
        blue, intensity, normal_x, normal_y, normal_z, time_offset_s. ImportError without pandas."""
        pandas = needed("pandas", "to_pandas()", "pandas")
        columns = dict(zip(("x_m", "y_m", "z_m"), self.points.T, strict=True))
        if self.colours is not None:
            columns |= dict(zip(("red", "green", "blue"), self.colours.T, strict=True))
        if self.intensities is not None:
            columns["intensity"] = self.intensities
        if self.normals is not None:
            columns |= dict(zip(("normal_x", "normal_y", "normal_z"), self.normals.T, strict=True))
        if self.time_offsets_s is not None:
            columns["time_offset_s"] = self.time_offsets_s
        return pandas.DataFrame(columns)

    def _repr_png_(self) -> bytes | None:
        return png(lambda plot: plot.cloud(self))

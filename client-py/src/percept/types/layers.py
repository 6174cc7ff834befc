"""Space: what is at points, in boxes, along rays, in voxels, and where the map changed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .._optional import needed
from ._value import Name, Value
from .geometry import Floats
from .maps import MapStamp, Region, cell_centres


class MapLayer(Name):
    """A part of the map that can be asked."""

    #: Voxels where the session has them, the grid otherwise.
    UNSPECIFIED = "unspecified"
    #: The 2D grid: heights do not count.
    OCCUPANCY = "occupancy"
    #: Occupancy in three dimensions.
    VOXELS = "voxels"
    #: The fused cloud; changes() only.
    CLOUD = "cloud"
    #: Heights of the ground; changes() only.
    HEIGHT = "height"
    #: The surface; changes() only.
    SURFACE = "surface"


class Storey(Name):
    """Which storey is read where there are several above each other."""

    #: The lowest.
    UNSPECIFIED = "unspecified"
    LOWEST = "lowest"
    HIGHEST = "highest"
    #: That whose ground is nearest to a height.
    NEAREST = "nearest"


class SpaceState(Name):
    """What is at a place."""

    UNSPECIFIED = "unspecified"
    #: No beam has been there.
    UNKNOWN = "unknown"
    #: More likely free than not.
    FREE = "free"
    #: More likely occupied than not.
    OCCUPIED = "occupied"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Voxels(Value):
    """Occupancy in three dimensions: blocks of 8 x 8 x 8 voxels of which something is known."""

    #: Numbers of the blocks along x, y, z, ascending, (N, 3): a block's lowest corner is 8 voxels times it.
    keys: npt.NDArray[np.int32]
    #: -1 unknown, 0 to 100 percent occupied, (N, 8, 8, 8) in the order z, y, x.
    cells: npt.NDArray[np.int8]
    #: Edge of a voxel, metres.
    voxel_size_m: float
    stamp: MapStamp

    def centres(self, *, occupied: bool = True) -> Floats:
        """Centres of the occupied voxels, or of the free ones, metres, map frame, (M, 3)."""
        wanted = self.cells > 50 if occupied else (self.cells >= 0) & (self.cells <= 50)
        block, z, y, x = np.nonzero(wanted)
        indices = 8 * self.keys[block] + np.stack([x, y, z], axis=1)
        return (indices.astype(np.float64) + 0.5) * self.voxel_size_m


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PointAnswers(Value):
    """What is at points, in their order."""

    states: tuple[SpaceState, ...]
    #: To the surface of the nearest occupied cell or voxel, metres; negative inside of one, (N,).
    distances_m: Floats
    #: Direction in which the distance grows, and how fast; zero where nothing is near, (N, 3).
    gradients: Floats
    #: Nothing is told to be farther, metres.
    max_distance_m: float
    #: The layer that was asked.
    layer: MapLayer
    stamp: MapStamp


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RayAnswers(Value):
    """Where rays ended, in their order."""

    #: OCCUPIED or, if asked for, UNKNOWN: what ended a ray. FREE: nothing within its range.
    states: tuple[SpaceState, ...]
    #: From the origin to where it ended, metres, (N,).
    distances_m: Floats
    #: Where it ended, metres, map frame, (N, 3).
    points: Floats
    stamp: MapStamp


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BoxAnswers(Value):
    """What is in boxes, in their order."""

    #: OCCUPIED if any voxel is; else UNKNOWN if any is; else FREE.
    states: tuple[SpaceState, ...]
    #: Voxels that are occupied, free, unknown, (N, 3).
    counts: npt.NDArray[np.int64]
    stamp: MapStamp


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Heights(Value):
    """How high the ground is, and where a robot can drive: (H, W) arrays, row 0 at the smallest y, NaN where
    nothing is known."""

    #: Height of the ground, map frame, metres.
    ground_m: npt.NDArray[np.float32]
    #: Its standard deviation, metres.
    sigma_m: npt.NDArray[np.float32]
    #: Highest of what stands on it and is no higher than the robot, map frame, metres.
    top_m: npt.NDArray[np.float32]
    #: Slope over the robot's footprint, radians.
    slope_rad: npt.NDArray[np.float32]
    #: Largest step within it, metres.
    step_m: npt.NDArray[np.float32]
    #: Standard deviation of the ground from a plane within it, metres.
    roughness_m: npt.NDArray[np.float32]
    #: 0, not passable, to 1, flat.
    traversability: npt.NDArray[np.float32]
    #: Whether a drop was seen instead of ground.
    is_drop: npt.NDArray[np.bool_]
    #: Edge of a cell, metres.
    resolution_m: float
    #: Lower-left corner of cell (0, 0), metres, (2,).
    origin: Floats
    stamp: MapStamp

    def to_xarray(self) -> Any:  # noqa: ANN401
        """An xarray.Dataset of all arrays over y and x, the coordinates of their cells' centres, metres, map
        frame. ImportError without xarray."""
        xarray = needed("xarray", "to_xarray()", "xarray")
        coords = cell_centres(self.ground_m.shape, self.origin, self.resolution_m)
        arrays = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        layers = {
            name: (("y", "x"), a) for name, a in arrays.items() if isinstance(a, np.ndarray) and a.ndim == 2
        }
        attributes = {"frame_id": self.stamp.frame_id, "map_version": self.stamp.map_version}
        return xarray.Dataset(layers, coords, attributes | {"resolution_m": self.resolution_m})


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Mesh(Value):
    """A surface as triangles."""

    #: Metres, map frame, (V, 3).
    positions: npt.NDArray[np.float32]
    #: Of unit length, towards where the surface was seen from; zero where undefined, (V, 3).
    normals: npt.NDArray[np.float32]
    #: RGB; grey where the surface has none, (V, 3).
    colours: npt.NDArray[np.uint8]
    #: Numbers of vertices, counter-clockwise as seen, (T, 3).
    triangles: npt.NDArray[np.uint32]
    stamp: MapStamp

    def to_open3d(self) -> Any:  # noqa: ANN401
        """An open3d.geometry.TriangleMesh with normals and colours (0 to 1). ImportError without Open3D."""
        o3d = needed("open3d", "to_open3d()", "open3d")
        vectors = o3d.utility.Vector3dVector
        out = o3d.geometry.TriangleMesh(
            vectors(self.positions.astype(np.float64)),
            o3d.utility.Vector3iVector(self.triangles.astype(np.int32)),
        )
        out.vertex_normals = vectors(self.normals.astype(np.float64))
        out.vertex_colors = vectors(self.colours / 255.0)
        return out


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapChanges(Value):
    """Where the map changed since a version."""

    #: Squares in which something may be otherwise than at that version.
    regions: tuple[Region, ...]
    #: The layer that was asked.
    layer: MapLayer
    #: Its map_version is the next question's since_version.
    stamp: MapStamp

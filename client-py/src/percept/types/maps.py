"""Maps: grids, clouds, files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .._optional import needed
from ._show import png, to_pil
from ._value import Name, Value
from .cloud import PointCloud
from .geometry import Floats, Pose
from .sensors import SensorKind


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapStamp(Value):
    """From which state of the map an answer was read."""

    #: Grows with each change of the map.
    map_version: int
    #: Newest frame in it.
    stamp_ns: int
    #: Frame of all coordinates in the answer.
    frame_id: str


class LoopState(Name):
    """What became of a loop that was found."""

    UNSPECIFIED = "unspecified"
    #: Waits for others that say the same.
    PENDING = "pending"
    #: Holds the map together.
    ACTIVE = "active"
    #: Nothing confirmed it in time, or it contradicts what is believed.
    REJECTED = "rejected"
    #: Taken out by veto_loop().
    VETOED = "vetoed"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Loop(Value):
    """A place seen again: one keyframe measured from an earlier one."""

    loop_id: int
    #: The keyframe that was there before.
    from_keyframe_id: int
    #: The keyframe that came back.
    to_keyframe_id: int
    #: Base at `to`, seen from base at `from`.
    t_from_to: Pose
    #: Share of the scan that fits the place, 0 to 1.
    inlier_ratio: float
    state: LoopState


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopVeto(Value):
    """What a veto did."""

    #: With its new state.
    loop: Loop
    #: Keyframes that moved.
    num_keyframes_moved: int
    #: Of the map with it.
    map_version: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapOptimised(Value):
    """What an optimisation did."""

    #: Keyframes that moved.
    num_keyframes_moved: int
    #: Of the map with it.
    map_version: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapImported(Value):
    """What became of a map that was given."""

    #: Views that it was made into.
    num_keyframes: int
    #: Share of its occupied cells, or of its points, that they show, 0 to 1; inside of walls nothing is seen.
    occupied_share: float
    #: Share of its free cells that they show, 0 to 1.
    free_share: float
    #: Of the map with it.
    map_version: int
    #: The kind of sensor that is found in it: of a robot with another one, tell where it starts.
    found_by: SensorKind


@dataclass(frozen=True, eq=False, repr=False)
class Region(Value):
    """An axis-aligned part of the map's xy plane, metres."""

    #: Map frame.
    min_x_m: float
    #: Map frame.
    min_y_m: float
    #: Map frame.
    max_x_m: float
    #: Map frame.
    max_y_m: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GridGeometry(Value):
    """Where a grid lies: row-major, x -> column, y -> row, row 0 has the smallest y."""

    #: Edge of a cell, metres.
    resolution_m: float
    #: Lower-left corner of cell (0, 0), metres, map frame, (2,).
    origin: Floats
    #: Columns.
    width: int
    #: Rows.
    height: int


def cell_centres(shape: tuple[int, ...], origin: Floats, resolution_m: float) -> dict[str, Floats]:
    """Coordinates of the cells of a grid along y and x, metres."""
    (x, y), (height, width) = origin, shape
    return {
        "y": y + (np.arange(height) + 0.5) * resolution_m,
        "x": x + (np.arange(width) + 0.5) * resolution_m,
    }


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OccupancyGrid(Value):
    """Occupancy: -1 unknown, 0 to 100 percent."""

    #: (height, width) int8.
    cells: npt.NDArray[np.int8]
    #: Edge of a cell, metres.
    resolution_m: float
    #: Lower-left corner of cell (0, 0), metres, map frame, (2,).
    origin: Floats
    stamp: MapStamp

    def to_xarray(self) -> Any:  # noqa: ANN401
        """An xarray.DataArray of the cells over y and x, the coordinates of their centres, metres, map frame.
        ImportError without xarray."""
        xarray = needed("xarray", "to_xarray()", "xarray")
        attributes = {
            "frame_id": self.stamp.frame_id,
            "map_version": self.stamp.map_version,
            "resolution_m": self.resolution_m,
            "values": "-1 unknown, 0 to 100 percent occupied",
        }
        coords = cell_centres(self.cells.shape, self.origin, self.resolution_m)
        return xarray.DataArray(self.cells, coords, ("y", "x"), name="occupancy", attrs=attributes)

    def to_pil(self) -> Any:  # noqa: ANN401
        """A grey PIL.Image with a pixel a cell, y up: white free, black occupied, 205 unknown, as nav2's maps
        have it. ImportError without Pillow."""
        image = needed("PIL.Image", "to_pil()", "pillow")
        shades = np.where(self.cells < 0, 205, 255 - np.round(self.cells * 2.55)).astype(np.uint8)
        return image.fromarray(np.ascontiguousarray(shades[::-1]))

    def _repr_png_(self) -> bytes | None:
        return png(lambda plot: plot.occupancy(self))

    def cell_at(self, x_m: float, y_m: float) -> int | None:
        """Occupancy at a point of the map; None outside the grid."""
        column, row = np.floor((np.array([x_m, y_m]) - self.origin) / self.resolution_m).astype(int)
        height, width = self.cells.shape
        return int(self.cells[row, column]) if 0 <= row < height and 0 <= column < width else None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapCloud(Value):
    """The fused cloud, map frame."""

    #: Map frame, metres.
    cloud: PointCloud
    stamp: MapStamp
    #: Edge of the voxels that its points are means of, metres; None of a cloud that was downloaded.
    voxel_size_m: float | None = None

    def _repr_png_(self) -> bytes | None:
        return png(lambda plot: plot.cloud(self))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapMemory(Value):
    """What a session takes in memory, bytes, by part, about."""

    #: What keyframes saw.
    scans_bytes: int
    #: Layers of submaps.
    submaps_bytes: int
    #: Tiles of the whole map, composed of these.
    composed_bytes: int
    #: What places are known by, to find loops and a lost robot.
    places_bytes: int
    #: Keyframes, what ties them, and the trajectory.
    graph_bytes: int
    #: The local model that frames are placed in.
    odometry_bytes: int
    #: The newest frames, which are compared with the map and laid over it for paths.
    live_bytes: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapSummary(Value):
    """Sizes of a map."""

    stamp: MapStamp
    #: None while nothing was mapped.
    occupancy: GridGeometry | None
    #: Points of the fused cloud.
    num_points: int
    #: Of the fused cloud, metres.
    voxel_size_m: float
    #: Keyframes that the map is made of.
    num_keyframes: int
    #: What the session takes in memory; limits.max_session_memory_mb of the server bounds it.
    memory: MapMemory
    #: Submaps (robot/run/number) that were out of memory and could not be read again: what they hold is
    #: missing from what is composed, until the session sleeps and wakes.
    missing_submaps: tuple[str, ...]


class MapFormat(Name):
    """Files that a map can be read as."""

    OCCUPANCY_PNG = "occupancy_png"
    NAV2_PGM = "nav2_pgm"
    NAV2_YAML = "nav2_yaml"
    CLOUD_PLY = "cloud_ply"
    CLOUD_PCD = "cloud_pcd"
    #: The same, LAS 1.4.
    CLOUD_LAS = "cloud_las"
    #: The same, LAZ.
    CLOUD_LAZ = "cloud_laz"
    #: The same as points of a binary glTF 2.0, y up.
    CLOUD_GLB = "cloud_glb"
    #: Voxels as OctoMap's binary octree: free or occupied.
    VOXELS_BT = "voxels_bt"
    #: Voxels as OctoMap's octree with log-odds.
    VOXELS_OT = "voxels_ot"
    #: Occupancy as GeoTIFF in local coordinates: 0 to 100 percent, 255 unknown.
    OCCUPANCY_TIFF = "occupancy_tiff"
    #: World file that says where OCCUPANCY_PNG lies.
    OCCUPANCY_PGW = "occupancy_pgw"
    #: Surface as a coloured mesh, binary little-endian PLY.
    MESH_PLY = "mesh_ply"
    #: The same, binary glTF 2.0, y up.
    MESH_GLB = "mesh_glb"
    CLOUD_DRACO = "cloud_draco"
    MESH_DRACO = "mesh_draco"
    #: Picture of the cloud from aside and above, PNG; what is higher than 2.2 m is cut away.
    CLOUD_VIEW_PNG = "cloud_view_png"
    #: The same of the surface.
    MESH_VIEW_PNG = "mesh_view_png"
    #: The same of the occupied voxels.
    VOXELS_VIEW_PNG = "voxels_view_png"
    #: Picture of the ground's heights, with contour lines.
    HEIGHTS_PNG = "heights_png"
    #: Picture of where a robot can drive.
    TRAVERSABILITY_PNG = "traversability_png"
    #: Picture of all layers that the session has, side by side.
    LAYERS_PNG = "layers_png"
    TRAJECTORY_TUM = "trajectory_tum"
    OVERVIEW_PNG = "overview_png"
    CLOUD_TOP_PNG = "cloud_top_png"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapFile(Value):
    """The map as a file; its checksum was compared."""

    #: The file's bytes.
    data: bytes
    #: A name for it.
    file_name: str
    #: As HTTP has it, e.g. image/png.
    media_type: str
    #: Lower-case hex.
    sha256: str = field(repr=False)
    stamp: MapStamp
    #: Where it was written, if asked for.
    path: Path | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapComparison(Value):
    """What appeared in a map since an older one, and what has gone; shows itself in a notebook."""

    #: The picture: green has appeared, red has gone, sky blue was unknown before and is occupied.
    png: bytes
    #: Cells that were free and are occupied.
    num_appeared: int
    #: Cells that were occupied and are free.
    num_gone: int
    #: Cells that were unknown and are occupied: they may have been all the time.
    num_newly_seen: int
    #: Area of such a cell, of the finer map, m^2.
    cell_area_m2: float
    #: State of the newer map.
    stamp: MapStamp

    def to_pil(self) -> Any:  # noqa: ANN401
        """The picture as a PIL.Image. ImportError without Pillow."""
        return to_pil(self.png)

    def _repr_png_(self) -> bytes:
        return self.png

"""Navigation: paths, or why there is none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .._optional import needed
from ._show import png, to_pil
from ._value import Name, Value
from .geometry import Floats, Pose
from .layers import Storey
from .maps import GridGeometry, MapStamp, OccupancyGrid
from .poses import FrameResult, PoseEstimate
from .scene import Door, Object


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GridMap(Value):
    """A map that comes with a question."""

    #: (H, W) int8, row 0 at the smallest y: -1 unknown, 0 to 100 percent occupied.
    cells: npt.NDArray[np.int8]
    #: Edge of a cell, metres.
    resolution_m: float
    #: Lower-left corner of cell (0, 0), metres.
    origin: Sequence[float] = (0.0, 0.0)


class Planner(Name):
    """How a path is searched."""

    #: GRID.
    UNSPECIFIED = "unspecified"
    #: A* over cells, shortened and smoothed: for a robot that turns on the spot.
    GRID = "grid"
    #: Lazy Theta*: legs at any angle, where they cost less.
    ANY_ANGLE = "any_angle"
    #: Hybrid A*: for a robot that steers, and for a footprint that only fits in some headings.
    HYBRID = "hybrid"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Zone(Value):
    """An area of the map: keep-out, or one in which the robot drives no faster than a share of its speed."""

    #: Corners in order, map frame, metres, (N, 2), at least 3.
    polygon: Sequence[Sequence[float]]
    #: Above 0 and at most 1; None: no part of the robot may enter.
    speed_share: float | None = None
    #: For people, of zones that are stored with a session.
    name: str = ""


class SpeedUnit(Name):
    """How a limit of speed is given."""

    #: PERCENT.
    UNSPECIFIED = "unspecified"
    #: Of the max_speed_mps of the path's options.
    PERCENT = "percent"
    METRES_PER_SECOND = "metres_per_second"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SpeedMask(Value):
    """What the values of a mask of speeds mean, as nav2's CostmapFilterInfo has it: the limit is
    base + multiplier * value. The value 0, unknown, what comes to 0 or less, and to 100 percent or more: no
    limit."""

    #: In the unit.
    base: float = 0.0
    #: In the unit, for each step of the value.
    multiplier: float = 1.0
    unit: SpeedUnit | str = SpeedUnit.PERCENT


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ZoneMask(Value):
    """Zones of a session cell by cell: the mask of a nav2 costmap filter."""

    #: By which it is known: 1 to 64 characters, no two of a session alike.
    name: str
    #: Cells, or the yaml file of a nav2 map; of speeds one whose mode is scale or raw. None: those that are
    #: stored under the name stay; the server does not tell them.
    cells: GridMap | OccupancyGrid | str | os.PathLike[str] | None = None
    #: None: no part of the robot may enter occupied cells; without cells: what is stored under the name.
    speed: SpeedMask | None = None
    #: Where its cells lie, as the server tells it.
    geometry: GridGeometry | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SpeedLimits(Value):
    """How fast a robot may drive."""

    max_speed_mps: float = 0.5
    max_accel_mps2: float = 1.0
    max_turn_rate_radps: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Steering(Value):
    """How a robot steers; None is the server's default."""

    #: Least radius that the base drives, metres.
    turning_radius_m: float | None = None
    #: Whether it may drive backwards.
    allow_reverse: bool | None = None
    #: Cost of a metre backwards in metres forwards.
    reverse_cost: float | None = None
    #: Cost of a change between forwards and backwards, metres.
    direction_change_cost_m: float | None = None
    #: Cost of a metre on the tightest arc in metres straight.
    turning_cost: float | None = None
    #: By how much of the least cost the search may stop above it, before shortcuts.
    tolerance: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StoreyOptions(Value):
    """The ground that is driven on where there are several above each other; a path knows no other."""

    #: The lowest, the highest, or that whose ground is nearest to near_z_m.
    storey: Storey | str = Storey.LOWEST
    #: Metres, map frame; nearest only.
    near_z_m: float = 0.0
    #: Ground farther from near_z_m than this is of another storey, metres; nearest only.
    near_within_m: float = 1.5


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PathOptions(Value):
    """What is asked of a path beside its ends."""

    planner: Planner | str = Planner.GRID
    #: Heading to begin with, radians; None: the robot's where the path starts where it is, else 0.
    #: HYBRID only.
    start_yaw_rad: float | None = None
    #: Heading to end with, radians; None: any. HYBRID only.
    goal_yaw_rad: float | None = None
    #: Corners of what the robot covers, in base, metres, (N, 2); empty: a disc of robot_radius_m.
    footprint: Sequence[Sequence[float]] = ()
    zones: Sequence[Zone] = ()
    #: For times along the path.
    speed: SpeedLimits | None = None
    #: For HYBRID.
    steering: Steering | None = None
    #: GRID and HYBRID end with the best path so far after so many milliseconds (Path.is_final, Path.bound);
    #: 0: when it is done.
    deadline_ms: int = 0
    #: True: the zones that are stored with the session do not count.
    ignore_session_zones: bool = False
    #: True: the map alone counts. Else what the newest frames see counts as well, which no keyframe shows
    #: yet: who stands in the way is an obstacle, and what has gone is none (params live of the session).
    map_only: bool = False
    #: None: through the occupancy grid, which has one floor. Else over the ground of a storey, by its
    #: traversability, which the session's heights tell. Of a session's map only.
    storey: StoreyOptions | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Path(Value):
    """A path that keeps the robot clear. True where NoPath is False."""

    #: Base from start to goal, map frame: x, y in metres, (N, 2) float64.
    waypoints: Floats
    #: Heading at each, radians from the map's x axis towards y, (N,).
    yaws_rad: Floats
    #: Metres.
    length_m: float
    #: What the search kept small, metres: length, and more near obstacles, in speed zones, for turning.
    cost: float
    #: Smallest distance to an obstacle, metres.
    min_clearance_m: float
    #: Of each waypoint to the nearest obstacle, metres; infinite if there is none, (N,).
    clearances_m: Floats
    #: When each waypoint is reached, seconds after the first, (N,).
    times_s: Floats
    #: Whether the robot drives backwards to the next waypoint, (N,).
    is_reverse: npt.NDArray[np.bool_]
    #: Of the cost: what is near obstacles and in speed zones.
    clearance_cost: float
    #: Of the cost: turning, driving backwards, changing direction.
    steering_cost: float
    #: From rest to rest, seconds.
    duration_s: float
    #: HYBRID: the cost before shortcuts is at most so many times the least one that was left possible. GRID
    #: with a deadline: the cost over cells, before smoothing, is at most so many times the least. Else None.
    bound: float | None
    #: False: the search was ended before it was done, with this as the best so far.
    is_final: bool
    #: State of the map that was searched; None of a map that came with the question.
    stamp: MapStamp | None

    @property
    def poses(self) -> list[Pose]:
        """t_map_base at each waypoint."""
        rows = np.column_stack([self.waypoints, self.yaws_rad]).tolist()
        return [Pose.from_xy_yaw(x, y, yaw) for x, y, yaw in rows]

    def to_pandas(self) -> Any:  # noqa: ANN401
        """A pandas.DataFrame with a row a waypoint: x_m, y_m, yaw_rad, clearance_m, time_s, is_reverse.
        ImportError without pandas."""
        pandas = needed("pandas", "to_pandas()", "pandas")
        return pandas.DataFrame(
            {
                "x_m": self.waypoints[:, 0],
                "y_m": self.waypoints[:, 1],
                "yaw_rad": self.yaws_rad,
                "clearance_m": self.clearances_m,
                "time_s": self.times_s,
                "is_reverse": self.is_reverse,
            }
        )

    def _repr_png_(self) -> bytes | None:
        return png(lambda plot: plot.path(self))

    def __bool__(self) -> bool:
        return True


class NoPathReason(Name):
    """Why there is no path."""

    UNSPECIFIED = "unspecified"
    START_OUTSIDE_MAP = "start_outside_map"
    START_OCCUPIED = "start_occupied"
    START_UNKNOWN = "start_unknown"
    GOAL_OUTSIDE_MAP = "goal_outside_map"
    GOAL_OCCUPIED = "goal_occupied"
    GOAL_UNKNOWN = "goal_unknown"
    UNREACHABLE = "unreachable"
    SEARCH_LIMIT = "search_limit"
    #: No start was given, and the robot's place is not known: it is lost (`session.pose()` says why), or no
    #: frame has come yet.
    LOST = "lost"
    #: No start was given, and a camera alone moves the robot, whose poses are not in metres
    #: (`scale_message` of the pose says what would tell lengths; no map is built until then).
    SCALE_UNKNOWN = "scale_unknown"
    #: The start is free, and the robot does not fit there.
    START_DOES_NOT_FIT = "start_does_not_fit"
    START_IN_KEEP_OUT = "start_in_keep_out"
    #: The goal is free, and the robot does not fit there.
    GOAL_DOES_NOT_FIT = "goal_does_not_fit"
    GOAL_IN_KEEP_OUT = "goal_in_keep_out"
    #: A way is wide enough, but not for this footprint and turning radius.
    NOT_STEERABLE = "not_steerable"
    #: deadline_ms was over before there was a path.
    DEADLINE = "deadline"


class BlockingState(Name):
    """What blocks a cell."""

    UNSPECIFIED = "unspecified"
    OCCUPIED = "occupied"
    UNKNOWN = "unknown"
    KEEP_OUT = "keep_out"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Blocking(Value):
    """What stands in the way."""

    #: Where the robot does not fit, map frame, metres, (2,).
    position: Floats
    #: Centre of the cell that blocks it, (2,).
    obstacle: Floats
    #: What is there.
    state: BlockingState
    #: The object that stands there, if one is known.
    object_id: int | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NoPath(Value):
    """No path, and why: an answer, not an error."""

    #: For programs.
    reason: NoPathReason
    #: The reason in words.
    detail: str
    #: Of an end where the robot does not fit: what is too near. Of "unreachable": the first place that
    #: blocks the way which crosses least of such places.
    blocking: Blocking | None
    #: State of the map that was searched; None of a map that came with the question.
    stamp: MapStamp | None

    def __bool__(self) -> bool:
        return False


class MisfitReason(Name):
    """Why a place of a path does not fit."""

    UNSPECIFIED = "unspecified"
    OUTSIDE_MAP = "outside_map"
    #: The footprint overlaps something.
    BLOCKED = "blocked"
    #: No arc as wide as the turning radius leads to the next pose; HYBRID only.
    NOT_STEERABLE = "not_steerable"
    #: The next pose is behind, and driving backwards is not allowed; HYBRID only.
    BACKWARDS = "backwards"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Misfit(Value):
    """The first place of a path that the robot cannot drive."""

    #: Number of the pose that does not fit, or of the one before the motion that does not.
    pose_index: int
    #: t_map_base of the robot there.
    pose: Pose
    reason: MisfitReason
    #: Of "blocked".
    blocking: Blocking | None


class PathColouring(Name):
    """What the colours along a path that is drawn mean."""

    #: CLEARANCE.
    UNSPECIFIED = "unspecified"
    #: From the base to the nearest obstacle, metres.
    CLEARANCE = "clearance"
    #: What a metre costs there in metres of free way: 1, or more near obstacles and in speed zones.
    COST = "cost"
    #: How fast the robot is there, metres a second.
    SPEED = "speed"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PathPicture(Value):
    """A path as a picture for people; shows itself in a notebook."""

    #: The file.
    png: bytes
    #: What is drawn; None: a path that was given.
    outcome: Path | NoPath | None
    #: Of a path that was given: its first place that cannot be driven.
    misfit: Misfit | None
    #: State of the map that is drawn; None: a map that came with the question.
    stamp: MapStamp | None

    def to_pil(self) -> Any:  # noqa: ANN401
        """The picture as a PIL.Image. ImportError without Pillow."""
        return to_pil(self.png)

    def _repr_png_(self) -> bytes:
        return self.png


class PathChange(Name):
    """Why a watched path is told."""

    UNSPECIFIED = "unspecified"
    #: It is the first answer.
    FIRST = "first"
    #: What was told before cannot be driven any more.
    BLOCKED = "blocked"
    #: Another way costs clearly less, by a fifth, than what is left of the path that was told.
    BETTER = "better"
    #: There was no path, and there is one now.
    OPENED = "opened"
    #: There is still none, for another reason.
    OTHER_REASON = "other_reason"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PathUpdate(Value):
    """What is told of a watched path."""

    change: PathChange
    outcome: Path | NoPath
    #: Of "blocked": where the path that was told before does not fit.
    misfit: Misfit | None
    #: State of the map that was searched.
    stamp: MapStamp


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Navigation(Value):
    """The answer to one step: a frame and a goal in, pose, obstacles and path out."""

    frame: FrameResult
    #: None before the first registered frame.
    pose: PoseEstimate | None
    #: Objects within 5 m that are not gone.
    obstacles: tuple[Object, ...]
    outcome: Path | NoPath
    stamp: MapStamp


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RouteStep(Value):
    """A room on the way."""

    room_id: int
    #: Its name, else what it is likely used for, or its kind, and its number.
    label: str
    #: To the next room; none in the last one.
    door: Door | None

    def __str__(self) -> str:
        return self.label


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RoomRoute(Value):
    """The way to a room: from door to door, and the path along the ground."""

    #: Rooms from the start to the one asked for; empty if no place in it can be reached.
    steps: tuple[RouteStep, ...]
    #: Over places, metres.
    length_m: float
    #: In the room, map frame, metres, (2,).
    goal: Floats
    #: Along the ground to there, or why there is none.
    outcome: Path | NoPath

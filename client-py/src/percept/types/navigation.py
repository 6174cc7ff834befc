"""Navigation: paths, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value
from .geometry import Floats
from .maps import MapStamp
from .scene import Object
from .sessions import FrameResult, PoseEstimate


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Path(Value):
    """A path that keeps the robot's radius clear. True where NoPath is False."""

    #: From start to goal, map frame: x m, y m, yaw rad, (N, 3) float64.
    waypoints: Floats
    length_m: float
    #: Length weighted by the cost of being close to obstacles, metres.
    cost: float
    #: Smallest distance to an obstacle, metres.
    min_clearance_m: float
    #: State of the map that was searched.
    stamp: MapStamp

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
    LOST = "lost"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NoPath(Value):
    """No path, and why: an answer, not an error."""

    reason: NoPathReason
    detail: str
    #: State of the map that was searched.
    stamp: MapStamp

    def __bool__(self) -> bool:
        return False


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

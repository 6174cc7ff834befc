"""Paths that cover, frontiers, paths in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .geometry import Floats
from .maps import MapStamp
from .navigation import BlockingState, NoPathReason, Path, Zone


class CoverageDirection(Name):
    """Which way lanes lie."""

    #: The one of the two below that gives the shorter path.
    UNSPECIFIED = "unspecified"
    ALONG_X = "along_x"
    ALONG_Y = "along_y"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CoverageOptions(Value):
    """How to cover."""

    #: The tool covers a disc of this width around the base, metres.
    tool_width_m: float = 0.4
    #: Share of the tool's width by which neighbouring lanes overlap at least, 0 to 0.9.
    overlap: float = 0.1
    #: Share of what can be covered at which it is enough.
    enough: float = 0.99
    direction: CoverageDirection | str = CoverageDirection.UNSPECIFIED


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CoveragePath(Value):
    """A path that passes a tool over all that the robot reaches. True where NoPath is False."""

    path: Path
    #: Indices of the waypoints at which its stretches begin, (N,).
    leg_starts: npt.NDArray[np.int64]
    #: Whether a stretch only leads to the next lane, (N,).
    is_transit: npt.NDArray[np.bool_]
    #: Area that can be covered, m^2.
    coverable_m2: float
    #: Share of that which the path covers.
    covered_share: float
    num_regions: int

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Frontier(Value):
    """A stretch of free cells beside unknown ones."""

    #: Where to go to look at it, map frame, metres, (2,).
    goal: Floats
    #: Cost of the way there, metres, weighted by clearance.
    cost: float
    #: Of the stretch, metres.
    length_m: float
    #: Centres of its cells, at most 1000 of them, (N, 2).
    cells: Floats


class FlightPlanner(Name):
    """How a path in space is searched."""

    #: ANY_ANGLE.
    UNSPECIFIED = "unspecified"
    #: Lazy Theta*: legs at any angle.
    ANY_ANGLE = "any_angle"
    #: A* from voxel to voxel, 26 neighbours.
    LATTICE = "lattice"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FlightOptions(Value):
    """What is asked of a path in space."""

    #: The robot is a ball of this radius, metres.
    robot_radius_m: float = 0.3
    planner: FlightPlanner | str = FlightPlanner.UNSPECIFIED
    #: Voxels at or above this probability are obstacles.
    occupied_probability: float = 0.5
    #: Whether unknown voxels are free.
    allow_unknown: bool = False
    #: Around the start unknown voxels are free, and a robot on the ground may leave it, metres.
    start_tolerance_m: float = 0.5
    #: The ball's centre keeps at or above this height, map frame, metres.
    min_z_m: float | None = None
    #: And at or below this one.
    max_z_m: float | None = None
    #: The search ends with the best path so far after so many milliseconds; 0: when it is done.
    deadline_ms: int = 0
    #: Besides those of the session: no part of the ball enters one that is keep-out, at any height.
    zones: Sequence[Zone] = ()
    #: True: the zones that are stored with the session do not count.
    ignore_session_zones: bool = False


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FlightPath(Value):
    """A path in space along which a ball touches nothing. True where NoFlight is False."""

    #: From start to goal, straight in between, map frame, metres, (N, 3).
    waypoints: Floats
    #: Metres.
    length_m: float
    #: Smallest distance to an obstacle's voxel, metres; None if it is more than the radius and two voxels.
    min_clearance_m: float | None
    #: The length from voxel to voxel, before corners are left out, is at most so many times the least;
    #: 1 if the search was done.
    bound: float
    #: False: the search was ended before it was done, with this as the best so far.
    is_final: bool
    #: State of the map that was searched.
    stamp: MapStamp

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NoFlight(Value):
    """No path in space, and why: an answer, not an error."""

    #: As of paths on the ground.
    reason: NoPathReason
    #: The same in words.
    detail: str
    #: Of an end where the ball does not fit: where, map frame, metres, (3,).
    position: Floats | None
    #: Centre of the nearest voxel that blocks it, (3,).
    obstacle: Floats | None
    #: What blocks it: occupied, unknown or keep-out.
    state: BlockingState
    stamp: MapStamp

    def __bool__(self) -> bool:
        return False

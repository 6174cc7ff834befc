# Written by client-py/generate from _async/toolbox/planning.py; change that.
"""Paths through maps that come with the question."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..._convert import drawing
from ..._convert.toolbox import planning as convert
from ..._convert.toolbox.planning import Map
from ...types.geometry import FloorPoint, Pose
from ...types.navigation import Misfit, NoPath, Path, PathColouring, PathOptions, PathPicture
from ..bound import Bound


class Planning(Bound):
    """A map is a GridMap, the grid of a session, or the path of a nav2 map's yaml file."""

    def plan_on_map(
        self,
        given: Map,
        start: FloorPoint,
        goal: FloorPoint,
        *,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Path | NoPath:
        """A path from (x, y) to (x, y), metres, frame of the map, or from pose to pose, whose headings the
        HYBRID planner keeps to; no session is needed."""
        return self._transport.call(convert.plan_on_map(given, start, goal, params, options))

    def validate_on_map(
        self,
        given: Map,
        path: Path | Sequence[Pose],
        *,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Misfit | None:
        """The first place of a path, or of poses, that the robot cannot drive; None if all fits."""
        return self._transport.call(convert.validate_on_map(given, path, params, options))

    def draw_path_on_map(
        self,
        given: Map,
        start: FloorPoint | None = None,
        goal: FloorPoint | None = None,
        *,
        path: Path | Sequence[Pose] | None = None,
        colouring: PathColouring | str = PathColouring.CLEARANCE,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> PathPicture:
        """plan_on_map() as a picture, or a path (or poses) as it is, with the first place of it that the
        robot cannot drive."""
        call = drawing.draw_path_on_map(given, start, goal, path, colouring, params, options)
        return self._transport.call(call)

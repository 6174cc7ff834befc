"""Sessions: one robot each, mapping."""

from __future__ import annotations

import operator
from collections.abc import Awaitable, Mapping, Sequence
from typing import Any

from .. import plot as picture
from .._arrays import Array
from .._convert import drawing, exploration, geometry, navigation, sensors, sessions
from .._sender import FrameSender
from ..errors import AlreadyExists, WrongType
from ..types.exploration import (
    CoverageOptions,
    CoveragePath,
    FlightOptions,
    FlightPath,
    Frontier,
    NoFlight,
)
from ..types.frames import SensorFrame
from ..types.geometry import FloorPoint, Pose
from ..types.navigation import (
    Misfit,
    Navigation,
    NoPath,
    NoPathReason,
    Path,
    PathColouring,
    PathOptions,
    PathPicture,
    Zone,
    ZoneMask,
)
from ..types.poses import FrameResult, PoseAt, PoseEstimate, Transform
from ..types.scene import Object
from ..types.sensors import SensorSpec
from ..types.sessions import FleetEventKind, Keyframe, SessionInfo, SessionMode, SessionState, Trajectory
from .bound import AsyncBound, AsyncSessionBound
from .layers import AsyncSpace
from .maps import AsyncMaps
from .pages import AsyncPages
from .recordings import AsyncRecordings
from .scene import AsyncScene
from .sensors import AsyncSensors
from .stream import AsyncFrameStream
from .transport import AsyncTransport
from .watch import AsyncFleetWatch, AsyncPathWatch, AsyncWatch

_COVERAGE = CoverageOptions()
_FLIGHT = FlightOptions()


class AsyncSession(AsyncSessionBound, FrameSender[Awaitable[FrameResult]]):
    """A session of a server. `send_*` sends one frame and waits until it was processed and is durable;
    `stream()` sends many without waiting for each."""

    def __init__(self, transport: AsyncTransport, session_id: str) -> None:
        # Where it is, is a matter of its own.
        super().__init__(transport.following(), session_id)

    def __repr__(self) -> str:
        return f"AsyncSession({self.session_id!r})"

    @property
    def sensors(self) -> AsyncSensors:
        """Its sensors."""
        return AsyncSensors(self._transport, self.session_id)

    @property
    def map(self) -> AsyncMaps:
        """Its live map."""
        return AsyncMaps(self._transport, self.session_id)

    @property
    def space(self) -> AsyncSpace:
        """The space that the map is of: points, rays, boxes, voxels."""
        return AsyncSpace(self._transport, self.session_id)

    @property
    def scene(self) -> AsyncScene:
        """Its objects and their relations."""
        return AsyncScene(self._transport, self.session_id)

    @property
    def recordings(self) -> AsyncRecordings:
        """Its recordings on the server."""
        return AsyncRecordings(self._transport, self.session_id)

    async def info(self) -> SessionInfo:
        """The session as it is now."""
        return await self._transport.call(sessions.get(self.session_id))

    async def update(
        self,
        *,
        display_name: str | None = None,
        labels: Mapping[str, str] | None = None,
        params: Mapping[str, object] | None = None,
        zones: Sequence[Zone] | None = None,
        zone_masks: Sequence[ZoneMask] | None = None,
        etag: str = "",
    ) -> SessionInfo:
        """Changes what is given, in force and durable when it returns: all labels, all zones and all
        zone masks (which every path through the session's map keeps to from then on), and of the parameters
        those that are named, nested as default_params(); None puts one back to its default. What is fixed
        with the creation is refused (FIELD_IMMUTABLE). With an `etag` (of `info()`), raises Aborted if the
        session was changed since."""
        call = sessions.update(self.session_id, display_name, labels, params, zones, zone_masks, etag)
        return await self._transport.call(call)

    async def delete(self) -> None:
        """Deletes the session with its map and everything stored for it. It cannot be undone."""
        await self._transport.call(sessions.delete(self.session_id))

    async def send(self, frame: SensorFrame) -> FrameResult:
        """Sends a frame; raises if it is refused."""
        return await self._transport.call(sensors.send(self.session_id, frame))

    def stream(
        self,
        *,
        max_in_flight: int = 16,
        resume: bool = True,
        resume_timeout_s: float = 60.0,
        resume_buffer_bytes: int = 64 << 20,
    ) -> AsyncFrameStream:
        """Opens a stream of frames, at most `max_in_flight` ahead of their acknowledgements.

        When the link breaks or the server restarts, the stream goes on by itself: it keeps frames until they
        are durable, and sends those again. Up to `resume_buffer_bytes` are kept, also of what is sent while
        the server is away; then `send` waits. It gives up with StreamBroken once nothing has moved for
        `resume_timeout_s`. With `resume=False` it ends with what broke it, and keeps nothing.

        Use it in a `with` block, or close() it: a program that ends without may lose what it sent last, up to
        `max_in_flight` frames. So does a block that ends by an exception, or Ctrl-C: it does not wait."""
        return AsyncFrameStream(
            self._transport,
            self.session_id,
            max_in_flight=max_in_flight,
            resume=resume,
            resume_timeout_s=resume_timeout_s,
            buffer_bytes=resume_buffer_bytes,
        )

    def watch(
        self,
        *,
        kinds: Sequence[FleetEventKind | str] = (),
        label: str = "",
        text: str = "",
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        resume_token: int | None = None,
        resume_timeout_s: float = 60.0,
    ) -> AsyncWatch:
        """Events from now on, or after a token; 0 stands before the first that the server still has.

        kinds: only of these ("object", "loop", ...). label, text, low and high: of objects only those of
        this class, whose label holds this text, whose middle lies in this box (x, y, z, metres, map frame),
        and what becomes of them from then on; events of other kinds come all the same, unless `kinds` leaves
        them out.

        When the link breaks or the server restarts, the watch goes on by itself, and raises what it meets
        once it could not for `resume_timeout_s`."""
        request = sessions.watch(self.session_id, kinds, label, text, low, high)
        return AsyncWatch(self._transport, request, resume_token, resume_timeout_s)

    async def pose(self) -> PoseEstimate | None:
        """Newest pose, None before the first frame. Lost is an answer."""
        return await self._transport.call(sessions.pose(self.session_id))

    async def pose_at(self, at_ns: int) -> PoseAt:
        """Where the robot was at a time, by the session's clock: between the two frames around it. Outside
        of the trajectory it raises InvalidArgument (before) or FailedPrecondition (after) with the range."""
        return await self._transport.call(sessions.pose_at(self.session_id, at_ns))

    async def set_pose(self, t_map_base: Pose | Array) -> PoseEstimate:
        """Says where the robot is, a pose or its (4, 4) matrix, base to map, as RViz' "2D Pose Estimate"
        does: of one that was not found, or in a wrong place. It answers with the next frame that moves the
        pose: where the robot is by what it sees within a metre and half a radian of it, tentatively, until
        views from elsewhere agree. Where nobody has mapped the pose is believed.

        Raises FailedPrecondition, and nothing is changed: POSE_REFUTED if what it sees does not fit there,
        ROBOT_SILENT if no frame comes within five seconds, MAP_EMPTY without a map, POSE_NOT_COMPARABLE for
        a camera alone."""
        return await self._transport.call(sessions.set_pose(self.session_id, t_map_base))

    async def transform(self, target: str, source: str, *, at_ns: int | None = None) -> Transform:
        """Where `source` is, seen from `target`, now or at a time: map, odom, base, or a sensor's id
        (sensors/<id> for one of such a name)."""
        return await self._transport.call(sessions.transform(self.session_id, target, source, at_ns))

    async def trajectory(
        self,
        *,
        from_ns: int | None = None,
        to_ns: int | None = None,
        max_poses: int = 0,
        page_size: int = 0,
        page_token: str = "",
    ) -> Trajectory:
        """The trajectory so far, corrected, or its frames between two times, both included. `max_poses` thins
        them evenly, `page_size` gives some at a time: the next page starts at `next_page_token`."""
        call = sessions.get_trajectory(self.session_id, from_ns, to_ns, max_poses, page_size, page_token)
        return await self._transport.chunks(call)

    async def plot(self, *, axes: Any = None) -> Any:  # noqa: ANN401
        """Its map from above with the trajectory and the things in it, as matplotlib axes; with `axes` drawn
        over what is there. `percept.plot` has each by itself. Needs `pip install 'percept[plot]'`.

            session.plot().figure.savefig("map.png")
        """
        grid, way = await self.map.occupancy(), await self.trajectory()
        things = await self.scene.objects().all()
        return picture.session(self.session_id, grid, way, things, axes=axes)

    def keyframes(self, *, page_size: int = 0) -> AsyncPages[Keyframe]:
        """Keyframes by number; pages are asked for as they are used."""
        return self._transport.pages(sessions.keyframes(self.session_id, page_size))

    async def plan(
        self,
        goal: FloorPoint,
        *,
        start: FloorPoint | None = None,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Path | NoPath:
        """A path to (x, y) in metres of the map, from where the robot is or from `start`. Options say by
        which planner, with which footprint and headings, around which zones. Ends may be poses: the HYBRID
        planner keeps to their headings, unless the options name others. No path is an answer, with its
        reason; three bare numbers are refused (WrongType), for x, y, z and x, y, yaw look alike."""
        return await self._transport.call(navigation.plan(self.session_id, goal, start, params, options))

    async def plan_to(
        self,
        thing: Object | int,
        *,
        gap_m: float = 0.5,
        start: FloorPoint | None = None,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Path | NoPath:
        """A path to beside an object, or to the one of this number: base stops gap_m (metres) from its box,
        or up to twice that where it does not fit there, and looks at it (HYBRID planner). Of the places
        around it the first is taken that can be reached, nearest to the robot first; if none can, the answer
        is why not the nearest. Raises NotFound if there is no such object."""
        if not (isinstance(thing, Object) or hasattr(thing, "__index__")):
            message = f"thing is {thing!r}; give an object, or its number"
            raise WrongType(message, reason="THING_INVALID", field="thing")
        target = thing if isinstance(thing, Object) else await self.scene.object(operator.index(thing))
        pose = await self.pose() if start is None else None
        here = start if pose is None else pose.t_map_base
        nearest: NoPath | None = None
        for place in navigation.places_beside(target.box, gap_m, here):
            found = await self.plan(place, start=start, params=params, options=options)
            if isinstance(found, Path):
                return found
            nearest = nearest or found
            # It is not for the goal that there is none.
            if found.reason == NoPathReason.LOST or str(found.reason).startswith("start_"):
                return found
        assert nearest is not None
        return nearest

    async def draw_path(
        self,
        goal: FloorPoint | None = None,
        *,
        path: Path | Sequence[Pose] | None = None,
        start: FloorPoint | None = None,
        colouring: PathColouring | str = PathColouring.CLEARANCE,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> PathPicture:
        """plan() as a picture: the map with the path coloured along it, footprints, zones, legend and scale
        bar, or with why there is none and the first cell that blocks the way. With `path` (or poses of base
        in the map) that is drawn as it is, with the first place of it that the robot cannot drive."""
        call = drawing.draw_path(self.session_id, goal, path, start, colouring, params, options)
        return await self._transport.call(call)

    def watch_path(
        self,
        goal: FloorPoint,
        *,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
        resume_timeout_s: float = 60.0,
    ) -> AsyncPathWatch:
        """A path from where the robot is, kept: told at once, and again when the map breaks it or a clearly
        better one opens. It goes on by itself as `watch` does."""
        request = navigation.watch_request(self.session_id, goal, params, options)
        return AsyncPathWatch(self._transport, request, resume_timeout_s)

    async def validate_path(
        self,
        path: Path | Sequence[Pose],
        *,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Misfit | None:
        """The first place of a path, or of poses of base in the map, that the robot cannot drive as the map
        is now; None if all of it can be driven."""
        return await self._transport.call(navigation.validate(self.session_id, path, params, options))

    async def plan_coverage(
        self,
        *,
        start: FloorPoint | None = None,
        coverage: CoverageOptions = _COVERAGE,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> CoveragePath | NoPath:
        """A path that passes a tool over all that the robot reaches, from where it is or from `start`."""
        call = exploration.coverage(self.session_id, start, coverage, params, options)
        return await self._transport.call(call)

    async def frontiers(
        self,
        *,
        start: FloorPoint | None = None,
        min_length_m: float = 0.5,
        gain: float = 0.0,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> list[Frontier]:
        """Edges of what is known that the robot reaches, what is worth most first: the nearest, or with a
        gain of 1 to 3 the large ones, of which a metre is worth so many metres of way. None lies in a
        keep-out zone, or beyond one that is in the way. Of the options, footprint, zones and storey count."""
        call = exploration.frontiers(self.session_id, start, min_length_m, gain, params, options)
        return await self._transport.call(call)

    async def plan_flight(
        self,
        goal: Sequence[float],
        *,
        start: Sequence[float] | None = None,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        options: FlightOptions = _FLIGHT,
    ) -> FlightPath | NoFlight:
        """A path in space to (x, y, z) in metres of the map, through its voxels, for what flies; `low` and
        `high` are the corners of the part that is searched. It keeps out of the session's zones, at any
        height."""
        region = geometry.box3_to("region", low, high)
        return await self._transport.call(exploration.flight(self.session_id, goal, start, region, options))

    async def navigate(
        self,
        frame: SensorFrame,
        *,
        goal: FloorPoint,
        params: Mapping[str, object] | None = None,
        options: PathOptions | None = None,
    ) -> Navigation:
        """One step in one call: a frame and a goal in; pose, obstacles and path out."""
        call = navigation.navigate(self.session_id, frame, goal, params, options)
        return await self._transport.call(call)


class AsyncSessions(AsyncBound):
    """The sessions of a server."""

    async def create(
        self,
        session_id: str | None = None,
        *,
        display_name: str = "",
        mode: SessionMode | str = SessionMode.MAPPING,
        sensors: Sequence[SensorSpec] = (),
        params: Mapping[str, object] | None = None,
        labels: Mapping[str, str] | None = None,
        request_id: str | None = None,
        exist_ok: bool = False,
    ) -> AsyncSession:
        """Creates a session. The same request_id gives the session of the first call; without one the call
        is unique, yet safely repeated when the server is away. `params` is nested as default_params().

        A name that is taken raises AlreadyExists, or gives that session with exist_ok, for a program that is
        run again: sensors that it has not are declared, one that it has otherwise is refused (SENSOR_IN_USE,
        once it has sent frames), its mode, parameters and labels stay as they are."""
        call = sessions.create(session_id, display_name, mode, sensors, params, labels, request_id)
        try:
            info = await self._transport.call(call)
        except AlreadyExists as error:
            if not exist_ok or session_id is None or error.reason != "SESSION_EXISTS":
                raise
            found = AsyncSession(self._transport, session_id)
            for sensor in sensors:
                await found.sensors.declare(sensor)
            return found
        return AsyncSession(self._transport, info.session_id)

    async def get(self, session_id: str) -> AsyncSession:
        """A session that exists."""
        found = AsyncSession(self._transport, session_id)
        await found.info()
        return found

    def list(
        self,
        *,
        state: SessionState | str | None = None,
        pattern: str = "",
        labels: str = "",
        order_by: str = "",
        page_size: int = 0,
    ) -> AsyncPages[SessionInfo]:
        """Sessions, all or those in a state, whose ids fit a pattern (robot-*), with labels ("site=north",
        or "site" for any value; several with commas). By id, or "create_time_ns" or "last_used_ns", " desc"
        for the last ones first. Pages are asked for as they are used, `.all()` gives a list of all. None is
        woken by it."""
        return self._transport.pages(sessions.list_sessions(state, pattern, labels, order_by, page_size))

    def watch(
        self,
        pattern: str = "",
        *,
        kinds: Sequence[FleetEventKind | str] = (),
        resume_token: int | None = None,
        resume_timeout_s: float = 60.0,
    ) -> AsyncFleetWatch:
        """Events of all sessions that may be read, or of those whose ids fit a pattern (robot-*), from now
        on or after a token; of all kinds, or some. It goes on by itself as `Session.watch` does."""
        return AsyncFleetWatch(self._transport, pattern, kinds, resume_token, resume_timeout_s)

    async def delete(self, session_id: str) -> None:
        """Deletes a session with its map and everything stored for it. It cannot be undone."""
        await self._transport.call(sessions.delete(session_id))

    async def default_params(self) -> Mapping[str, object]:
        """Every parameter with its default, nested."""
        return await self._transport.call(sessions.default_params())

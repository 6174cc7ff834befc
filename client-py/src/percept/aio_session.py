"""Sessions, for asyncio. The twin of session.py."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Mapping, Sequence

from ._aio_transport import AsyncTransport
from ._convert import navigation, sensors, sessions
from ._sender import FrameSender
from .aio_stream import AsyncFrameStream, AsyncWatch
from .maps import AsyncMaps
from .scene import AsyncScene
from .sensors import AsyncSensors
from .types.frames import SensorFrame
from .types.navigation import Navigation, NoPath, Path
from .types.sensors import SensorSpec
from .types.sessions import FrameResult, Keyframe, PoseEstimate, SessionInfo, SessionMode, Trajectory


class AsyncSession(FrameSender[Awaitable[FrameResult]]):
    """As Session; what asks the server is awaited, lists are `async for`."""

    def __init__(self, transport: AsyncTransport, session_id: str) -> None:
        self._transport = transport
        self.session_id = session_id
        self.sensors = AsyncSensors(transport, session_id)
        self.map = AsyncMaps(transport, session_id)
        self.scene = AsyncScene(transport, session_id)

    def __repr__(self) -> str:
        return f"AsyncSession({self.session_id!r})"

    async def info(self) -> SessionInfo:
        """The session as it is now."""
        return await self._transport.call(sessions.get(self.session_id))

    async def delete(self) -> None:
        """Deletes the session with its map and everything stored for it. It cannot be undone."""
        await self._transport.call(sessions.delete(self.session_id))

    async def send(self, frame: SensorFrame) -> FrameResult:
        """Sends a frame; raises if it is refused."""
        return await self._transport.call(sensors.send(self.session_id, frame))

    def stream(self, *, max_in_flight: int = 16) -> AsyncFrameStream:
        """Opens a stream of frames."""
        return AsyncFrameStream(self._transport, self.session_id, max_in_flight)

    def watch(self, *, resume_token: int | None = None) -> AsyncWatch:
        """Events from now on, or after a token; 0 stands before the first that the server still has."""
        return AsyncWatch(self._transport, self.session_id, resume_token)

    async def pose(self) -> PoseEstimate | None:
        """Newest pose, None before the first frame. Lost is an answer."""
        return await self._transport.call(sessions.pose(self.session_id))

    async def trajectory(self) -> Trajectory:
        """The trajectory so far, corrected."""
        return await self._transport.chunks(sessions.get_trajectory(self.session_id))

    def keyframes(self, *, page_size: int = 0) -> AsyncIterator[Keyframe]:
        """Keyframes by number; pages are asked for as they are used."""
        return self._transport.pages(sessions.keyframes(self.session_id, page_size))

    async def plan(
        self,
        goal: Sequence[float],
        *,
        start: Sequence[float] | None = None,
        params: Mapping[str, object] | None = None,
    ) -> Path | NoPath:
        """A path to (x, y) in metres of the map, from where the robot is or from `start`."""
        return await self._transport.call(navigation.plan(self.session_id, goal, start, params))

    async def navigate(
        self, frame: SensorFrame, *, goal: Sequence[float], params: Mapping[str, object] | None = None
    ) -> Navigation:
        """One step in one call: a frame and a goal in; pose, obstacles and path out."""
        return await self._transport.call(navigation.navigate(self.session_id, frame, goal, params))


class AsyncSessions:
    """The sessions of a server."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport

    async def create(
        self,
        session_id: str | None = None,
        *,
        display_name: str = "",
        mode: SessionMode | str = SessionMode.MAPPING,
        sensors: Sequence[SensorSpec] = (),
        params: Mapping[str, object] | None = None,
        request_id: str | None = None,
    ) -> AsyncSession:
        """Creates a session. The same request_id gives the session of the first call; without one the call
        is unique, yet safely repeated when the server is away. `params` is nested as default_params()."""
        call = sessions.create(session_id, display_name, mode, sensors, params, request_id)
        return AsyncSession(self._transport, (await self._transport.call(call)).session_id)

    async def get(self, session_id: str) -> AsyncSession:
        """A session that exists."""
        return AsyncSession(
            self._transport, (await self._transport.call(sessions.get(session_id))).session_id
        )

    def list(self, *, page_size: int = 0) -> AsyncIterator[SessionInfo]:
        """All sessions by id; pages are asked for as they are used."""
        return self._transport.pages(sessions.list_sessions(page_size))

    async def delete(self, session_id: str) -> None:
        """Deletes a session with its map and everything stored for it. It cannot be undone."""
        await self._transport.call(sessions.delete(session_id))

    async def default_params(self) -> Mapping[str, object]:
        """Every parameter with its default, nested."""
        return await self._transport.call(sessions.default_params())

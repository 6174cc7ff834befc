"""zenoh: publish sensors, read results. Needs the extra: pip install 'percept[zenoh]'.

Scouting is off: the endpoint of the server, or of a router that it is connected to, is named. Keys,
behind the server's `zenoh.namespace`:

    percept/<session>/<sensor>/frame     in: one SensorMessage a sample
    percept/<session>/pose, events       out: PoseEstimate, SessionEvent
    percept/<session>/map/occupancy, map/cloud, scene/graph, scene/objects, scene/rooms,
        sensors, pose                    queries
    percept/<session>/rpc/<service>/<method>
                                         queries: any rpc about a session, its request as the payload
    percept/<session>/alive              liveliness of a session that is awake
    percept/<session>/<sensor>/alive     liveliness of a SensorPublisher, of each of its sensors

The session may be a wildcard in queries and liveliness: all that are awake. Poses travel before all else,
then events, IMUs and wheels; depth, images, clouds and maps come last, so that a thin link carries what
robots steer by.
"""

from __future__ import annotations

import json
import os
import queue
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, TypeVar

from google.protobuf.message import DecodeError, Message

from ._access import FilePath, read_file
from ._convert import maps, poses, scene, sessions
from ._convert import sensors as streams
from ._options import Options
from ._over_zenoh import OverZenoh
from ._rpc import Rpc
from ._sender import FrameSender
from ._sync.session import Session, Sessions
from .errors import DeadlineExceeded, FailedPrecondition, Internal, InvalidArgument, Unavailable, error_of
from .types.frames import ImuFrame, OdometryFrame, ScanFrame, SensorFrame
from .types.maps import MapCloud, OccupancyGrid
from .types.poses import PoseEstimate
from .types.scene import Object, Rooms, SceneGraph
from .types.sensors import SensorSpec, SensorStatus
from .types.sessions import SessionEvent
from .v1 import error_pb2, map_pb2, scene_pb2, scene_service_pb2, sensors_service_pb2, session_pb2

try:
    import zenoh
except ImportError as cause:
    # The package is not called as the module is.
    message = "percept.zenoh needs eclipse-zenoh, which is not installed: pip install 'percept[zenoh]'"
    raise ImportError(message, name="zenoh") from cause

T = TypeVar("T")
M = TypeVar("M", bound=Message)

#: What zenoh itself replies in place of a peer that has the question, and does not answer it in time.
_TIMEOUT = b"Timeout"

#: A server that listens answers questions so soon after, seconds.
ANSWERS_SOON_S = 1.0
#: Results waiting for a slow reader; then the oldest go.
MAX_UNREAD = 256

#: How soon frames travel; images and clouds come last.
_PRIORITIES = {
    ImuFrame: zenoh.Priority.INTERACTIVE_LOW,
    OdometryFrame: zenoh.Priority.INTERACTIVE_LOW,
    ScanFrame: zenoh.Priority.DATA,
}


@dataclass(frozen=True, kw_only=True)
class Credentials:
    """Who asks, and whom to trust. With any of the files the endpoint is tls/host:port."""

    #: Name of a user of zenoh.
    user: str | None = None
    #: That user's.
    password: str | None = field(default=None, repr=False)
    #: PEM: whom to trust instead of the well-known authorities.
    ca_file: FilePath | None = None
    #: PEM: who asks.
    cert_file: FilePath | None = None
    #: PEM: the key of cert_file.
    key_file: FilePath | None = None

    def settings(self, endpoint: str) -> dict[str, object]:
        """What zenoh calls them; contradictions are refused."""
        for one, other in (("user", "password"), ("cert_file", "key_file")):
            given = {name for name in (one, other) if getattr(self, name) is not None}
            if len(given) == 1:
                missing = ({one, other} - given).pop()
                message = f"{missing} is missing; {one} and {other} belong together"
                raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field=missing)
        files = {"ca_file": self.ca_file, "cert_file": self.cert_file, "key_file": self.key_file}
        for name, path in files.items():
            if path is not None:
                read_file(name, path)
                if not endpoint.startswith(("tls/", "quic/")):
                    message = f"{name} is for TLS, but the endpoint is {endpoint}; write tls/host:port"
                    raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field=name)
        settings: dict[str, object | None] = {
            "transport/auth/usrpwd/user": self.user,
            "transport/auth/usrpwd/password": self.password,
            "transport/link/tls/root_ca_certificate": _path(self.ca_file),
            "transport/link/tls/connect_certificate": _path(self.cert_file),
            "transport/link/tls/connect_private_key": _path(self.key_file),
            "transport/link/tls/enable_mtls": None if self.cert_file is None else True,
        }
        return {key: value for key, value in settings.items() if value is not None}


def _path(path: FilePath | None) -> str | None:
    return None if path is None else os.path.abspath(path)


def _open(endpoint: str, namespace: str, timeout_s: float, credentials: Credentials | None) -> Any:  # noqa: ANN401
    if not (isinstance(endpoint, str) and re.match(r"[a-z0-9_-]+/.", endpoint)):
        message = f"endpoint is {endpoint!r}; write tcp/host:port or tls/host:port, e.g. tcp/127.0.0.1:7447"
        raise InvalidArgument(message, reason="ADDRESS_INVALID", field="endpoint")
    config = zenoh.Config()
    settings: dict[str, object] = {
        **({"namespace": namespace} if namespace else {}),
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [],
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": int(timeout_s * 1000),
        "connect/exit_on_failure": True,
        **(credentials or Credentials()).settings(endpoint),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as cause:
        message = (
            f"no zenoh peer lets us in at {endpoint}; is the server running with --zenoh, and are the "
            "credentials right?"
        )
        raise Unavailable(message, reason="ENDPOINT_UNREACHABLE", field="endpoint") from cause


class _Peer:
    """What publishers and readers have in common: one session, at one endpoint."""

    def __init__(
        self,
        endpoint: str,
        *,
        session_id: str,
        namespace: str = "",
        timeout_s: float = 10.0,
        credentials: Credentials | None = None,
    ) -> None:
        """`endpoint` is tcp/host:port or tls/host:port, of the server or of a router that it is connected
        to; `namespace` the server's `zenoh.namespace`."""
        if not (isinstance(session_id, str) and re.fullmatch("[A-Za-z0-9_-]{1,64}", session_id)):
            message = f"session_id is {session_id!r}; use 1 to 64 characters of a-z A-Z 0-9 _ -"
            raise InvalidArgument(message, reason="ID_INVALID", field="session_id")
        #: Name of the session.
        self.session_id = session_id
        self._timeout_s = timeout_s
        self._zenoh = _open(endpoint, namespace, timeout_s, credentials)

    @property
    def session(self) -> Session:
        """The session, asked over zenoh: all that `Session` can do but streams of frames or events, and
        files: `stream`, `watch` and `watch_path` raise NEEDS_GRPC, exports KEY_UNKNOWN."""
        return Session(self._transport(), self.session_id)

    def is_alive(self) -> bool:
        """Whether the session is awake on a server of this network, by its liveliness."""
        tokens = self._zenoh.liveliness().get(self._key("alive"), timeout=self._timeout_s)
        return any(token.ok is not None for token in tokens)

    def _transport(self) -> OverZenoh:
        def ask(rpc: Rpc[Any, Any], request: bytes, timeout_s: float) -> bytes:
            return self._asked(f"rpc/{rpc.service}/{rpc.method}", request, timeout_s, zenoh.Priority.DATA)

        return OverZenoh(ask, Options(timeout_s=self._timeout_s, retries=0, metadata=()))

    def _key(self, rest: str) -> str:
        return f"percept/{self.session_id}/{rest}"

    def _asked(self, rest: str, request: bytes | None, timeout_s: float, priority: Any) -> bytes:  # noqa: ANN401
        key = self._key(rest)
        # In a network that has just come together nobody is there yet who answers.
        deadline = time.monotonic() + min(timeout_s, ANSWERS_SOON_S)
        while True:
            replies = self._zenoh.get(
                key,
                payload=request,
                timeout=timeout_s,
                priority=priority,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for reply in replies:
                if reply.ok is not None:
                    return bytes(reply.ok.payload.to_bytes())
                said = reply.err.payload.to_bytes()
                if said == _TIMEOUT:
                    raise DeadlineExceeded(f"{key} was not answered for {timeout_s:g} s")
                error = _parsed(key, error_pb2.ErrorInfo, said)
                raise error_of(error.code, error.message, reason=error.reason, field=error.field)
            if time.monotonic() > deadline:
                break
            time.sleep(0.02)
        raise Unavailable(f"nobody answers {key}; is it percept's endpoint?", reason="NO_REPLY")

    def close(self) -> None:
        """Leaves the network."""
        self._zenoh.close()


def _parsed(key: str, kind: type[M], data: bytes) -> M:
    try:
        return kind.FromString(data)
    except DecodeError as cause:
        message = f"what answers {key} is no {kind.__name__}; is it percept's endpoint?"
        raise Internal(message, reason="REPLY_INVALID") from cause


class SensorPublisher(_Peer, FrameSender[None]):
    """Publishes frames, reliably and those of a sensor in order. A server that is too slow for them drops the
    oldest ones that wait, and counts them; of a sensor with `overload_policy="block"` it makes `send_*` wait
    instead.

    zenoh does not answer: what the server refused, it counts. See MapReader.sensors(). Frames are numbered,
    so that it counts the missing ones, too. While it is there it is told of by liveliness: that it has left
    is noted in the session (`stream_notes`).
    """

    def __init__(
        self,
        endpoint: str,
        *,
        session_id: str,
        sensors: Sequence[SensorSpec] = (),
        namespace: str = "",
        timeout_s: float = 10.0,
        credentials: Credentials | None = None,
    ) -> None:
        """`endpoint` is tcp/host:port or tls/host:port, of the server or of a router that it is connected
        to; `namespace` the server's `zenoh.namespace`. With `sensors` the session is created where it is not
        there yet, and those that it has not are declared; another sensor of the same name is refused."""
        super().__init__(
            endpoint, session_id=session_id, namespace=namespace, timeout_s=timeout_s, credentials=credentials
        )
        self._publishers: dict[str, Any] = {}
        self._tokens: list[Any] = []
        self._sequences: Counter[str] = Counter()
        self._closed = False
        if sensors:
            try:
                Sessions(self._transport()).create(session_id, sensors=sensors, exist_ok=True)
            except BaseException:
                super().close()
                raise

    def send(self, frame: SensorFrame) -> None:
        """Publishes a frame; the first of a sensor waits until the server listens."""
        priority = _PRIORITIES.get(type(frame), zenoh.Priority.DATA_LOW)
        publisher = self._publishers.get(frame.sensor_id) or self._declare(frame.sensor_id, priority)
        message = streams.frame_to(self.session_id, frame, self._sequences[frame.sensor_id] + 1)
        self._sequences[frame.sensor_id] += 1
        publisher.put(message.SerializeToString())

    def publish_raw(self, sensor_id: str, payload: bytes) -> None:
        """Publishes bytes as they are, for drivers that encode SensorMessage themselves."""
        known = self._publishers.get(sensor_id)
        (known or self._declare(sensor_id, zenoh.Priority.DATA_LOW)).put(payload)

    def close(self) -> None:
        """Leaves the network once the server has all that was sent, or does not answer in time."""
        try:
            if self._publishers and not self._closed:
                # zenoh may drop what is still on its way when it closes. A question travels behind the
                # frames: its answer says that they have arrived. Where nobody answers at once it is asked
                # again: in a network that has just come together, frames are heard before questions are.
                deadline = time.monotonic() + min(self._timeout_s, ANSWERS_SOON_S)
                while not self._is_answered() and time.monotonic() < deadline:
                    time.sleep(0.02)
        finally:
            self._closed = True
            super().close()

    def _is_answered(self) -> bool:
        # No sooner than the last of the frames.
        question = self._zenoh.get(
            self._key("sensors"),
            timeout=self._timeout_s,
            priority=zenoh.Priority.DATA_LOW,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        return bool([*question])

    def _declare(self, sensor_id: str, priority: Any) -> Any:  # noqa: ANN401
        key = self._key(f"{sensor_id}/frame")
        publisher = self._zenoh.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
            priority=priority,
        )
        deadline = time.monotonic() + self._timeout_s
        # Samples that nobody listens to are dropped where they are published.
        while not publisher.matching_status.matching:
            if time.monotonic() > deadline:
                publisher.undeclare()
                raise Unavailable(
                    f"nobody listens to {key}; is it percept's endpoint?", reason="NO_SUBSCRIBER"
                )
            time.sleep(0.005)
        self._publishers[sensor_id] = publisher
        self._tokens.append(self._zenoh.liveliness().declare_token(self._key(f"{sensor_id}/alive")))
        return publisher

    def __enter__(self) -> SensorPublisher:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Subscription(Generic[T]):
    """Results as they are published; an iterator and a context manager. A slow reader misses the oldest."""

    def __init__(self, session: Any, key: str, read: Callable[[bytes], T]) -> None:  # noqa: ANN401
        self._results: queue.Queue[T] = queue.Queue(MAX_UNREAD)
        self._read = read
        self._subscriber = session.declare_subscriber(key, self._take)

    def _take(self, sample: Any) -> None:  # noqa: ANN401
        result = self._read(sample.payload.to_bytes())
        while True:
            try:
                return self._results.put_nowait(result)
            except queue.Full:
                try:
                    self._results.get_nowait()
                except queue.Empty:
                    continue

    def receive(self, *, timeout_s: float | None = None) -> T:
        """The next result; waits for ever unless told how long."""
        try:
            return self._results.get(timeout=timeout_s)
        except queue.Empty:
            raise DeadlineExceeded(f"nothing was published for {timeout_s:g} s") from None

    def __iter__(self) -> Iterator[T]:
        while True:
            yield self.receive()

    def close(self) -> None:
        """Ends the subscription."""
        self._subscriber.undeclare()

    def __enter__(self) -> Subscription[T]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class MapReader(_Peer):
    """Reads a session's results over zenoh."""

    def pose(self) -> PoseEstimate | None:
        """Newest pose, None before the first frame. Lost is an answer."""
        try:
            return poses.pose_estimate(self._ask("pose", session_pb2.PoseEstimate))
        except FailedPrecondition:
            return None

    def occupancy(self) -> OccupancyGrid:
        """The whole occupancy grid."""
        return maps.occupancy([self._ask("map/occupancy", map_pb2.OccupancyGridChunk)])

    def cloud(self) -> MapCloud:
        """The whole fused cloud."""
        return maps.cloud([self._ask("map/cloud", map_pb2.CloudChunk)])

    def graph(self) -> SceneGraph:
        """Robot, objects, rooms and their relations."""
        return scene.graph(self._ask("scene/graph", scene_pb2.SceneGraph))

    def objects(self) -> list[Object]:
        """Objects by id."""
        answer = self._ask("scene/objects", scene_service_pb2.ListObjectsResponse)
        return [scene.tracked(o) for o in answer.objects]

    def rooms(self) -> Rooms:
        """Rooms, the doors between them, places to be, and the ways between those."""
        return scene.rooms(self._ask("scene/rooms", scene_service_pb2.GetRoomsResponse))

    def sensors(self) -> list[SensorStatus]:
        """What the server sees of the sensors' streams: frames accepted, refused, dropped, missing."""
        answer = self._ask("sensors", sensors_service_pb2.ListSensorsResponse)
        return [streams.status(s) for s in answer.sensors]

    def poses(self) -> Subscription[PoseEstimate]:
        """Poses from now on, one after every registered frame."""

        def read(data: bytes) -> PoseEstimate:
            return poses.pose_estimate(session_pb2.PoseEstimate.FromString(data))

        return Subscription(self._zenoh, self._key("pose"), read)

    def events(self) -> Subscription[SessionEvent]:
        """Events from now on."""

        def read(data: bytes) -> SessionEvent:
            return sessions.event(session_pb2.SessionEvent.FromString(data))

        return Subscription(self._zenoh, self._key("events"), read)

    def _ask(self, rest: str, kind: type[M]) -> M:
        # What robots steer by goes before what is looked at.
        soon = zenoh.Priority.INTERACTIVE_HIGH if rest == "pose" else zenoh.Priority.DATA_LOW
        return _parsed(self._key(rest), kind, self._asked(rest, None, self._timeout_s, soon))

    def __enter__(self) -> MapReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

"""The books of a stream of frames, without threads or loops: what was sent, what came back, what is safe.

A stream may live through several connections. A frame is kept until it is durable or was refused for good;
those kept are written again on the next connection, where the server refuses by its stamp what it had taken
in before.
"""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections import Counter, deque

from ._convert import poses, sensors
from .errors import PerceptError, ResourceExhausted, Unauthenticated, Unavailable, error_of
from .types.frames import SensorFrame
from .types.sensors import FrameAck, StreamSummary
from .v1 import sensors_service_pb2 as service
from .v1.error_pb2 import ErrorInfo

_log = logging.getLogger("percept")

#: Acknowledgements that nobody reads are kept up to this many, then the oldest go.
MAX_UNREAD = 4096
MAX_REJECTIONS = 100
#: What a kept frame takes in memory beside its bytes, about.
OVERHEAD_BYTES = 256

#: What the server says of a frame that it may have taken in before; the second of one some seconds back.
TAKEN_BEFORE = ("STAMP_NOT_INCREASING", "CLOCK_SET_BACK")


@dataclasses.dataclass(eq=False)
class Sent:
    """A frame that is not known to be safe."""

    data: bytes
    #: Whether its stamp is later than all that the stream sent before for its sensor.
    in_order: bool
    answered: bool = False
    #: Refused whatever is tried, or durable: it need not be sent again.
    settled: bool = False
    #: It was accepted over a connection of before, or that one ended before it was answered.
    may_be_there: bool = False


class Connection:
    """One connection's part: acknowledgements come in the order of writing, and count from its first."""

    def __init__(self, frames: deque[Sent]) -> None:
        self.to_write = frames
        self.unanswered: deque[Sent] = deque()
        self.not_durable: deque[Sent] = deque()
        self.durable = 0
        #: The server has answered, though nothing of frames yet.
        self.taken_up = False
        #: It ended, whoever ended it.
        self.closed = False
        #: We said that no more comes.
        self.finished = False

    @property
    def complete(self) -> bool:
        """Whether all that was written was answered, and no more was to come."""
        return self.finished and not self.unanswered


class StreamState:
    """What was sent, what came back."""

    def __init__(self, session_id: str, *, resume: bool) -> None:
        self.session_id = session_id
        self.resume = resume
        self.sent = 0
        self.answered = 0
        self.rejected = 0
        self.durable = 0
        #: Grows with everything that comes back.
        self.progress = 0
        self.ended = False
        self.error: PerceptError | None = None
        #: Why the newest frame that could not be taken just then was turned away.
        self.turned_away: PerceptError | None = None
        self.unread: deque[FrameAck] = deque(maxlen=MAX_UNREAD)
        self._kept_bytes = 0
        self._kept: deque[Sent] = deque()
        self._connection: Connection | None = None
        self._rejections: list[FrameAck] = []
        self._told: set[tuple[str, str]] = set()
        self._sequences: Counter[str] = Counter()
        self._newest: dict[str, int] = {}
        # The summary is read at any time, from any thread.
        self._lock = threading.Lock()

    @property
    def in_flight(self) -> int:
        """Frames sent and not yet acknowledged."""
        return self.sent - self.answered

    @property
    def unsafe(self) -> bool:
        """Whether frames are kept that would be lost if the server were."""
        return bool(self._kept)

    def fits(self, data: bytes, limit_bytes: int) -> bool:
        """Whether a frame has room beside those that are kept; one alone always has."""
        needed = self._kept_bytes + OVERHEAD_BYTES + len(data)
        return not self._kept_bytes or needed <= limit_bytes

    def encoded(self, frame: SensorFrame) -> bytes:
        """A frame as a message, numbered for its sensor from 1."""
        request = service.StreamFramesRequest()
        sequence = self._sequences[frame.sensor_id] + 1
        sensors.fill_frame(request.message, self.session_id, frame, sequence)
        return request.SerializeToString()

    def add(self, frame: SensorFrame, data: bytes) -> None:
        """Takes an encoded frame to be written."""
        newest = self._newest.get(frame.sensor_id)
        in_order = newest is None or frame.stamp_ns > newest
        if in_order:
            self._newest[frame.sensor_id] = frame.stamp_ns
        self._sequences[frame.sensor_id] += 1
        sent = Sent(data, in_order)
        with self._lock:
            self.sent += 1
            self._kept_bytes += OVERHEAD_BYTES + len(data)
            self._kept.append(sent)
        if self._connection is not None and not self._connection.closed:
            self._connection.to_write.append(sent)

    def connect(self) -> Connection:
        """Begins a connection, with all that is not settled to be written (again)."""
        for sent in self._connection.unanswered if self._connection else ():
            sent.may_be_there = True
        self._connection = Connection(deque(s for s in self._kept if not s.settled))
        return self._connection

    def write(self, connection: Connection) -> bytes:
        """The next message of a connection."""
        sent = connection.to_write.popleft()
        connection.unanswered.append(sent)
        connection.not_durable.append(sent)
        data = sent.data
        if not self.resume:
            self._forget(sent)
        return data

    def answer(self, connection: Connection, answer: service.StreamFramesResponse) -> None:
        """Takes an acknowledgement; one without an outcome only tells what became durable.

        Raises why the server turns the frame away, if that is for now and it is to be sent again.
        """
        with self._lock:
            self.progress += 1
            sent = None
            if answer.ack.WhichOneof("outcome") is not None and connection.unanswered:
                sent = connection.unanswered.popleft()
                self._turn_away(answer.ack.rejection)
            self._make_durable(connection, answer.ack.durable_count)
            if sent is not None:
                self._settle(sent, dataclasses.replace(poses.ack(answer.ack), durable_count=self.durable))

    def _turn_away(self, refused: ErrorInfo) -> None:
        """Raises what a refusal says if it says nothing of the frame itself."""
        if not self.resume or not _is_for_now(refused):
            return
        self.progress -= 1
        self.turned_away = error_of(
            refused.code,
            refused.message,
            reason=refused.reason,
            field=refused.field,
            retry_after_s=refused.retry_after_s or None,
            server=refused.server or None,
        )
        raise self.turned_away

    def _make_durable(self, connection: Connection, count: int) -> None:
        while connection.durable < count and connection.not_durable:
            connection.not_durable.popleft().settled = True
            connection.durable += 1
        self._pop_settled()

    def _pop_settled(self) -> None:
        while self._kept and self._kept[0].settled:
            self._forget(self._kept.popleft())
            self.durable += 1

    def _forget(self, sent: Sent) -> None:
        if sent.data:
            self._kept_bytes -= OVERHEAD_BYTES + len(sent.data)
            sent.data = b""

    def _settle(self, sent: Sent, ack: FrameAck) -> None:
        if ack.rejection is not None and self._taken_before(sent, ack.rejection.reason):
            ack = dataclasses.replace(ack, rejection=None)
        sent.may_be_there = sent.may_be_there or ack.accepted
        if not sent.answered:
            sent.answered = True
            self.answered += 1
            self.unread.append(ack)
        elif ack.accepted:
            return
        if not ack.accepted:
            self.rejected += 1
            self._tell(ack)
            sent.settled = True
            self._pop_settled()
            if len(self._rejections) < MAX_REJECTIONS:
                self._rejections.append(ack)

    def _tell(self, ack: FrameAck) -> None:
        """Says once for each sensor and reason that frames are refused: whoever does not read
        acknowledgements would not know."""
        refused = ack.rejection
        if refused is None or (ack.sensor_id, refused.reason) in self._told:
            return
        self._told.add((ack.sensor_id, refused.reason))
        words = "session %s refused frame %d of %s: %s [%s]; the stream's summary counts what else is refused"
        _log.warning(words, self.session_id, ack.sequence, ack.sensor_id, refused.message, refused.reason)

    @staticmethod
    def _taken_before(sent: Sent, reason: str) -> bool:
        """Whether a refused stamp only says that the frame arrived over a connection of before."""
        return reason in TAKEN_BEFORE and sent.in_order and sent.may_be_there

    def summary(self) -> StreamSummary:
        """What became of the stream."""
        with self._lock:
            return StreamSummary(
                sent=self.sent,
                accepted=self.answered - self.rejected,
                rejected=self.rejected,
                durable=self.durable,
                rejections=tuple(self._rejections),
            )


def _is_for_now(refused: ErrorInfo) -> bool:
    """Whether the same frame may be taken later: the server is away or full, or has to know anew who asks."""
    if refused.code == ResourceExhausted.code:
        # A frame that is over a limit stays so.
        return not (refused.field or refused.reason.endswith("_TOO_LARGE"))
    return refused.code in (Unavailable.code, Unauthenticated.code)

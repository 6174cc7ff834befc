"""The books of a stream, without threads or loops: both streams keep them alike."""

from __future__ import annotations

from collections import Counter, deque

from ._convert import poses, sensors
from .errors import PerceptError
from .types.frames import SensorFrame
from .types.sensors import FrameAck, StreamSummary
from .v1 import sensors_service_pb2 as service

#: Acknowledgements that nobody reads are kept up to this many, then the oldest go.
MAX_UNREAD = 4096
MAX_REJECTIONS = 100


class StreamState:
    """What was sent, what came back."""

    def __init__(self, session_id: str) -> None:
        self.session_id = session_id
        self.sent = 0
        self.answered = 0
        self.rejected = 0
        self.durable = 0
        self.ended = False
        self.error: PerceptError | None = None
        self.unread: deque[FrameAck] = deque(maxlen=MAX_UNREAD)
        self._rejections: list[FrameAck] = []
        self._sequences: Counter[str] = Counter()

    @property
    def in_flight(self) -> int:
        """Frames sent and not yet acknowledged."""
        return self.sent - self.answered

    def message(self, frame: SensorFrame) -> service.StreamFramesRequest:
        """A frame as a message, numbered for its sensor from 1."""
        request = service.StreamFramesRequest()
        sequence = self._sequences[frame.sensor_id] + 1
        sensors.fill_frame(request.message, self.session_id, frame, sequence)
        self._sequences[frame.sensor_id] = sequence
        return request

    def answer(self, answer: service.StreamFramesResponse) -> None:
        """Takes an acknowledgement; one without an outcome only tells what became durable."""
        self.durable = max(self.durable, answer.ack.durable_count)
        if answer.ack.WhichOneof("outcome") is None:
            return
        ack = poses.ack(answer.ack)
        self.answered += 1
        self.unread.append(ack)
        if not ack.accepted:
            self.rejected += 1
            if len(self._rejections) < MAX_REJECTIONS:
                self._rejections.append(ack)

    def summary(self) -> StreamSummary:
        """What became of the stream."""
        return StreamSummary(
            sent=self.sent,
            accepted=self.answered - self.rejected,
            rejected=self.rejected,
            durable=self.durable,
            rejections=tuple(self._rejections),
        )

"""Below the client: calls with deadlines that may be cancelled, sockets that misbehave, HTTP/2 by hand."""

from __future__ import annotations

import contextlib
import socket
import struct
from dataclasses import dataclass
from importlib import import_module

import grpc
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from percept import errors

#: Services by name, with the module that declares each.
_MODULES = {
    "SessionsService": "sessions_service_pb2",
    "SensorsService": "sensors_service_pb2",
    "MapsService": "maps_service_pb2",
    "SceneService": "scene_service_pb2",
    "OperationsService": "operations_service_pb2",
}


@dataclass(frozen=True)
class Answer:
    """What a call came to; `code` is the name of gRPC's."""

    code: str
    reason: str = ""
    text: str = ""
    message: Message | None = None

    @property
    def ok(self) -> bool:
        return self.code == "OK"

    @property
    def unheard(self) -> bool:
        """The caller left before the answer: what became of the call is open."""
        return self.code in ("DEADLINE_EXCEEDED", "CANCELLED")


class Calls:
    """The contract by name, without the client's retries and deadlines.

    `calls("SessionsService/CreateSession", session_id="robot", timeout_s=0.001)` answers; `calls.begin(...)`
    gives a future that may be cancelled and is read by `answer_of`.
    """

    def __init__(self, address: str) -> None:
        options = [
            ("grpc.use_local_subchannel_pool", 1),
            ("grpc.enable_retries", 0),
            ("grpc.initial_reconnect_backoff_ms", 100),
            ("grpc.max_reconnect_backoff_ms", 500),
        ]
        self.channel = grpc.insecure_channel(address, options)
        # A first call under a short deadline would else be spent on connecting.
        grpc.channel_ready_future(self.channel).result(timeout=10)

    def __call__(self, rpc: str, timeout_s: float | None = 30.0, **fields: object) -> Answer:
        return answer_of(self.begin(rpc, timeout_s, **fields))

    def begin(self, rpc: str, timeout_s: float | None = 30.0, **fields: object) -> grpc.Future:
        method = _method(rpc)
        call = self.channel.unary_unary(
            f"/percept.v1.{rpc}",
            request_serializer=lambda m: m.SerializeToString(),
            response_deserializer=GetMessageClass(method.output_type).FromString,
        )
        return call.future(GetMessageClass(method.input_type)(**fields), timeout=timeout_s)

    def close(self) -> None:
        self.channel.close()

    def __enter__(self) -> Calls:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _method(rpc: str):
    service, method = rpc.split("/")
    module = import_module(f"percept.v1.{_MODULES[service]}")
    return module.DESCRIPTOR.services_by_name[service].methods_by_name[method]


def answer_of(future: grpc.Future) -> Answer:
    """Waits for a call that `begin` began."""
    try:
        return Answer("OK", message=future.result())
    except grpc.FutureCancelledError:
        return Answer("CANCELLED")
    except grpc.RpcError as cause:
        e = errors.error_of_rpc(cause)
        return Answer(e.code, e.reason, e.message)


def address_of(text: str) -> tuple[str, int]:
    """`127.0.0.1:80` as sockets take it."""
    host, port = text.rsplit(":", 1)
    return host, int(port)


def connect(address: str, timeout_s: float = 10.0) -> socket.socket:
    """A plain TCP connection."""
    return socket.create_connection(address_of(address), timeout=timeout_s)


def request_head(method: str, path: str, **headers: object) -> bytes:
    """An HTTP/1.1 head; `host`, unless given, is what a good client on this machine sends."""
    named = {"host": "127.0.0.1", **{k.replace("_", "-"): v for k, v in headers.items()}}
    lines = [f"{method} {path} HTTP/1.1", *(f"{k}: {v}" for k, v in named.items())]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def send_and_leave(address: str, data: bytes) -> None:
    """Sends, and closes at once without reading."""
    with connect(address) as s:
        s.sendall(data)


def exchange(address: str, data: bytes, timeout_s: float = 10.0) -> bytes:
    """Sends; reads until the peer closes or is silent for so long."""
    with connect(address, timeout_s) as s:
        with contextlib.suppress(OSError):
            s.sendall(data)
        return read_all(s)


def read_all(s: socket.socket, limit: int = 1 << 20) -> bytes:
    """What comes until the peer closes, or is silent for the socket's time-out."""
    out = b""
    with contextlib.suppress(OSError):
        while len(out) < limit and (part := s.recv(65536)):
            out += part
    return out


def status_of(answer: bytes) -> int | None:
    """Status of an HTTP/1.1 answer, None if it is none."""
    parts = answer.split(b" ", 2)
    return int(parts[1]) if len(parts) == 3 and parts[0].startswith(b"HTTP/1.") else None


def closed_by_peer(s: socket.socket) -> bool:
    """Whether the peer has ended the connection; does not wait."""
    s.setblocking(False)
    try:
        while True:
            if s.recv(65536) == b"":
                return True
    except BlockingIOError:
        return False
    except OSError:
        return True


# HTTP/2, RFC 9113: the few frames that attacks are made of.
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY, WINDOW_UPDATE, CONTINUATION = 0, 1, 3, 4, 6, 7, 8, 9
END_STREAM, END_HEADERS, ACK = 1, 4, 1
INITIAL_WINDOW_SIZE = 4


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    """A frame, RFC 9113 section 4.1."""
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def header_block(headers: list[tuple[str, str]]) -> bytes:
    """Literal fields without indexing and Huffman coding, RFC 7541 section 6.2.2."""
    return b"".join(b"\x00" + _text(name) + _text(value) for name, value in headers)


def _text(text: str) -> bytes:
    raw = text.encode()
    if len(raw) < 127:
        return bytes([len(raw)]) + raw
    rest, out = len(raw) - 127, b"\x7f"
    while rest >= 128:
        out += bytes([rest % 128 + 128])
        rest //= 128
    return out + bytes([rest]) + raw


def grpc_headers(rpc: str, **more: str) -> list[tuple[str, str]]:
    """Headers of a gRPC call as a good client sends them."""
    return [
        (":method", "POST"),
        (":scheme", "http"),
        (":path", f"/percept.v1.{rpc}"),
        (":authority", more.pop("authority", "127.0.0.1")),
        ("te", "trailers"),
        ("content-type", "application/grpc"),
        *more.items(),
    ]


class Http2:
    """A connection that has said hello and then does as it is told."""

    def __init__(self, address: str, timeout_s: float = 10.0) -> None:
        self.socket = connect(address, timeout_s)
        self.socket.sendall(PREFACE + frame(SETTINGS, 0, 0))
        self._next = 1
        #: What the server takes ahead on a stream and on the connection, RFC 9113 section 6.9.
        self._stream_window, self._window = 65535, 65535
        # The server's larger windows and frames count from our acknowledgement on.
        for kind, flags, _, payload in self.frames(10):
            if kind == SETTINGS and not flags & ACK:
                settings = dict(struct.iter_unpack(">HI", payload))
                self._stream_window = settings.get(INITIAL_WINDOW_SIZE, self._stream_window)
                self.socket.sendall(frame(SETTINGS, ACK, 0))
                break

    def open_stream(self, rpc: str, *, end: bool = False, **more: str) -> int:
        """Begins a call; nothing is sent but its headers."""
        stream, self._next = self._next, self._next + 2
        flags = END_HEADERS | (END_STREAM if end else 0)
        self.socket.sendall(frame(HEADERS, flags, stream, header_block(grpc_headers(rpc, **more))))
        return stream

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def send_whole(self, stream: int, payload: bytes):
        """Sends a stream's only message as the windows allow and ends the stream: the first frame that
        answers it, None if the peer closes or is silent for the time-out.
        """
        window, at = self._stream_window, 0
        while True:
            while at < len(payload) and (size := min(window, self._window, len(payload) - at, 1 << 14)) > 0:
                flags = END_STREAM if at + size == len(payload) else 0
                self.send(frame(DATA, flags, stream, payload[at : at + size]))
                window, self._window, at = window - size, self._window - size, at + size
            answer = next(self.frames(1), None)
            if answer is None:
                return None
            kind, _, of, update = answer
            if kind == WINDOW_UPDATE:
                more = int.from_bytes(update, "big")
                window, self._window = (window + more, self._window) if of == stream else (window, self._window + more)
            elif of == stream:
                return answer

    def frames(self, limit: int = 1000):
        """(kind, flags, stream, payload) as they come, until the peer closes or is silent for the
        time-out.
        """
        for _ in range(limit):
            head = self._exactly(9)
            if head is None:
                return
            payload = self._exactly(int.from_bytes(head[:3], "big"))
            if payload is None:
                return
            yield head[3], head[4], int.from_bytes(head[5:9], "big") & 0x7FFFFFFF, payload

    def close(self) -> None:
        self.socket.close()

    def _exactly(self, count: int) -> bytes | None:
        out = b""
        with contextlib.suppress(OSError):
            while len(out) < count:
                part = self.socket.recv(count - len(out))
                if not part:
                    return None
                out += part
            return out
        return None


def message_prefix(length: int) -> bytes:
    """gRPC's five bytes before a message, which may promise more than comes."""
    return b"\0" + struct.pack(">I", length)

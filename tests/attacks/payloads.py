"""Attacks with what is sent: bombs, floods, names that lead elsewhere, hosts that are not ours, handles of
others.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gzip
import json
import pathlib
import struct
import threading
import time
import zlib
from concurrent.futures import ThreadPoolExecutor

import httpx
import numpy as np
import percept.zenoh
from percept import Client, CloudFormat, PerceptError, SensorSpec

from support import raw, world
from support.robots import scan
from support.server import eventually

from .connections import Target, Tried

SEEDS = pathlib.Path(__file__).resolve().parents[1] / "fuzz" / "seeds"


def png_bomb(width: int, height: int) -> bytes:
    """A grey 16-bit PNG of zeros, three thousandths of its pixels' bytes."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, row = zlib.compressobj(9), bytes(1 + 2 * width)
    body = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def laz_bomb(points: int) -> bytes:
    """A LAZ file of three points whose header promises many."""
    data = bytearray((SEEDS / "las" / "plain.laz").read_bytes())
    struct.pack_into("<I", data, 107, points)
    if data[25] >= 4:
        struct.pack_into("<Q", data, 247, points)
    return bytes(data)


def refused(ask) -> str:
    """The reason for which a call is refused; empty if it is not."""
    try:
        ask()
    except PerceptError as error:
        return error.reason or error.code
    return ""


def image_bombs(target: Target) -> Tried:
    """Ten PNGs of 9,000 x 9,000 pixels in a sixth of a megabyte each, at once, that say so or lie."""
    from percept import CameraIntrinsics, EncodedImage

    side, data = 9_000, png_bomb(9_000, 9_000)
    out = Tried(note="reasons:")
    for declared in (side, 320):
        camera = CameraIntrinsics(
            width_px=declared, height_px=declared, fx_px=300.0, fy_px=300.0, cx_px=160.0, cy_px=120.0
        )
        session = target.client.sessions.create(sensors=[SensorSpec("camera", kind="depth", intrinsics=camera)])
        image = EncodedImage(data=data, width_px=declared, height_px=declared)

        def send(k, session=session, image=image):
            return refused(lambda: session.send_depth("camera", stamp_ns=k + 1, depth=image, metres_per_unit=0.001))

        with ThreadPoolExecutor(5) as pool:
            reasons = list(pool.map(send, range(5)))
        out.sent += len(reasons)
        out.ended += sum(bool(r) for r in reasons)
        out.note += f" {sorted(set(reasons))}"
        session.delete()
    if out.ended < out.sent:
        out.broken.append("a bomb was taken")
    return out


def laz_bombs(target: Target) -> Tried:
    """LAZ files of 400 bytes that promise from 10^6 to 4 x 10^9 points, and one made of repeats."""
    out = Tried(note="reasons:")
    for points in (10**6, 10**8, 2**32 - 1):
        data = laz_bomb(points)
        reason = refused(lambda d=data: target.client.toolbox.decode_cloud(d, file_format=CloudFormat.LAZ))
        out.sent, out.ended = out.sent + 1, out.ended + bool(reason)
        out.note += f" {reason or 'taken'}"
    return out


def gzip_bombs(target: Target) -> Tried:
    """Bodies of 1 GB, compressed to 1 MB, over REST and as gRPC messages."""
    packed = gzip.compress(bytes(64 << 20), 6) * 16
    out = Tried()
    with httpx.Client(base_url=target.server.rest_url, timeout=30) as http:
        headers = {"content-type": "application/json", "content-encoding": "gzip"}
        answer = http.post("/v1/sessions", content=packed, headers=headers)
        out.sent, out.ended = 1, int(answer.status_code >= 400)
        out.note = f"REST {answer.status_code}"
    h2 = raw.Http2(target.server.grpc)
    headers = {"grpc-encoding": "gzip", "grpc-accept-encoding": "identity"}
    stream = h2.open_stream("SessionsService/CreateSession", **headers)
    payload = b"\x01" + struct.pack(">I", len(packed)) + packed
    # To find out what it would be takes a slow machine seconds.
    h2.socket.settimeout(20.0)
    answer = None
    with contextlib.suppress(OSError):
        answer = h2.send_whole(stream, payload)
    h2.close()
    out.sent, out.ended = out.sent + 1, out.ended + (answer is not None)
    out.note += f", gRPC {'silent' if answer is None else 'answered'}"
    return out


def nested_json(target: Target) -> Tried:
    """JSON a million deep, numbers of a million digits, and keys given twice."""
    bodies = [
        b'{"params":' * 10**6,
        b"[" * 10**6 + b"]" * 10**6,
        b'{"session_id": ' + b"9" * 10**6 + b"}",
        b'{"session_id": "a", "session_id": "b"}',
        b'{"session_id": "\\ud800"}',
    ]
    out = Tried()
    with httpx.Client(base_url=target.server.rest_url, timeout=30) as http:
        for body in bodies:
            answer = http.post("/v1/sessions", content=body, headers={"content-type": "application/json"})
            out.sent, out.ended = out.sent + 1, out.ended + (answer.status_code == 400)
            out.note += f"{answer.status_code} "
    return out


def zenoh_flood(target: Target) -> Tried:
    """Garbage over zenoh, as fast as it goes: to a sensor that is there, to none, to sessions that are
    not.
    """
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [target.server.zenoh],
    }.items():
        config.insert_json5(key, json.dumps(value))
    session = target.client.sessions.create(sensors=[world.LASER])
    name, sent = session.session_id, 0
    peer = zenoh.open(config)
    keys = [f"percept/{name}/laser/frame", f"percept/{name}/none/frame", "percept/nobody/laser/frame"]
    publishers = [peer.declare_publisher(k, congestion_control=zenoh.CongestionControl.BLOCK) for k in keys]
    end = time.monotonic() + target.seconds
    with contextlib.suppress(zenoh.ZError):
        while time.monotonic() < end:
            for publisher in publishers:
                for _ in range(50):
                    publisher.put(b"\xff" * 64)
                sent += 50
    peer.close()
    with percept.zenoh.SensorPublisher(target.server.zenoh, session_id=name) as publisher:
        publisher.send_scan("laser", stamp_ns=1, **scan(0))
    taken = eventually(lambda: session.sensors.list()[0].accepted == 1, seconds=30)
    return Tried(sent, 0, f"{sent / target.seconds:.0f}/s", [] if taken else ["a good frame after it is lost"])


def zenoh_sizes(target: Target) -> Tried:
    """Twenty samples of 64 MB, and ten thousand questions with long selectors."""
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [target.server.zenoh],
    }.items():
        config.insert_json5(key, json.dumps(value))
    peer, out = zenoh.open(config), Tried()
    with contextlib.suppress(zenoh.ZError):
        for _ in range(target.many(20)):
            peer.put(f"percept/{target.session_id}/laser/frame", bytes(64 << 20))
            out.sent += 1
        for k in range(target.many(2000)):
            peer.get(f"percept/{target.session_id}/map/occupancy?x={'a' * 1000}{k}", timeout=1.0)
            out.sent += 1
    peer.close()
    return out


FOREIGN = [
    "evil.example",
    "evil.example:80",
    "127.0.0.1.evil.example",
    "localhost.evil.example",
    "169.254.169.254",
    "",
]


def dns_rebinding(target: Target) -> Tried:
    """Requests as a page of another site makes a browser send: Host of that site, Origin of that site."""
    out, rest = Tried(), target.server.rest
    body = b'{"display_name": "made by evil.example"}'
    for host in FOREIGN:
        requests = [
            ("GET", "/v1/sessions", b""),
            ("POST", "/v1/sessions", body),
            ("GET", "/", b""),
            ("DELETE", "/v1/sessions/not-there", b""),
        ]
        for method, path, content in requests:
            head = raw.request_head(
                method,
                path,
                host=host,
                content_type="application/json",
                content_length=len(content),
                connection="close",
            )
            status = raw.status_of(raw.exchange(rest, head + content))
            out.sent += 1
            if status in (400, 403, 421):
                out.ended += 1
            else:
                out.broken.append(f"Host {host!r}: {method} {path} answers {status}")
    origin = raw.request_head(
        "POST",
        "/v1/sessions",
        host=rest,
        origin="http://evil.example",
        content_type="text/plain",
        content_length=len(body),
        connection="close",
    )
    status = raw.status_of(raw.exchange(rest, origin + body))
    out.sent += 1
    if status and status >= 400:
        out.ended += 1
    else:
        out.broken.append(f"a form of another site creates a session: {status}")
    return out


TRAVERSALS = [
    "/../../../../etc/passwd",
    "/..%2f..%2f..%2f..%2fetc%2fpasswd",
    "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
    "/v1/sessions/..%2f..%2fetc/map",
    "/v1/sessions/../../../etc/passwd",
    "/v1/sessions/%2e%2e%2f%2e%2e/map/files/cloud.ply",
    "/v1/sessions/{id}/map/files/..%2f..%2f..%2fLOCK",
    "/v1/sessions/{id}/map/files/../../../LOCK",
    "/v1/sessions/{id}/map/files/%00",
    "/v1/sessions/{id}%00/pose",
    "/v1/toolbox/clouds/..%2f..%2fLOCK",
    "/docs/../../../etc/passwd",
    "//etc/passwd",
    "/\\..\\..\\etc\\passwd",
]
NAMES = [
    "../evil",
    "..",
    ".",
    "a/../../b",
    "/etc/passwd",
    "a\\b",
    "a\0b",
    "%2e%2e",
    "a:b",
    "con",
    "~",
    "*",
    "",
    "é",
    "a" * 65,
]


def path_traversal(target: Target) -> Tried:
    """Paths and session ids that lead out of the data directory."""
    out = Tried()
    before = {p.name for p in target.server.data_dir.parent.iterdir()}
    for path in TRAVERSALS:
        head = raw.request_head("GET", path.format(id=target.session_id), connection="close")
        answer = raw.exchange(target.server.rest, head, 5)
        status = raw.status_of(answer)
        out.sent += 1
        if b"root:" in answer or (status is not None and status < 400):
            out.broken.append(f"{path} answers {status}")
        else:
            out.ended += 1
    for name in NAMES:
        reason = refused(lambda n=name: target.client.sessions.create(n))
        # Names are letters and digits; a device of another system is such a name, too.
        out.sent += 1
        if reason or name == "con":
            out.ended += 1
        else:
            out.broken.append(f"a session is called {name!r}")
    with contextlib.suppress(PerceptError):
        target.client.session("con").delete()
    if {p.name for p in target.server.data_dir.parent.iterdir()} != before:
        out.broken.append("something was written beside the data directory")
    return out


def guessed_handles(target: Target) -> Tried:
    """Handles of kept clouds, guessed from one's own: the numbers around it, and its digits changed."""
    cloud = np.random.default_rng(1).uniform(-1, 1, (100, 3)).astype(np.float32)
    with Client(target.server.grpc) as victim:
        secrets = {victim.toolbox.upload_cloud(cloud).handle for _ in range(5)}
    kept = target.client.toolbox.upload_cloud(cloud)
    own = kept.handle
    guesses = set()
    for at in range(len(own)):
        guesses |= {own[:at] + c + own[at + 1 :] for c in "0123456789abcdef"}
    prefix, _, last = own.rpartition("-")
    with contextlib.suppress(ValueError):
        guesses |= {f"{prefix}-{int(last, 16) + k:x}" for k in range(-50, 50)}
    shape = target.client.toolbox.compute_shape_features
    hits = [g for g in guesses - {own} if not refused(lambda g=g: shape(dataclasses.replace(kept, handle=g)))]
    broken = [f"guessed {h} from {own}" for h in hits[:3]]
    listed = {c.handle for c in target.client.toolbox.list_clouds().clouds}
    note = f"{len(secrets & listed)} of {len(secrets)} handles of another client are listed"
    return Tried(len(guesses), len(guesses) - len(hits), note, broken)


def hogged_toolbox(target: Target) -> Tried:
    """Sixteen callers that ask for outliers of a million points and leave after 20 ms, over and over."""
    rng = np.random.default_rng(1)
    cloud = rng.uniform(-5, 5, (1_000_000, 3)).astype(np.float32)
    kept = target.client.toolbox.upload_cloud(cloud)
    end, out, lock = time.monotonic() + target.seconds, Tried(), threading.Lock()

    def ask():
        with Client(target.server.grpc, timeout_s=0.02, retries=0) as client:
            while time.monotonic() < end:
                reason = refused(lambda: client.toolbox.remove_statistical_outliers(kept))
                with lock:
                    out.sent += 1
                    out.ended += reason not in ("", "DEADLINE_EXCEEDED", "CANCELLED")

    with ThreadPoolExecutor(16) as pool:
        for _ in range(16):
            pool.submit(ask)
    return out


def tiny_messages(target: Target) -> Tried:
    """10^5 messages of a few bytes on one stream, each wrong."""
    from percept.v1 import sensors_service_pb2 as service

    request = service.StreamFramesRequest()
    request.message.session_id, request.message.sensor_id = target.session_id, "laser"
    data = request.SerializeToString()
    count = target.many(100_000)
    with raw.Calls(target.server.grpc) as calls:
        stream = calls.channel.stream_stream("/percept.v1.SensorsService/StreamFrames")
        answers = sum(1 for _ in stream(iter([data] * count), timeout=120))
    return Tried(count, answers, "each is answered" if answers >= count else "not all are answered")


ALL = [
    image_bombs,
    laz_bombs,
    gzip_bombs,
    nested_json,
    zenoh_flood,
    zenoh_sizes,
    dns_rebinding,
    path_traversal,
    guessed_handles,
    hogged_toolbox,
    tiny_messages,
]

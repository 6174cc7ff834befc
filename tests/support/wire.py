"""Bytes as an attacker writes them: HTTP by hand over sockets, only to 127.0.0.1."""

from __future__ import annotations

import contextlib
import socket
import struct

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
#: Longest wait for the other side.
PATIENCE_S = 30.0

DATA, HEADERS, RST_STREAM, SETTINGS, GOAWAY = 0, 1, 3, 4, 7
END_STREAM, END_HEADERS, ACK = 1, 4, 1


def connect(address: str) -> socket.socket:
    """A connection to host:port."""
    host, port = address.rsplit(":", 1)
    assert host == "127.0.0.1", host
    return socket.create_connection((host, int(port)), timeout=PATIENCE_S)


def ends(sock: socket.socket) -> bytes:
    """What comes until the other side closes; a reset is an end, too."""
    parts = []
    with contextlib.suppress(ConnectionError):
        while part := sock.recv(65536):
            parts.append(part)
    return b"".join(parts)


def answer(address: str, request: bytes) -> tuple[int, str]:
    """Status and head of the answer to a request written by hand, which ends with the connection."""
    with connect(address) as sock:
        sock.sendall(request)
        text = ends(sock).decode(errors="replace")
    return int(text.split(" ", 2)[1]), text


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    """A frame of HTTP/2 (RFC 9113, section 4.1)."""
    return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + payload


def headers(path: str, **more: str) -> bytes:
    """Headers of a gRPC call, none of them indexed (RFC 7541, section 6.2.2)."""
    fields = {
        ":method": "POST",
        ":scheme": "http",
        ":path": path,
        ":authority": "127.0.0.1",
        "content-type": "application/grpc",
        "te": "trailers",
    } | {name.replace("_", "-"): value for name, value in more.items()}
    text = [(bytes([len(x)]) + x.encode()) for pair in fields.items() for x in pair]
    return b"".join(b"\0" + name + value for name, value in zip(text[::2], text[1::2], strict=True))


def call(path: str, body: bytes, *, end: bool = False, stream: int = 1, **more: str) -> bytes:
    """Frames of a call with a body, or with the beginning of one."""
    parts = [body[i : i + 16384] for i in range(0, len(body), 16384)] or [b""]
    data = b"".join(
        frame(DATA, END_STREAM if end and i == len(parts) - 1 else 0, stream, part) for i, part in enumerate(parts)
    )
    return frame(HEADERS, END_HEADERS, stream, headers(path, **more)) + data


def http2(address: str) -> socket.socket:
    """A connection that has said its preface."""
    sock = connect(address)
    sock.sendall(PREFACE + frame(SETTINGS, 0, 0) + frame(SETTINGS, ACK, 0))
    return sock


def frames(sock: socket.socket):
    """Frames (kind, flags, stream, payload) as they come, until the other side closes."""
    kept = b""
    while True:
        with contextlib.suppress(ConnectionError):
            part = sock.recv(65536)
            kept += part
            while len(kept) >= 9:
                length = int.from_bytes(kept[:3], "big")
                if len(kept) < 9 + length:
                    break
                stream = int.from_bytes(kept[5:9], "big")
                yield kept[3], kept[4], stream, kept[9 : 9 + length]
                kept = kept[9 + length :]
            if part:
                continue
        return

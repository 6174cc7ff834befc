"""Many who watch one robot, one of them slow and one dead: what the others notice of these two.

    python heavy/watchers.py [--watchers 50] [--seconds 30] [--rate-hz 100]

A planar laser drives rounds; every watcher is told of all that happens in its session. First all read, then, in
another session, one takes an event a second and another's process is stopped in the middle of a message. Prints one
JSON object for each part: how long after its frame was sent a pose was with those that read (milliseconds), by how
much the server's memory grew, and what the slow one got: events, and how often it was told that some were lost.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import pathlib
import signal
import sys
import tempfile
import time

import grpc
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client
from percept.v1 import sessions_service_pb2

from support import robots, world
from support.measure import peak_mb, reset_peak, rss_mb
from support.server import Server

WATCH = "/percept.v1.SessionsService/WatchSession"
#: Of those who do not read: little is kept on the way.
NARROW = [("grpc.http2.lookahead_bytes", 4096), ("grpc.use_local_subchannel_pool", 1)]
#: Processes that play those who read.
READERS = 2


async def events(address: str, session_id: str, options=()):
    """Events of a session, from now on."""
    async with grpc.aio.insecure_channel(address, options) as channel:
        watch = channel.unary_stream(
            WATCH,
            request_serializer=sessions_service_pb2.WatchSessionRequest.SerializeToString,
            response_deserializer=sessions_service_pb2.WatchSessionResponse.FromString,
        )
        async for response in watch(sessions_service_pb2.WatchSessionRequest(session_id=session_id)):
            yield response.event


async def read(address: str, session_id: str, last_ns: int, came: list) -> None:
    """Notes when each pose came, until the last one has."""
    async for event in events(address, session_id, [("grpc.use_local_subchannel_pool", 1)]):
        assert event.WhichOneof("event") != "resync", "a watcher that reads lost events"
        if event.HasField("pose"):
            came.append((event.stamp_ns, time.monotonic()))
            if event.stamp_ns >= last_ns:
                return


def play(address: str, session_id: str, last_ns: int, count: int, results) -> None:
    """A process of watchers that read."""

    async def all_of_them() -> list:
        came: list = []
        await asyncio.gather(*(read(address, session_id, last_ns, came) for _ in range(count)))
        return came

    results.put(asyncio.run(all_of_them()))


def be_slow(address: str, session_id: str, got) -> None:
    """An event a second."""

    async def watch() -> None:
        async for event in events(address, session_id, NARROW):
            got[0] += 1
            got[1] += event.WhichOneof("event") == "resync"
            await asyncio.sleep(1)

    asyncio.run(watch())


def be_dead(address: str, session_id: str) -> None:
    """Stopped with its link open."""

    async def watch() -> None:
        async for _ in events(address, session_id, NARROW):
            os.kill(os.getpid(), signal.SIGSTOP)

    asyncio.run(watch())


def part(server: Server, arguments, session_id: str, are_all_well: bool) -> dict:
    """One drive with everybody watching."""
    count = int(arguments.seconds * arguments.rate_hz)
    # gRPC does not survive a fork.
    context = multiprocessing.get_context("spawn")
    results, got = context.Queue(), context.Array("q", 2)
    with Client(server.grpc) as client:
        session = client.sessions.create(session_id, sensors=[world.LASER])
        num_reading = arguments.watchers - (0 if are_all_well else 2)
        shares = [num_reading // READERS + (i < num_reading % READERS) for i in range(READERS)]
        common = (server.grpc, session_id)
        readers = [
            context.Process(target=play, args=(*common, world.stamp(count - 1), share, results)) for share in shares
        ]
        others = []
        if not are_all_well:
            others = [
                context.Process(target=be_slow, args=(*common, got), daemon=True),
                context.Process(target=be_dead, args=common, daemon=True),
            ]
        for process in [*readers, *others]:
            process.start()
        # They are there once each process has imported what it needs and called.
        time.sleep(4)
        reset_peak(server.process.pid)
        before, sent_at, begin = rss_mb(server.process.pid), {}, time.monotonic()
        with session.stream() as stream:
            for i in range(count):
                time.sleep(max(begin + i / arguments.rate_hz - time.monotonic(), 0))
                sent_at[world.stamp(i)] = time.monotonic()
                stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
        came = [pair for _ in readers for pair in results.get(timeout=120)]
        for reader in readers:
            reader.join()
        for other in others:
            other.kill()
    waited = [(at - sent_at[stamp]) * 1000 for stamp, at in came]
    p50, p99, worst = np.quantile(waited, [0.5, 0.99, 1.0])
    out = {
        "watchers_that_read": num_reading,
        "poses": len(came),
        "missing": num_reading * count - len(came),
        "pose_ms": {"p50": round(p50, 2), "p99": round(p99, 2), "max": round(worst, 2)},
        "memory_grew_mb": round(peak_mb(server.process.pid) - before, 1),
    }
    if not are_all_well:
        out["slow_one"] = {"events": got[0], "told_of_loss": got[1]}
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--watchers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--rate-hz", type=float, default=100)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data")
        for i in range(len(robots.laps())):
            robots.scan(i)
        out = {
            "all_read": part(server, arguments, "well", are_all_well=True),
            "one_slow_one_dead": part(server, arguments, "not-all-well", are_all_well=False),
        }
        out["exit_code"] = server.stop()
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()

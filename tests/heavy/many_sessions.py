"""A store with very many sessions: how long it takes to start, to list, to wake, and what it keeps in memory.

    python heavy/many_sessions.py [--sessions 10000] [--woken 1000] [--rooms 4] [--seconds 60]

Creates the sessions, gives a map to `--maps` of them by `percept sim`, starts the server again and reports:
time until it is ready, a page of the list (100 sessions) at p50 and p99, memory by sleeping session, and
then, waking `--woken` of them in turn (those with maps first), memory and time. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import grpc
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept.v1 import sessions_service_pb2 as service

from support import raw
from support.measure import cpu_s, disk_bytes, peak_mb, rss_kb
from support.server import Server, binary

CREATE, LIST = "SessionsService/CreateSession", "SessionsService/ListSessions"
#: Creations under way at once.
AT_ONCE = 64


def quantiles(ms) -> dict[str, float]:
    p50, p99, worst = np.quantile(ms, [0.5, 0.99, 1.0])
    return {
        "p50": round(float(p50), 2),
        "p99": round(float(p99), 2),
        "max": round(float(worst), 2),
        "n": len(ms),
    }


async def create(address: str, count: int) -> list[float]:
    """Creates; milliseconds of each."""
    took, numbers = [], iter(range(count))

    async def worker(call):
        for k in numbers:
            begin = time.perf_counter()
            await call(service.CreateSessionRequest(session_id=f"s{k:06}"), timeout=60)
            took.append((time.perf_counter() - begin) * 1000)

    async with grpc.aio.insecure_channel(address) as channel:
        call = channel.unary_unary(
            f"/percept.v1.{CREATE}",
            request_serializer=service.CreateSessionRequest.SerializeToString,
            response_deserializer=service.CreateSessionResponse.FromString,
        )
        await asyncio.gather(*[worker(call) for _ in range(AT_ONCE)])
    return took


def give_maps(server: Server, count: int, rooms: int, seconds: float) -> list[str]:
    """Simulated robots drive through their rooms, each in a session of its own."""
    names = [f"map{k:04}" for k in range(count)]
    for k, name in enumerate(names):
        command = [
            binary(),
            "sim",
            "--server",
            f"http://{server.grpc}",
            "--session",
            name,
            "--rooms",
            str(rooms),
        ]
        command += ["--seed", str(k + 1), "--sensors", "lidar2d", "--duration-s", str(seconds)]
        subprocess.run(command, check=True, capture_output=True)
    return names


def restart(server: Server) -> float:
    """Seconds until the doors are open."""
    begin = time.perf_counter()
    server.start()
    return time.perf_counter() - begin


def list_pages(calls: raw.Calls, page_size: int) -> tuple[int, list[float]]:
    """How many sessions there are, and milliseconds of each page."""
    seen, took, token = 0, [], ""
    while True:
        begin = time.perf_counter()
        answer = calls(LIST, page_size=page_size, page_token=token)
        took.append((time.perf_counter() - begin) * 1000)
        assert answer.ok, answer
        seen += len(answer.message.sessions)
        token = answer.message.next_page_token
        if not token:
            return seen, took


def wake(calls: raw.Calls, names: list[str]) -> list[float]:
    took = []
    for name in names:
        begin = time.perf_counter()
        answer = calls("SessionsService/GetPose", timeout_s=120, session_id=name)
        took.append((time.perf_counter() - begin) * 1000)
        assert answer.ok, answer
    return took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10_000)
    parser.add_argument("--maps", type=int, default=20, help="of them, so many with a map")
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=60, help="that each simulated robot drives")
    parser.add_argument("--woken", type=int, default=1000)
    parser.add_argument("--page-size", type=int, default=100)
    parser.add_argument("--config", help="configuration file for the server")
    parser.add_argument("--data-dir", help="keep the store here, and use it again if it is there")
    arguments = parser.parse_args()
    extra = ("--config", arguments.config) if arguments.config else ()
    out: dict[str, object] = {"sessions": arguments.sessions, "maps": arguments.maps}
    with tempfile.TemporaryDirectory() as folder:
        data = pathlib.Path(arguments.data_dir or folder) / "data"
        there = data.exists()
        server = Server(data, *extra)
        plain = arguments.sessions - arguments.maps
        if not there:
            # The memory of a server that has nothing yet.
            out["empty_rss_kb"] = empty_kb = rss_kb(server.process.pid)
            begin = time.perf_counter()
            out["create_ms"] = quantiles(asyncio.run(create(server.grpc, plain)))
            out["created_per_s"] = round(plain / (time.perf_counter() - begin), 1)
            out["created_rss_mb"] = round(rss_kb(server.process.pid) / 1024, 1)
            give_maps(server, arguments.maps, arguments.rooms, arguments.seconds)
        begin = time.perf_counter()
        out["stop_exit_code"] = server.stop()
        out["stop_s"] = round(time.perf_counter() - begin, 2)
        out["disk_mb"] = round(disk_bytes(data) / 2**20, 1)
        out["start_s"] = round(restart(server), 3)
        pid = server.process.pid
        asleep_kb = rss_kb(pid)
        if not there:
            out["rss_kb_per_sleeping_session"] = round((asleep_kb - empty_kb) / arguments.sessions, 2)
        out["started_rss_mb"] = round(asleep_kb / 1024, 1)
        with raw.Calls(server.grpc) as calls:
            seen, took = list_pages(calls, arguments.page_size)
            assert seen == arguments.sessions, f"{seen} of {arguments.sessions} are listed"
            out["first_list_ms_per_page"] = quantiles(took)
            out["listed_rss_mb"] = round(rss_kb(pid) / 1024, 1)
            out["second_list_ms_per_page"] = quantiles(list_pages(calls, arguments.page_size)[1])
        # Whatever listing did to them, they sleep again.
        server.kill()
        out["start_after_kill_s"] = round(restart(server), 3)
        pid = server.process.pid
        with raw.Calls(server.grpc) as calls:
            cpu = cpu_s(pid)
            maps = [f"map{k:04}" for k in range(arguments.maps)]
            out["wake_map_ms"] = quantiles(wake(calls, maps))
            out["woken_maps_rss_mb"] = round(rss_kb(pid) / 1024, 1)
            rest = [f"s{k:06}" for k in range(min(arguments.woken - len(maps), plain))]
            out["wake_empty_ms"] = quantiles(wake(calls, rest))
            out["woken_all_rss_mb"] = round(rss_kb(pid) / 1024, 1)
            out["awake_pose_ms"] = quantiles(wake(calls, maps))
            out["wake_cpu_s"] = round(cpu_s(pid) - cpu, 2)
        out["peak_rss_mb"] = round(peak_mb(pid), 1)
        begin = time.perf_counter()
        out["last_stop_exit_code"] = server.stop()
        out["last_stop_s"] = round(time.perf_counter() - begin, 2)
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()

"""Many robots stream into one server at once; what each gets, and how others fare meanwhile.

    python heavy/fleet.py [--robots 64] [--seconds 60] [--rate-hz 10] [--sensor KIND] [--flood]
    [--overload]

Each robot has a session and a stream of its own and drives a round through the room, from where it stands in
it, with frames rendered before the start. Prints one JSON object:

- `offered`, `accepted`, `rejected`, `durable`: frames; `lost`: accepted, and not durable once the stream has
  ended
- `share`: least accepted by a robot over most, 1 is fair
- `ack_ms`: from sending a frame to its acknowledgement; `pose_ms`: another client's question meanwhile
- `server_cpu_ms_per_frame`, and `robots_per_core`: robots of this sensor and rate that one core keeps up with

`--overload` sends as fast as the server takes. `--flood` runs twice, the second time with one robot more
that sends as fast as it can, and tells what it does to the others.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import pathlib
import sys
import tempfile
import time
from dataclasses import dataclass

import grpc
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client
from percept.v1 import sensor_pb2, sensors_service_pb2

from support import robots, world
from support.measure import PoseProbe, cpu_s, peak_mb
from support.server import Server

STREAM = "/percept.v1.SensorsService/StreamFrames"
#: Frames that a robot has under way at most.
WINDOW = 8
FRAMES = 180


@dataclass
class Outcome:
    """What became of one robot's stream."""

    offered: int = 0
    accepted: int = 0
    #: Accepted before the time was up; what is left of the window comes after.
    in_time: int = 0
    rejected: int = 0
    durable: int = 0
    reason: str = ""
    ack_ms: list[float] | None = None


def body(sensor: str, index: int) -> bytes:
    """A frame's data, encoded once; what differs by robot is appended, which protobuf takes as one
    message.
    """
    if sensor == "laser":
        scan = robots.scan(index)
        scan = sensor_pb2.LaserScan(**{**scan, "ranges_m": scan["ranges_m"].tobytes()})
        return sensor_pb2.SensorMessage(sensor_id=sensor, scan=scan).SerializeToString()
    if sensor == "camera":
        depth = world.depth_image(robots.laps()[index])
        message = sensor_pb2.SensorMessage(sensor_id=sensor)
        message.depth.width_px, message.depth.height_px = depth.shape[1], depth.shape[0]
        message.depth.encoding, message.depth.metres_per_unit = sensor_pb2.DEPTH_ENCODING_U16, 0.001
        message.depth.data = depth.tobytes()
        return message.SerializeToString()
    points = robots.sweep(index)
    cloud = sensor_pb2.SensorMessage(sensor_id=sensor)
    cloud.cloud.num_points, cloud.cloud.positions = len(points), points.tobytes()
    return cloud.SerializeToString()


def request(body_: bytes, session_id: str, sequence: int, stamp_ns: int) -> bytes:
    """A StreamFramesRequest around a body."""
    own = sensor_pb2.SensorMessage(session_id=session_id, sequence=sequence, stamp_ns=stamp_ns)
    message = body_ + own.SerializeToString()
    size, length = len(message), b""
    while size >= 128:
        length, size = length + bytes([size % 128 + 128]), size // 128
    return b"\x0a" + length + bytes([size]) + message


async def robot(channel, bodies, session_id, number, begin, seconds, period_s) -> Outcome:
    """Streams at its rate (period 0: as fast as taken) until the time is up, then waits for the rest."""
    out, sent_at, window = Outcome(ack_ms=[]), {}, asyncio.Semaphore(WINDOW)
    stream = channel.stream_stream(
        STREAM,
        request_serializer=lambda b: b,
        response_deserializer=sensors_service_pb2.StreamFramesResponse.FromString,
    )()
    end = begin + seconds

    async def read():
        async for answer in stream:
            ack = answer.ack
            out.durable = max(out.durable, ack.durable_count)
            outcome = ack.WhichOneof("outcome")
            if outcome is None:
                continue
            now = time.monotonic()
            out.ack_ms.append((now - sent_at.pop(ack.sequence)) * 1000)
            if outcome == "result":
                out.accepted += 1
                out.in_time += now <= end
            else:
                out.rejected += 1
                out.reason = ack.rejection.reason
            window.release()

    reading = asyncio.create_task(read())
    # Robots are not in step: each begins elsewhere in the round, and between the others' frames.
    share = number * 0.618 % 1
    phase, start = share * period_s, int(share * len(bodies))
    try:
        await asyncio.sleep(max(begin + phase - time.monotonic(), 0))
        while (now := time.monotonic()) < end and not reading.done():
            out.offered += 1
            await window.acquire()
            sent_at[out.offered] = time.monotonic()
            data = bodies[(out.offered + start) % len(bodies)]
            await stream.write(request(data, session_id, out.offered, out.offered * 100_000_000))
            if period_s:
                await asyncio.sleep(max(begin + phase + out.offered * period_s - time.monotonic(), 0))
            elif now == end:
                break
        await stream.done_writing()
        await reading
    except (grpc.aio.AioRpcError, grpc.aio.UsageError, asyncio.InvalidStateError) as error:
        out.reason = str(error)[:200]
    return out


def feed(address, sensor, jobs, seconds, ready, begin_at, results) -> None:
    """A process that plays some of the robots: (session, number, period) each."""
    if any(period == 0 for _, _, period in jobs):
        # Who floods has a computer of its own: here it gets what the others leave.
        os.nice(19)
    bodies = [body(sensor, i) for i in range(FRAMES)]
    ready.wait()
    while not begin_at.value:
        time.sleep(0.01)
    begin = begin_at.value

    async def all_robots():
        async with grpc.aio.insecure_channel(address, [("grpc.use_local_subchannel_pool", 1)]) as channel:
            await channel.channel_ready()
            tasks = [robot(channel, bodies, s, n, begin, seconds, period) for s, n, period in jobs]
            return await asyncio.gather(*tasks)

    results.put([(job[0], outcome) for job, outcome in zip(jobs, asyncio.run(all_robots()), strict=True)])


def run(server: Server, arguments, tag: str, flood: bool) -> dict:
    """One measurement: all robots at once."""
    spec = {"laser": world.LASER, "lidar": world.LIDAR, "camera": world.CAMERA}[arguments.sensor]
    period = 0.0 if arguments.overload else 1 / arguments.rate_hz
    names = [f"{tag}-{i:03}" for i in range(arguments.robots)]
    with Client(server.grpc) as client:
        for name in [*names, f"{tag}-flood", f"{tag}-watched"]:
            client.sessions.create(name, sensors=[spec])
    jobs = [(name, i, period) for i, name in enumerate(names)]
    shares = [jobs[i :: arguments.feeders] for i in range(arguments.feeders)]
    if flood:
        shares.append([(f"{tag}-flood", 0, 0.0)])
    # gRPC does not survive a fork.
    context = multiprocessing.get_context("spawn")
    shares = [share for share in shares if share]
    results, ready, begin_at = context.Queue(), context.Barrier(len(shares) + 1), context.Value("d", 0.0)
    common = (arguments.seconds, ready, begin_at, results)
    feeders = [context.Process(target=feed, args=(server.grpc, arguments.sensor, s, *common)) for s in shares]
    for feeder in feeders:
        feeder.start()
    pid = server.process.pid
    ready.wait()
    begin = begin_at.value = time.monotonic() + 0.5
    time.sleep(max(begin - time.monotonic(), 0))
    cpu_before = cpu_s(pid)
    with PoseProbe(server.grpc, names[0], pause_s=0.02) as probe:
        time.sleep(arguments.seconds)
    cpu = cpu_s(pid) - cpu_before
    outcomes = dict(pair for _ in feeders for pair in results.get(timeout=arguments.seconds + 120))
    for feeder in feeders:
        feeder.join()
    flooding = outcomes.pop(f"{tag}-flood", None)
    return report(arguments, list(outcomes.values()), flooding, probe, cpu, pid)


def report(arguments, fleet, flooding, probe, cpu, pid) -> dict:
    taken = [o.in_time for o in fleet]
    total = sum(taken) + (flooding.in_time if flooding else 0)
    cpu_ms = cpu / max(total, 1) * 1000
    acks = np.array([ms for o in fleet for ms in o.ack_ms] or [np.nan])
    out = {
        "robots": arguments.robots,
        "sensor": arguments.sensor,
        "rate_hz": "as taken" if arguments.overload else arguments.rate_hz,
        "offered": sum(o.offered for o in fleet),
        "accepted": sum(o.accepted for o in fleet),
        "rejected": sum(o.rejected for o in fleet),
        "durable": sum(o.durable for o in fleet),
        "lost": sum(o.accepted + o.rejected - o.durable for o in fleet),
        "share": round(min(taken) / max(max(taken), 1), 3),
        "frames_per_s": round(total / arguments.seconds, 1),
        "ack_ms": {f"p{q}": round(float(np.quantile(acks, q / 100)), 1) for q in (50, 99)},
        "pose_ms": probe.quantiles(),
        "pose_p99_ms_by_tenth": probe.p99_by_tenth(),
        "server_cores": round(cpu / arguments.seconds, 2),
        "server_cpu_ms_per_frame": round(cpu_ms, 3),
        "robots_per_core": round(1000 / cpu_ms / arguments.rate_hz, 1),
        "server_peak_rss_mb": round(peak_mb(pid), 1),
    }
    failed = sorted({o.reason for o in fleet if o.reason})
    if failed:
        out["reasons"] = failed[:5]
    if flooding:
        out["flood"] = {
            "accepted": flooding.in_time,
            "rejected": flooding.rejected,
            "reason": flooding.reason,
        }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rate-hz", type=float, default=10)
    parser.add_argument("--sensor", choices=["laser", "lidar", "camera"], default="laser")
    parser.add_argument("--overload", action="store_true", help="as fast as the server takes, to see the shares")
    parser.add_argument("--flood", action="store_true", help="again, with one more that sends as fast as it can")
    parser.add_argument("--feeders", type=int, default=2, help="processes that play the robots")
    parser.add_argument("--config", help="configuration file for the server")
    arguments = parser.parse_args()
    extra = ("--config", arguments.config) if arguments.config else ()
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data", *extra)
        out = {"calm": run(server, arguments, "calm", flood=False)}
        if arguments.flood:
            out["flooded"] = run(server, arguments, "flooded", flood=True)
            for what in ("ack_ms", "pose_ms"):
                ratio = out["flooded"][what]["p99"] / out["calm"][what]["p99"]
                out[f"{what}_p99_grown_to"] = round(ratio, 2)
        out["exit_code"] = server.stop()
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()

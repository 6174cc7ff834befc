"""How much of the bare transport's rate a stream into the server reaches: the same bytes, the same sender.

    python heavy/throughput.py [--frames 400] [--rounds 3]

RGB-D of 640x480 (1.5 MB a frame, uncompressed) and clouds of 130,000 points (1.6 MB), encoded once, go over gRPC
and zenoh, with shared memory as well, to a session that decodes, checks and counts them, and to a process that
only receives: a gRPC service that acknowledges each message undecoded, a zenoh subscriber that counts. Turn by
turn, so that both meet the same machine. Prints one JSON object: frames a second, the best of the rounds each,
and the share.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import pathlib
import sys
import tempfile
import time
from concurrent import futures

import grpc
import numpy as np
import zenoh
import zenoh.shm

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import CameraIntrinsics, Client, Pose, SensorSpec
from percept.v1 import sensor_pb2, sensors_service_pb2

from support import world
from support.server import Server, free_port

STREAM = "/percept.v1.SensorsService/StreamFrames"
#: Frames under way over gRPC at most.
WINDOW = 16
#: Different ones, so that no cache holds what is sent.
BODIES = 8
NUM_POINTS = 130_000
#: Of shared memory, beyond what is under way.
POOL_BYTES = 64 << 20
VGA = CameraIntrinsics(width_px=640, height_px=480, fx_px=585.0, fy_px=585.0, cx_px=320.0, cy_px=240.0)
SENSORS = {
    "rgbd": SensorSpec(
        "rgbd",
        kind="rgbd",
        intrinsics=VGA,
        t_base_sensor=Pose(rotation=world.OPTICAL),
        overload_policy="block",
    ),
    "cloud": SensorSpec("cloud", kind="lidar3d", overload_policy="block"),
}


def messages(sensor: str, session_id: str, count: int) -> list[bytes]:
    """Frames as SensorMessage; what differs by frame is appended, which protobuf takes as one message."""
    rng, bodies = np.random.default_rng(1), []
    for _ in range(BODIES):
        body = sensor_pb2.SensorMessage(session_id=session_id, sensor_id=sensor)
        if sensor == "rgbd":
            depth, colour = body.rgbd.depth, body.rgbd.colour
            depth.width_px, depth.height_px = colour.width_px, colour.height_px = 640, 480
            depth.encoding, depth.metres_per_unit = sensor_pb2.DEPTH_ENCODING_U16, 0.001
            depth.data = rng.integers(500, 4000, (480, 640), dtype=np.uint16).tobytes()
            colour.encoding = sensor_pb2.COLOUR_ENCODING_RGB8
            colour.data = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8).tobytes()
        else:
            body.cloud.num_points = NUM_POINTS
            body.cloud.positions = rng.uniform(-40, 40, (NUM_POINTS, 3)).astype(np.float32).tobytes()
        bodies.append(body.SerializeToString())
    ends = [sensor_pb2.SensorMessage(stamp_ns=i * 10**6, sequence=i) for i in range(1, count + 1)]
    return [bodies[i % BODIES] + end.SerializeToString() for i, end in enumerate(ends)]


def framed(message: bytes) -> bytes:
    """A StreamFramesRequest around a message."""
    size, length = len(message), b""
    while size >= 128:
        length, size = length + bytes([size % 128 + 128]), size // 128
    return b"\x0a" + length + bytes([size]) + message


async def over_grpc(address: str, requests: list[bytes]) -> float:
    """Seconds until the last frame is acknowledged."""
    window, num_acks = asyncio.Semaphore(WINDOW), 0
    async with grpc.aio.insecure_channel(address) as channel:
        await channel.channel_ready()
        stream = channel.stream_stream(STREAM, request_serializer=None, response_deserializer=None)()
        begin = time.perf_counter()

        async def read() -> None:
            nonlocal num_acks
            async for answer in stream:
                ack = sensors_service_pb2.StreamFramesResponse.FromString(answer).ack
                if ack.WhichOneof("outcome"):
                    assert ack.WhichOneof("outcome") == "result", ack
                    num_acks += 1
                    window.release()

        reading = asyncio.create_task(read())
        for request in requests:
            await window.acquire()
            await stream.write(request)
        await stream.done_writing()
        await reading
    assert num_acks == len(requests), num_acks
    return time.perf_counter() - begin


def bare_grpc(port, ready) -> None:
    """Acknowledges whatever comes, undecoded."""

    def answer(requests, _):
        for number, _request in enumerate(requests, 1):
            ack = sensors_service_pb2.StreamFramesResponse()
            ack.ack.sequence, ack.ack.durable_count = number, number
            ack.ack.result.SetInParent()
            yield ack.SerializeToString()

    server = grpc.server(futures.ThreadPoolExecutor(2))
    method = grpc.stream_stream_rpc_method_handler(answer)
    service = {"StreamFrames": method}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("percept.v1.SensorsService", service),))
    port.value = server.add_insecure_port("127.0.0.1:0")
    server.start()
    ready.set()
    server.wait_for_termination()


def peer(listen: str = "", connect: str = "") -> zenoh.Session:
    """A peer that meets nobody but who is named."""
    config = zenoh.Config()
    settings = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
        "transport/shared_memory/enabled": True,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def bare_zenoh(endpoint: str, counted, ready) -> None:
    """Counts what comes."""

    def take(sample) -> None:
        # What lies in shared memory is not copied, as a reader in Rust would not.
        if len(sample.payload):
            counted.value += 1

    with peer(listen=endpoint) as session:
        subscriber = session.declare_subscriber("percept/**", take)
        ready.set()
        time.sleep(10**6)
        subscriber.undeclare()


def over_zenoh(endpoint: str, key: str, payloads: list[bytes], is_shared: bool, num_taken) -> float:
    """Seconds until the receiver has counted the last frame."""
    with peer(connect=endpoint) as session:
        publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE
        )
        while not publisher.matching_status.matching:
            time.sleep(0.005)
        pool = zenoh.shm.ShmProvider.default_backend(POOL_BYTES) if is_shared else None
        before, begin = num_taken(), time.perf_counter()
        for payload in payloads:
            if pool is None:
                publisher.put(payload)
                continue
            room = pool.alloc(len(payload), policy=zenoh.shm.BlockOn(zenoh.shm.GarbageCollect()))
            room[:] = payload
            publisher.put(room)
        while num_taken() < before + len(payloads):
            time.sleep(0.001)
        return time.perf_counter() - begin


class Bare:
    """The processes that only receive."""

    def __init__(self) -> None:
        # gRPC does not survive a fork.
        context = multiprocessing.get_context("spawn")
        self._port, self._counted = context.Value("i", 0), context.Value("q", 0)
        self.zenoh = f"tcp/127.0.0.1:{free_port()}"
        ready = [context.Event(), context.Event()]
        self._processes = [
            context.Process(target=bare_grpc, args=(self._port, ready[0]), daemon=True),
            context.Process(target=bare_zenoh, args=(self.zenoh, self._counted, ready[1]), daemon=True),
        ]
        for process in self._processes:
            process.start()
        assert all(event.wait(30) for event in ready)

    @property
    def grpc(self) -> str:
        """Address."""
        return f"127.0.0.1:{self._port.value}"

    def num_taken(self) -> int:
        """Of zenoh."""
        return self._counted.value


def rates(server: Server, client: Client, bare: Bare, way: str, sensor: str, count: int) -> tuple[float, float]:
    """Frames a second: the server's, the bare transport's."""
    session = client.sessions.create(mode="ingest_only", sensors=[SENSORS[sensor]])
    frames = messages(sensor, session.session_id, count)

    def num_taken() -> int:
        status = session.sensors.list()[0]
        assert (status.rejected, status.dropped, status.gaps) == (0, 0, 0), status
        return status.accepted

    if way == "grpc":
        requests = [framed(frame) for frame in frames]
        seconds = asyncio.run(over_grpc(server.grpc, requests)), asyncio.run(over_grpc(bare.grpc, requests))
    else:
        key, is_shared = f"percept/{session.session_id}/{sensor}/frame", way == "zenoh_shared_memory"
        seconds = (
            over_zenoh(server.zenoh, key, frames, is_shared, num_taken),
            over_zenoh(bare.zenoh, key, frames, is_shared, bare.num_taken),
        )
    client.sessions.delete(session.session_id)
    return count / seconds[0], count / seconds[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        server, bare = Server(pathlib.Path(folder) / "data"), Bare()
        with Client(server.grpc) as client:
            for sensor in SENSORS:
                for way in ("grpc", "zenoh", "zenoh_shared_memory"):
                    rounds = [
                        rates(server, client, bare, way, sensor, arguments.frames) for _ in range(arguments.rounds)
                    ]
                    ours, theirs = (max(r[i] for r in rounds) for i in (0, 1))
                    out[f"{sensor}_{way}"] = {
                        "frames_per_s": round(ours, 1),
                        "bare_per_s": round(theirs, 1),
                        "share": round(ours / theirs, 3),
                    }
                    print(sensor, way, out[f"{sensor}_{way}"], file=sys.stderr)
        out["peak_mb"] = round(server.peak_rss_mb(), 1)
        out["exit_code"] = server.stop()
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()

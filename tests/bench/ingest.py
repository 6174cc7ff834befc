#!/usr/bin/env python3
"""Ingest rates and query latencies of a server on this machine; prints one JSON object.

    python bench/ingest.py [--frames N] [--slam-frames N]

Rates: 640x480 uint16 depth into a session that decodes, checks and counts (ingest_only), from the first frame
sent to the last one counted. Latencies: pose and whole grid, each asked for over and over by a client of its
own, while recorded frames (or, without them, rendered ones) stream in with SLAM on.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
import tempfile
import threading
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import CameraIntrinsics, Client, EncodedImage, Pose, SensorSpec
from percept.zenoh import SensorPublisher

from support import world
from support.server import Server, recorded

VGA = CameraIntrinsics(width_px=640, height_px=480, fx_px=585.0, fy_px=585.0, cx_px=320.0, cy_px=240.0)
BASE = Pose(rotation=world.OPTICAL)


def ingest_session(client):
    camera = SensorSpec("camera", kind="depth", intrinsics=VGA, overload_policy="block")
    return client.sessions.create(mode="ingest_only", sensors=[camera])


def images():
    """Eight images that differ, so that nothing is cached on the way."""
    rng = np.random.default_rng(1)
    return [rng.integers(500, 4000, (480, 640), dtype=np.uint16) for _ in range(8)]


def grpc_rate(client, count):
    session, depth = ingest_session(client), images()
    begin = time.perf_counter()
    with session.stream(max_in_flight=16) as stream:
        for i in range(count):
            stream.send_depth("camera", stamp_ns=i + 1, depth=depth[i % 8], metres_per_unit=0.001)
    seconds = time.perf_counter() - begin
    assert stream.summary.accepted == count, stream.summary
    return count / seconds


def zenoh_rate(server, client, count):
    session, depth = ingest_session(client), images()
    with SensorPublisher(server.zenoh, session_id=session.session_id) as publisher:
        # The first frame of a sensor waits until the server listens.
        publisher.send_depth("camera", stamp_ns=1, depth=depth[0], metres_per_unit=0.001)
        begin = time.perf_counter()
        for i in range(count):
            publisher.send_depth("camera", stamp_ns=i + 2, depth=depth[i % 8], metres_per_unit=0.001)
        while True:
            status = session.sensors.list()[0]
            if status.accepted + status.rejected + status.dropped >= count + 1:
                break
            time.sleep(0.001)
        seconds = time.perf_counter() - begin
    assert (status.rejected, status.dropped, status.gaps) == (0, 0, 0), status
    return count / seconds


def recorded_frames(count):
    folder = recorded("rgbd-7scenes-a")
    if folder is None:
        return None
    size = {"width_px": 640, "height_px": 480}
    out = []
    for path in sorted(folder.glob("frame-*.depth.png"))[:count]:
        colour = path.with_name(path.name.replace(".depth.png", ".color.jpg"))
        depth = EncodedImage(data=path.read_bytes(), **size)
        out.append((depth, EncodedImage(data=colour.read_bytes(), **size)))
    return out


def rendered_frames(count):
    colour = np.full((480, 640, 3), 128, np.uint8)
    return [(world.depth_image(pose, VGA), colour) for pose in world.drive(count)]


def latencies_ms(ask, stop):
    out = []
    while not stop.is_set():
        begin = time.perf_counter()
        ask()
        out.append((time.perf_counter() - begin) * 1000)
        time.sleep(0.005)
    return out


def quantiles(values):
    p50, p99, worst = np.quantile(values, [0.5, 0.99, 1.0])
    return {"p50": round(p50, 3), "p99": round(p99, 3), "max": round(worst, 3), "count": len(values)}


def under_slam(server, client, frames):
    camera = SensorSpec("camera", kind="rgbd", t_base_sensor=BASE, intrinsics=VGA, overload_policy="block")
    session = client.sessions.create(sensors=[camera])
    stop, found = threading.Event(), {}

    def measure(what):
        with Client(server.grpc) as other:
            mine = other.session(session.session_id)
            found[what] = latencies_ms({"pose": mine.pose, "grid": mine.map.occupancy}[what], stop)

    askers = [threading.Thread(target=measure, args=[what]) for what in ("pose", "grid")]
    for asker in askers:
        asker.start()
    begin = time.perf_counter()
    with session.stream(max_in_flight=16) as stream:
        for i, (depth, colour) in enumerate(frames):
            stream.send_rgbd(
                "camera", stamp_ns=(i * 2 * 10**9 + 15) // 30, depth=depth, colour=colour, metres_per_unit=0.001
            )
    seconds = time.perf_counter() - begin
    stop.set()
    for asker in askers:
        asker.join()
    assert stream.summary.accepted == len(frames), stream.summary
    return {
        "frames": len(frames),
        "frames_per_s": round(len(frames) / seconds, 2),
        "pose_ms": quantiles(found["pose"]),
        "grid_ms": quantiles(found["grid"]),
        "grid_cells": int(session.map.occupancy().cells.size),
        "server_peak_rss_mb": round(server.peak_rss_mb(), 1),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, default=600, help="frames of each rate")
    parser.add_argument("--slam-frames", type=int, default=200, help="frames streamed with SLAM on")
    arguments = parser.parse_args()
    report = {}
    with tempfile.TemporaryDirectory() as folder:
        # A server for each, so that peak memory is that of SLAM alone.
        server = Server(pathlib.Path(folder) / "rates")
        with Client(server.grpc) as client:
            grpc_rate(client, 50)
            report["grpc_depth_frames_per_s"] = round(grpc_rate(client, arguments.frames), 1)
            report["zenoh_depth_frames_per_s"] = round(zenoh_rate(server, client, arguments.frames), 1)
        server.stop()
        frames = recorded_frames(arguments.slam_frames)
        report["slam_input"] = "rendered" if frames is None else "rgbd-7scenes-a"
        server = Server(pathlib.Path(folder) / "slam")
        with Client(server.grpc) as client:
            report["under_slam"] = under_slam(server, client, frames or rendered_frames(arguments.slam_frames))
        server.stop()
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()

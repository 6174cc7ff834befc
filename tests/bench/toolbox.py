#!/usr/bin/env python3
"""What the gRPC door adds to the toolbox's operations on a large cloud; prints one JSON line an operation.

    python bench/toolbox.py [--points N] [--rounds N] [--ply FILE]

`server_ms` is the operation's own time on the server, as a pipeline of this one step tells it; `sent_ms`
the round trip of the call with the cloud in the request and its result in the answer, from numpy to numpy;
`kept_ms` the same with the cloud kept on the server. Medians of rounds that take turns; `added` is
(sent_ms - server_ms) / sent_ms.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
import tempfile
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client, Step

from support.server import Server

#: Operation and its parameters.
OPERATIONS = {
    "transform_cloud": {"t_a_b": np.eye(4)},
    "downsample_voxels": {"voxel_size_m": 0.05},
    "remove_statistical_outliers": {},
    "remove_radius_outliers": {"radius_m": 0.02, "min_neighbours": 5},
    "estimate_normals": {"radius_m": 0.05, "max_neighbours": 20},
    "segment_planes": {"max_planes": 4},
    "cluster_points": {"method": "dbscan", "eps_m": 0.03},
    "compute_shape_features": {},
}


def room(count):
    """Points on the inside of a room of 6 x 5 x 3 m with furniture, 2 mm of noise."""
    rng = np.random.default_rng(1)
    size = np.array([6.0, 5.0, 3.0])
    points = rng.uniform(0, 1, (count, 3)) * size
    axis = rng.integers(0, 3, count)
    side = rng.integers(0, 2, count)
    points[np.arange(count), axis] = side * size[axis]
    third = count // 3
    points[:third] = rng.uniform(0, 1, (third, 3)) * (1.2, 0.8, 0.7) + (2, 2, 0)
    return (points + rng.normal(0, 0.002, points.shape)).astype(np.float32)


def timed(call):
    begin = time.perf_counter()
    call()
    return (time.perf_counter() - begin) * 1e3


def measure(client, cloud, rounds):
    toolbox = client.toolbox
    kept = toolbox.upload_cloud(cloud)
    for operation, params in OPERATIONS.items():
        call = getattr(toolbox, operation)
        step = Step(operation, quiet=True, **params)
        server, sent, held = [], [], []
        for _ in range(rounds):
            server.append(toolbox.run_pipeline(kept, [step]).steps[0].elapsed_ms)
            sent.append(timed(lambda call=call, params=params: call(cloud, **params)))
            held.append(timed(lambda call=call, params=params: call(kept, **params)))
        server_ms, sent_ms, kept_ms = (float(np.median(x)) for x in (server, sent, held))
        yield {
            "operation": operation,
            "points": len(cloud),
            "server_ms": round(server_ms, 2),
            "sent_ms": round(sent_ms, 2),
            "kept_ms": round(kept_ms, 2),
            "added_ms": round(sent_ms - server_ms, 2),
            "added": round((sent_ms - server_ms) / sent_ms, 3),
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--ply", type=pathlib.Path, help="a cloud to take instead of a room of our own")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data")
        with Client(server.grpc, timeout_s=120) as client:
            if arguments.ply:
                cloud = client.toolbox.download_cloud(client.toolbox.upload_cloud(arguments.ply.read_bytes()))
            else:
                cloud = room(arguments.points)
            points = np.ascontiguousarray(getattr(cloud, "points", cloud))
            for line in measure(client, points, arguments.rounds):
                print(json.dumps(line), flush=True)
        server.stop()


if __name__ == "__main__":
    main()

"""How long questions wait while a simulated robot streams as fast as the server takes, and others compute.

    python heavy/latency.py [--seconds 30] [--toolbox 4]

Each question (pose, grid, cloud, scene graph, list of sessions) is asked over and over by a process of
its own, first while one robot streams at full speed, then while `--toolbox` callers filter a large cloud
as well. Prints one JSON object: p50, p99 and worst in milliseconds, and how many frames the robot got
through in each part.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client, PerceptError

from support.measure import cpu_s, peak_mb
from support.server import Server, binary, eventually

QUESTIONS = {
    "pose": lambda client, session: session.pose(),
    "grid": lambda client, session: session.map.occupancy(),
    "cloud": lambda client, session: session.map.cloud(),
    "scene_graph": lambda client, session: session.scene.graph(),
    "list": lambda client, session: list(client.sessions.list()),
}


def ask(address: str, what: str, until: float, results) -> None:
    """Asks until the time is up."""
    took, failed = [], 0
    with Client(address, retries=0) as client:
        session = client.session("robot")
        while time.monotonic() < until:
            begin = time.perf_counter()
            try:
                QUESTIONS[what](client, session)
                took.append((time.perf_counter() - begin) * 1000)
            except PerceptError:
                failed += 1
            time.sleep(0.02)
    p50, p99, worst = np.quantile(took, [0.5, 0.99, 1.0]) if took else [float("nan")] * 3
    named = {"p50": p50, "p99": p99, "max": worst}
    results.put((what, {k: round(float(v), 1) for k, v in named.items()} | {"n": len(took), "failed": failed}))


def compute(address: str, until: float, results) -> None:
    """Filters a cloud of half a million points over and over."""
    cloud, done, refused = np.random.default_rng(1).uniform(-5, 5, (500_000, 3)).astype(np.float32), 0, 0
    with Client(address, retries=0, timeout_s=60) as client:
        kept = client.toolbox.upload_cloud(cloud)
        while time.monotonic() < until:
            try:
                client.toolbox.remove_statistical_outliers(kept)
                done += 1
            except PerceptError:
                refused += 1
                time.sleep(0.1)
    results.put(("toolbox", {"done": done, "refused": refused}))


def part(server: Server, seconds: float, toolbox: int) -> dict:
    """One robot at full speed, and everybody's questions."""
    context = multiprocessing.get_context("spawn")
    command = [binary(), "sim", "--server", f"http://{server.grpc}", "--session", "robot", "--rooms", "4"]
    with Client(server.grpc) as client:
        command += ["--laps", "20"]
        robot = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            session = client.session("robot")
            assert eventually(lambda: _frames(session) > 20, seconds=30), "the robot does not stream"
            results = context.Queue()
            # Interpreters need a while to start.
            until = time.monotonic() + seconds + 3
            cpu, frames, begin = cpu_s(server.process.pid), _frames(session), time.monotonic()
            asking = [context.Process(target=ask, args=(server.grpc, q, until, results)) for q in QUESTIONS]
            busy = [context.Process(target=compute, args=(server.grpc, until, results)) for _ in range(toolbox)]
            for process in asking + busy:
                process.start()
            answers = [results.get(timeout=seconds + 120) for _ in asking + busy]
            for process in asking + busy:
                process.join()
            took = time.monotonic() - begin
            out = {what: found for what, found in answers if what != "toolbox"}
            out["frames_per_s"] = round((_frames(session) - frames) / took, 1)
            out["server_cores"] = round((cpu_s(server.process.pid) - cpu) / took, 2)
            if busy:
                calls = [found for what, found in answers if what == "toolbox"]
                out["toolbox_calls_per_s"] = round(sum(c["done"] for c in calls) / took, 2)
                out["toolbox_refused"] = sum(c["refused"] for c in calls)
        finally:
            robot.kill()
            robot.wait()
        session.delete()
    return out


def _frames(session) -> int:
    try:
        return sum(s.accepted for s in session.sensors.list())
    except PerceptError:
        return 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--toolbox", type=int, default=4, help="callers that compute in the second part")
    parser.add_argument("--config", help="configuration file for the server")
    arguments = parser.parse_args()
    extra = ("--config", arguments.config) if arguments.config else ()
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data", *extra)
        out = {"streaming": part(server, arguments.seconds, 0)}
        if arguments.toolbox:
            out["streaming_and_toolbox"] = part(server, arguments.seconds, arguments.toolbox)
        out["peak_rss_mb"] = round(peak_mb(server.process.pid), 1)
        out["exit_code"] = server.stop()
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()

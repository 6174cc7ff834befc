"""Sessions come and go for a long time; the server's memory, disk and descriptors must not grow.

    python heavy/soak.py [--minutes 120] [--alive 12] [--out soak.png]

A few sessions are alive at a time. Each is created, filled at some rate, asked for its pose, map and
objects, watched, and deleted after a random time, when another takes its place; a few are left asleep.
Memory is sampled every few seconds and plotted. Prints the slope over the second half, which is what counts:
the first fills caches.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import pathlib
import random
import sys
import tempfile
import threading
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client, PerceptError

from support import robots, world
from support.measure import disk_bytes, num_descriptors, rss_mb
from support.server import Server


class Life(threading.Thread):
    """Sessions one after the other, until told to stop."""

    def __init__(self, address: str, number: int, stop: threading.Event) -> None:
        super().__init__(daemon=True)
        self._address, self._number, self._stop_ = address, number, stop
        self._rng = random.Random(number)
        self.sessions = self.frames = 0
        self.errors: list[str] = []

    def run(self) -> None:
        with Client(self._address) as client:
            while not self._stop_.is_set():
                try:
                    self._one(client)
                    self.sessions += 1
                except PerceptError as error:
                    self.errors.append(str(error))

    def _one(self, client: Client) -> None:
        lidar = self._rng.random() < 0.3
        spec = world.LIDAR if lidar else world.LASER
        session = client.sessions.create(f"life{self._number}-{self.sessions}-{len(self.errors)}", sensors=[spec])
        with session.watch() as watch, session.stream() as stream:
            watching = threading.Thread(target=self._drain, args=(watch,), daemon=True)
            watching.start()
            for i in range(self._rng.randint(20, 180)):
                if self._stop_.is_set():
                    break
                if lidar:
                    stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=robots.sweep(i))
                else:
                    stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
                self.frames += 1
                if i % 10 == 9:
                    session.pose(), session.map.occupancy(), list(session.scene.objects())
                self._stop_.wait(0.02)
        session.delete()
        watching.join(timeout=10)

    @staticmethod
    def _drain(watch) -> None:
        with contextlib.suppress(PerceptError):
            for _ in watch:
                pass


def slope(minutes, values) -> float:
    """Least squares, units an hour."""
    if len(minutes) < 3:
        return float("nan")
    return float(np.polyfit(np.array(minutes) / 60, values, 1)[0])


def plot(samples, path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    minutes = [s["minute"] for s in samples]
    figure, axes = pyplot.subplots(3, 1, sharex=True, figsize=(9, 8))
    for axis, (key, label) in zip(
        axes, [("rss_mb", "resident, MB"), ("disk_mb", "disk, MB"), ("descriptors", "open files")]
    ):
        axis.plot(minutes, [s[key] for s in samples])
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("minutes")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--alive", type=int, default=12, help="sessions at a time")
    parser.add_argument("--asleep", type=int, default=20, help="sessions with a map that nobody uses")
    parser.add_argument("--every-s", type=float, default=5)
    parser.add_argument("--out", default="soak.png")
    parser.add_argument("--config", help="configuration file for the server")
    arguments = parser.parse_args()
    extra = ("--config", arguments.config) if arguments.config else ()
    for i in range(180):
        robots.scan(i), robots.sweep(i)
    samples: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data", *extra)
        pid = server.process.pid
        with Client(server.grpc) as client:
            for k in range(arguments.asleep):
                robots.mapped(client, f"asleep{k}", frames=60, phase=9 * k)
        stop = threading.Event()
        lives = [Life(server.grpc, k, stop) for k in range(arguments.alive)]
        for life in lives:
            life.start()
        begin = time.monotonic()
        while (minute := (time.monotonic() - begin) / 60) < arguments.minutes:
            sample = {
                "minute": minute,
                "rss_mb": rss_mb(pid),
                "disk_mb": disk_bytes(server.data_dir) / 2**20,
                "descriptors": num_descriptors(pid),
            }
            samples.append(sample)
            if len(samples) % 12 == 0:
                shown = " ".join(f"{k} {v:.1f}" for k, v in sample.items())
                print(f"{shown} sessions {sum(x.sessions for x in lives)}", file=sys.stderr)
            time.sleep(arguments.every_s)
        stop.set()
        for life in lives:
            life.join(timeout=60)
        exit_code = server.stop()
    late = [s for s in samples if s["minute"] > arguments.minutes / 2]
    minutes = [s["minute"] for s in late]
    report = {
        "minutes": arguments.minutes,
        "sessions": sum(x.sessions for x in lives),
        "frames": sum(x.frames for x in lives),
        "errors": sum(len(x.errors) for x in lives),
        "first_errors": [e for x in lives for e in x.errors][:5],
        **{
            f"{key}": {
                "first": round(samples[0][key], 1),
                "last": round(samples[-1][key], 1),
                "max": round(max(s[key] for s in samples), 1),
                "slope_per_hour": round(slope(minutes, [s[key] for s in late]), 2),
            }
            for key in ("rss_mb", "disk_mb", "descriptors")
        },
        "exit_code": exit_code,
        "plot": arguments.out,
    }
    plot(samples, arguments.out)
    print(json.dumps(report, indent=2))
    return 1 if report["errors"] or exit_code else 0


if __name__ == "__main__":
    sys.exit(main())

"""Tries every attack on a server of its own and prints what it did: memory, others' latency, log, what was
ended.

    python attacks/try_all.py [--only NAME ...] [--seconds 12] [--scale 1.0] [--json FILE] [--config FILE]

For each attack a server is started, a session filled, and another client asks for its pose over and over,
first in calm, then during the attack. `ended` counts what the server refused or cut off of what was sent;
`BROKEN` lines say what must not be possible. Exits with 1 if there are any, or a server died.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
import tempfile
import time
import traceback

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client

from attacks import connections, payloads
from attacks.connections import Target, Tried
from support import robots
from support.measure import PoseProbe, cpu_s, peak_mb, reset_peak, rss_mb
from support.server import Server

ATTACKS = [*connections.ALL, *payloads.ALL]
COLUMNS = "{:<22} {:>6} {:>6} {:>6}  {:>6} {:>7}  {:>6} {:>7}  {:>15}  {:>7} {:>8}  {}"


def tried(attack, arguments) -> dict:
    """One attack on a fresh server."""
    with tempfile.TemporaryDirectory() as folder:
        extra = ("--config", arguments.config) if arguments.config else ()
        server = Server(pathlib.Path(folder) / "data", *extra)
        pid = server.process.pid
        with Client(server.grpc) as client, PoseProbe(server.grpc, "victim") as probe:
            robots.mapped(client, "victim", frames=60)
            probe.restart()
            time.sleep(arguments.calm_s)
            calm, before = probe.quantiles(), rss_mb(pid)
            reset_peak(pid)
            probe.restart()
            target = Target(server, "victim", client, arguments.seconds, arguments.scale)
            log_before, cpu, begin = server.log.stat().st_size, cpu_s(pid), time.monotonic()
            try:
                result = attack(target)
            except Exception as error:
                result = Tried(note=f"the attack itself failed: {error!r}"[:200], broken=["not tried"])
                if arguments.verbose:
                    traceback.print_exc()
            took = time.monotonic() - begin
            alive = server.process.poll() is None
            during = probe.quantiles()
            log = server.log.read_bytes()[log_before:]
            out = {
                "attack": attack.__name__,
                "seconds": round(took, 1),
                "sent": result.sent,
                "ended": result.ended,
                "note": result.note,
                "broken": result.broken + ([] if alive else ["the server has died"]),
                "calm_ms": calm,
                "during_ms": during,
                "log_lines": log.count(b"\n"),
                "log_kb": round(len(log) / 1024, 1),
                "rss_before_mb": round(before, 1),
            }
            if alive:
                out["rss_peak_mb"], out["cpu_s"] = round(peak_mb(pid), 1), round(cpu_s(pid) - cpu, 1)
                time.sleep(arguments.calm_s)
                out["rss_after_mb"] = round(rss_mb(pid), 1)
        begin = time.monotonic()
        try:
            out["exit_code"] = server.stop() if alive else server.process.returncode
        except AssertionError:
            out["exit_code"] = "killed"
        out["stop_s"] = round(time.monotonic() - begin, 1)
        return out


def row(out) -> str:
    calm, during = out["calm_ms"], out["during_ms"]
    memory = [out.get(k, float("nan")) for k in ("rss_before_mb", "rss_peak_mb", "rss_after_mb")]
    failed = f" ({during['failed']} questions failed)" if during["failed"] else ""
    return COLUMNS.format(
        out["attack"],
        *(f"{m:.0f}" for m in memory),
        f"{calm['p50']:.1f}",
        f"{calm['p99']:.1f}",
        f"{during['p50']:.1f}",
        f"{during['p99']:.1f}",
        f"{out['ended']}/{out['sent']}",
        out["log_lines"],
        f"{out['log_kb']:.0f} KB",
        out["note"] + failed,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], help="names of attacks, or parts of them")
    parser.add_argument("--seconds", type=float, default=12, help="how long the slow ones go on")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full number of connections")
    parser.add_argument("--calm-s", type=float, default=1.5)
    parser.add_argument("--json", help="write everything that was measured to this file")
    parser.add_argument("--config", help="configuration file for the server")
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    chosen = [a for a in ATTACKS if not arguments.only or any(o in a.__name__ for o in arguments.only)]
    heads = (
        "rss MB",
        "peak",
        "after",
        "p50 ms",
        "p99",
        "p50",
        "p99",
        "ended/sent",
        "log",
        "",
        "during; note",
    )
    print(COLUMNS.format("attack", *heads))
    results = []
    for attack in chosen:
        results.append(tried(attack, arguments))
        print(row(results[-1]), flush=True)
    bad = 0
    for out in results:
        for line in out["broken"]:
            bad += 1
            print(f"BROKEN {out['attack']}: {line}")
        if out["exit_code"] != 0:
            print(f"{out['attack']}: the server's exit code is {out['exit_code']}, after {out['stop_s']} s")
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(results, indent=2))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

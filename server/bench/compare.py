#!/usr/bin/env python3
"""Tables of ratios, ours over the best other library, from interleaved measurements.

    compare.py RESULTS.jsonl ... > TABLES.md

Reads JSON lines with op, data, peer ("percept" is ours), version, threads, median_ms, min_ms, max_ms and
extra.cpu_ms. Libraries that solve an easier problem are shown but not compared with: EASIER says which and why.
Of several records of a case the least disturbed is taken.
"""

from __future__ import annotations

import json
import pathlib
import re
import statistics
import sys

EASIER = [
    (r"voxel", r"pcl/approx", "approximate: evicts voxels, gives some twice"),
    (r"voxel", r"kiss_icp", "keeps the first point, no centroid"),
    (r"load_", r"own-numpy", "reads one fixed layout without a copy"),
    (r"global_reg", r"open3d/(fgr|ransac)", "ends 3 to 11 degrees off"),
]
OURS = "percept"


def easier(op: str, peer: str) -> str | None:
    for ops, peers, why in EASIER:
        if re.search(ops, op) and re.fullmatch(peers, peer):
            return why
    return None


def load(paths: list[str]) -> dict[tuple[str, str, int], dict[str, dict]]:
    """Records by (op, data, threads), then by peer."""
    out: dict[tuple[str, str, int], dict[str, dict]] = {}
    for path in paths:
        for line in pathlib.Path(path).read_text().splitlines():
            r = json.loads(line)
            if "median_ms" not in r:
                continue
            peers = out.setdefault((r["op"], r["data"], r["threads"]), {})
            before = peers.get(r["peer"])
            if before is None or r["extra"]["foreign_cpu"] < before["extra"]["foreign_cpu"]:
                peers[r["peer"]] = r
    return out


def quality(r: dict) -> str:
    skip = {"cpu_ms", "cpu_min_ms", "runs", "quiet_runs", "foreign_cpu", "load1", "items_per_s", "note", "outside_ms", "rss_mb"}
    words = [f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in r["extra"].items() if k not in skip]
    return ", ".join(words[:4])


def main() -> None:
    cases = load(sys.argv[1:])
    for threads in sorted({k[2] for k in cases}):
        print(f"\n### {threads} thread{'s' if threads > 1 else ''}\n")
        print("| operation, input | ours ms (min to max) | best other, ms | ratio | ratio of CPU time | ours gives | it gives |")
        print("|---|---:|---:|---:|---:|---|---|")
        ratios = []
        for (op, data, t), peers in sorted(cases.items()):
            if t != threads or OURS not in peers:
                continue
            ours = peers[OURS]
            others = [r for p, r in peers.items() if p != OURS and not easier(op, p)]
            if not others:
                continue
            best = min(others, key=lambda r: r["median_ms"])
            ratio = ours["median_ms"] / best["median_ms"]
            cpu = ours["extra"]["cpu_ms"] / best["extra"]["cpu_ms"] if best["extra"]["cpu_ms"] else float("nan")
            ratios.append(ratio)
            span = f"{ours['median_ms']:.3g} ({ours['min_ms']:.3g} to {ours['max_ms']:.3g})"
            print(
                f"| {op}, {data} | {span} | {best['peer']} {best['version']} {best['median_ms']:.3g} "
                f"| **{ratio:.2f}** | {cpu:.2f} | {quality(ours)} | {quality(best)} |"
            )
        if ratios:
            print(f"\n{len(ratios)} operations, median ratio {statistics.median(ratios):.2f}, largest {max(ratios):.2f}.")


if __name__ == "__main__":
    main()

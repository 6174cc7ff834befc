#!/usr/bin/env python3
"""The toolbox's operations against independent references on recorded data, through the client.

    python bench/reference.py [--only TEXT] [--json]

Prints a line a check: operation, data, reference, whether ours is within the bar, and what was measured. What
needs data or a reference that is not there is skipped, and says so. Needs open3d, scipy, scikit-learn,
opencv-python-headless, pypatchworkpp and small_gicp. Exit code 1 if one is not within its bar.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept import Client, PerceptError
from references import align, images, points, segments, surface, views
from references.data import Absent
from references.finding import Finding

from support.server import Server

CHECKS = [check for area in (points, surface, segments, align, images, views) for check in area.CHECKS]


def findings(toolbox, only):
    """What each check finds; text in place of one that cannot be made."""
    for check in CHECKS:
        name = f"{check.__module__.rpartition('.')[2]}.{check.__name__}"
        if only not in name:
            continue
        try:
            yield from check(toolbox)
        except ImportError as error:
            yield f"{name}: skipped: {error.name} is not installed"
        except Absent as error:
            yield f"{name}: skipped: recorded data {error} is not there"
        except PerceptError as error:
            yield Finding(name, "", "", right=False, figures={"error": str(error)})


def show(finding, as_json):
    if isinstance(finding, str):
        return json.dumps({"skipped": finding}) if as_json else finding
    if as_json:
        return json.dumps({**vars(finding), "figures": {k: rounded(v) for k, v in finding.figures.items()}})
    figures = "  ".join(f"{k} {rounded(v)}" for k, v in finding.figures.items())
    mark = "right" if finding.right else "WRONG"
    return f"{mark}  {finding.operation:34} {finding.data:14} {finding.reference:22} {figures}"


def rounded(value):
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="checks whose area.name holds this")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        server = Server(pathlib.Path(folder) / "data")
        with Client(server.grpc, timeout_s=120) as client:
            for finding in findings(client.toolbox, arguments.only):
                wrong += isinstance(finding, Finding) and not finding.right
                print(show(finding, arguments.json), flush=True)
        server.stop()
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

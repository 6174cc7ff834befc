"""A real Prometheus that scrapes a server, for tests; and the text of /metrics read without one."""

from __future__ import annotations

import json
import os
import pathlib
import re
import shutil
import signal
import subprocess

import httpx

from .server import eventually, free_port

SERIES = re.compile(r"^([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})? (\S+)$")
LABEL = re.compile(r'(\w+)="((?:[^"\\]|\\.)*)"')


def tool(name: str) -> str | None:
    """`prometheus` or `promtool`: from the folder PROMETHEUS_DIR, or from the path; None if it is not there."""
    folder = os.environ.get("PROMETHEUS_DIR")
    return shutil.which(name, path=folder) if folder else shutil.which(name)


def read(text: str) -> dict[tuple[str, frozenset], float]:
    """Series by name and labels."""
    found = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            match = SERIES.match(line)
            assert match, f"no series: {line!r}"
            name, labels, value = match.groups()
            key = name, frozenset(LABEL.findall(labels or ""))
            assert key not in found, f"twice: {line!r}"
            found[key] = float(value)
    return found


class Metrics:
    """What a server counts, as it was when it was asked."""

    def __init__(self, url: str) -> None:
        answer = httpx.get(f"{url}/metrics", timeout=10)
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith("application/openmetrics-text")
        assert answer.text.endswith("# EOF\n")
        self.series = read(answer.text)

    def sum(self, name: str, **labels: str) -> float:
        """Of all series of that name that have these labels."""
        wanted = set(labels.items())
        return sum(value for (n, has), value in self.series.items() if n == name and wanted <= has)


class Prometheus:
    """A process that scrapes every second."""

    def __init__(self, folder: pathlib.Path, target: str) -> None:
        program = tool("prometheus")
        assert program, "no prometheus"
        config = folder / "prometheus.yml"
        scrape = {"job_name": "percept", "static_configs": [{"targets": [target]}]}
        # JSON is YAML.
        config.write_text(json.dumps({"global": {"scrape_interval": "1s"}, "scrape_configs": [scrape]}))
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        self._log = (folder / "prometheus.log").open("w")
        self._process = subprocess.Popen(
            [
                program,
                f"--config.file={config}",
                f"--storage.tsdb.path={folder / 'tsdb'}",
                f"--web.listen-address=127.0.0.1:{port}",
            ],
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    def query(self, query: str) -> list:
        """The vector that an instant query gives; empty while nothing answers."""
        try:
            answer = httpx.get(f"{self.url}/api/v1/query", params={"query": query}, timeout=10)
        except httpx.TransportError:
            return []
        body = answer.json() if answer.status_code != 503 else {"status": "success", "data": {"result": []}}
        assert body["status"] == "success", f"{query}: {body}"
        return body["data"]["result"]

    def wait(self, query: str, seconds: float = 30.0) -> list:
        """The same, asked until it gives something."""
        return eventually(lambda: self.query(query), seconds=seconds)

    def stop(self) -> None:
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(30)
        self._log.close()

"""What a server costs and how it feels from outside: memory, processor, disk, latency of others."""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
import time

import numpy as np
from percept import Client, PerceptError


def rss_mb(pid: int) -> float:
    """Resident memory now."""
    return _status_kb(pid, "VmRSS") / 1024


def rss_kb(pid: int) -> int:
    """Resident memory now."""
    return _status_kb(pid, "VmRSS")


def reset_peak(pid: int) -> None:
    """Lets `peak_mb` count from now on."""
    pathlib.Path(f"/proc/{pid}/clear_refs").write_text("5")


def peak_mb(pid: int) -> float:
    """Largest resident memory since the start, or since `reset_peak`."""
    return _status_kb(pid, "VmHWM") / 1024


def cpu_s(pid: int) -> float:
    """Processor time of all threads, seconds."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def num_descriptors(pid: int) -> int:
    """Open files and sockets."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def disk_bytes(folder: pathlib.Path) -> int:
    """Space that a folder takes; files may go while it is counted."""
    total = 0
    for at, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                total += os.lstat(os.path.join(at, name)).st_blocks * 512
    return total


def _status_kb(pid: int, name: str) -> int:
    text = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(next(x for x in text.splitlines() if x.startswith(name)).split()[1])


def come_first() -> None:
    """Lets all threads of this process but the first come before others: what it starts later does not."""
    for thread in map(int, os.listdir("/proc/self/task")):
        if thread != os.getpid():
            with contextlib.suppress(PermissionError, ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, thread, -15)


class PoseProbe:
    """Another client that asks for a pose over and over; `with PoseProbe(...) as probe: ...;
    probe.quantiles()`. Where that is allowed it comes before all else on the machine: it stands for a client
    with a computer of its own, and what it waits for is the server.
    """

    def __init__(self, address: str, session_id: str, pause_s: float = 0.005) -> None:
        self._address, self._session_id, self._pause_s = address, session_id, pause_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._ms: list[float] = []
        self.failed = 0

    def __enter__(self) -> PoseProbe:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def restart(self) -> None:
        """Forgets what was measured so far."""
        self._ms, self.failed = [], 0

    def quantiles(self) -> dict[str, float]:
        """Milliseconds at p50, p99 and worst; how many answers and failures."""
        values = list(self._ms)
        if not values:
            return {
                "p50": float("nan"),
                "p99": float("nan"),
                "max": float("nan"),
                "n": 0,
                "failed": self.failed,
            }
        p50, p99, worst = np.quantile(values, [0.5, 0.99, 1.0])
        named = {"p50": p50, "p99": p99, "max": worst}
        return {k: round(float(v), 2) for k, v in named.items()} | {"n": len(values), "failed": self.failed}

    def p99_by_tenth(self) -> list[float]:
        """Milliseconds at p99 in each tenth of the answers, in order: whether it is a burst or always."""
        parts = np.array_split(list(self._ms), 10)
        return [round(float(np.quantile(part, 0.99)), 2) for part in parts if len(part)]

    def _run(self) -> None:
        with Client(self._address, timeout_s=10, retries=0) as client:
            session = client.session(self._session_id)
            with contextlib.suppress(PerceptError):
                session.pose()
            come_first()
            while not self._stop.is_set():
                begin = time.perf_counter()
                try:
                    session.pose()
                    self._ms.append((time.perf_counter() - begin) * 1000)
                except PerceptError:
                    self.failed += 1
                time.sleep(self._pause_s)

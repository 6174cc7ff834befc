"""A real server process on free ports and a folder of its own."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import random
import select
import signal
import socket
import subprocess
import time

REPO = pathlib.Path(__file__).resolve().parents[2]
START_S = 30.0
STOP_S = 30.0


def binary() -> pathlib.Path:
    """PERCEPT_BIN, or the release build."""
    named = os.environ.get("PERCEPT_BIN")
    return pathlib.Path(named) if named else REPO / "target" / "release" / "percept"


def recorded(name: str) -> pathlib.Path | None:
    """A folder of recorded data, if it is there."""
    root = pathlib.Path(os.environ.get("PERCEPT_DATA", REPO.parent / "shared" / "data"))
    return root / name if (root / name).is_dir() else None


def free_port() -> int:
    """A port that was free a moment ago; for zenoh, which takes none by itself.

    Below those that the system gives to clients (32768 on Linux): no connection of a test beside this one
    takes it meanwhile. Each worker of pytest-xdist has ports of its own, so that no other takes it either.
    """
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    ports = range(20000, 32000)[worker::workers]
    while True:
        port = random.choice(ports)
        with socket.socket() as s, contextlib.suppress(OSError):
            s.bind(("127.0.0.1", port))
            return port


class Server:
    """`percept serve`; may be killed and started again on the same data."""

    def __init__(
        self,
        data_dir: pathlib.Path | None,
        *arguments: str,
        grpc: str = "127.0.0.1:0",
        zenoh: str | None = None,
        log: pathlib.Path | None = None,
    ) -> None:
        # None: the environment says where the data are.
        self.data_dir = data_dir
        self.log = log or data_dir.with_name(f"{data_dir.name}.log")
        self._arguments = arguments
        self._grpc = grpc
        # None: over TCP, at a free port; empty: closed.
        self._zenoh = zenoh
        self.start()

    def start(self) -> None:
        """Starts and waits until the doors are open."""
        command = [
            *(binary(), "serve"),
            *(() if self.data_dir is None else ("--data-dir", self.data_dir)),
            *("--grpc", self._grpc, "--rest", "127.0.0.1:0"),
            *("--zenoh", f"tcp/127.0.0.1:{free_port()}" if self._zenoh is None else self._zenoh),
            *self._arguments,
        ]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], START_S)
        line = self.process.stdout.readline() if ready else ""
        if not line:
            self.kill()
            raise AssertionError(f"the server did not start; its log:\n{self.tail()}")
        doors = json.loads(line)
        self.doors = doors
        self.grpc, self.rest, self.zenoh = doors["grpc"], doors["rest"], doors["zenoh"]

    @property
    def rest_url(self) -> str:
        """Root of the REST door."""
        return f"http://{self.rest}"

    def kill(self) -> None:
        """SIGKILL: no goodbye."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """SIGTERM; returns the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f"the server did not stop; its log:\n{self.tail()}") from None

    def peak_rss_mb(self) -> float:
        """Largest resident memory so far."""
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        line = next(x for x in status.splitlines() if x.startswith("VmHWM"))
        return int(line.split()[1]) / 1024

    def tail(self) -> str:
        """End of the log."""
        return self.log.read_text(errors="replace")[-4000:]


def eventually(check, *, seconds: float = 30.0):
    """The first truthy value of `check`, asked again until time is up: for what comes by itself, and later on a
    machine that does other things.
    """
    deadline = time.monotonic() + seconds
    while True:
        value = check()
        if value or time.monotonic() > deadline:
            return value
        time.sleep(0.01)


def settled(ask, *, times: int = 40, seconds: float = 30.0):
    """What `ask` answers once it has answered alike so many times in a row: for what goes on behind a caller
    that left.
    """
    deadline = time.monotonic() + seconds
    last, alike = ask(), 0
    while alike < times:
        assert time.monotonic() < deadline, f"it does not come to rest; newest: {last}"
        time.sleep(0.01)
        value = ask()
        last, alike = value, alike + 1 if value == last else 0
    return last

"""Every Python snippet of the README runs as it stands, one after the other, against one server."""

from __future__ import annotations

import re
import subprocess
import sys

from percept import Client

from support import world
from support.server import REPO, Server, binary


def test_every_snippet_runs(tmp_path):
    server = Server(tmp_path / "data")
    text = (REPO / "README.md").read_text().replace("127.0.0.1:50051", server.grpc)
    if server.zenoh:
        text = text.replace("tcp/127.0.0.1:7447", server.zenoh)
    snippets = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(snippets) >= 10
    # One interpreter, as a reader's: later snippets use what earlier ones have made.
    script = "\n".join(f"exec(compile({snippet!r}, 'snippet {i}', 'exec'))" for i, snippet in enumerate(snippets))
    try:
        # What a reader has by then: a robot that the README has had simulated, a recording of their own, and a cloud.
        for session in ("demo", "mine"):
            sim = [binary(), "sim", "--session", session, "--duration-s", "2", "--server", server.grpc]
            subprocess.run(sim, check=True, capture_output=True, timeout=120)
        with Client(server.grpc) as client:
            client.toolbox.write_cloud(world.cloud(world.drive(1)[0]), tmp_path / "room.pcd")
        command = [sys.executable, "-c", script]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
    finally:
        server.stop()

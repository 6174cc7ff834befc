"""A store over S3: needs `moto[server]` beside the requirements; without it the test says so and is skipped."""

from __future__ import annotations

import os
import shutil
import subprocess
import urllib.request
from pathlib import Path

import pytest

from support.server import free_port

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def s3():
    """The address of an S3 server in memory, with an empty bucket `percept-test`."""
    moto = pytest.importorskip("moto.server", reason="no S3 server to test with; pip install 'moto[server]==5.2.5'")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=free_port(), verbose=False)
    server.start()
    address = f"http://127.0.0.1:{server._port}"
    request = urllib.request.Request(f"{address}/percept-test", method="PUT")
    with urllib.request.urlopen(request) as answer:
        assert answer.status == 200
    yield address
    server.stop()


@pytest.mark.timeout(1800)
def test_the_stores_own_tests_pass_on_s3(s3):
    if shutil.which("cargo") is None:
        pytest.skip("no cargo to build the store's tests with")
    keys = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test"}
    command = ["cargo", "test", "--release", "-q", "-p", "percept-store", "--test", "it", "s3::", "--", "--nocapture"]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | keys | {"PERCEPT_TEST_S3": s3}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout and "skipped" not in done.stdout, done.stdout

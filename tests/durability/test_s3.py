"""The store's own tests over S3."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support import s3

ROOT = Path(__file__).parents[2]
#: The flags of the build before: others would build everything anew.
BUILD = ["cargo", "build", "--release", "--locked", "--workspace", "--all-targets", "--message-format=json"]


@pytest.mark.timeout(1800)
def test_the_stores_own_tests_pass_on_s3():
    if shutil.which("cargo") is None:
        pytest.skip("no cargo to build the store's tests with")
    built = subprocess.run(BUILD, cwd=ROOT, capture_output=True, text=True, check=True)
    artifacts = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
    (program,) = (
        a["executable"]
        for a in artifacts
        if a["reason"] == "compiler-artifact" and a["target"]["name"] == "it" and "store" in a["package_id"]
    )
    with s3.server() as address:
        environment = os.environ | s3.KEYS | {"PERCEPT_TEST_S3": address}
        # One after the other: nodes that share this machine with all others' fall silent.
        command = [program, "s3::", "--nocapture", "--test-threads=1"]
        done = subprocess.run(
            command, cwd=ROOT / "server" / "store", env=environment, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout and "skipped" not in done.stdout, done.stdout

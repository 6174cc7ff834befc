"""Recorded frames through a door give what they give in-process."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest
from percept import CameraIntrinsics, EncodedImage, Pose, SensorSpec

from support.server import binary
from support.world import OPTICAL

FRAMES = 40


def stamp(number):
    """Frame n of 30 Hz, rounded to the nanosecond, as a replay has it."""
    return (number * 1_000_000_000 + 15) // 30


def camera_of(folder):
    k = np.loadtxt(folder / "camera-intrinsics.txt")
    intrinsics = CameraIntrinsics(
        width_px=640, height_px=480, fx_px=k[0, 0], fy_px=k[1, 1], cx_px=k[0, 2], cy_px=k[1, 2]
    )
    base = Pose(rotation=OPTICAL)
    return SensorSpec("camera", kind="rgbd", t_base_sensor=base, intrinsics=intrinsics, overload_policy="block")


def replay(folder, out, *arguments):
    command = [binary(), "replay", folder, "--frames", f"0:{FRAMES}", "--out", out, "--json", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    return json.loads(done.stdout), (out / "trajectory.tum").read_bytes()


def frames(folder, count=FRAMES):
    for path in sorted(folder.glob("frame-*.depth.png"))[:count]:
        number = int(path.name[6:12])
        colour = folder / f"frame-{number:06}.color.jpg"
        size = {"width_px": 640, "height_px": 480}
        yield (
            stamp(number),
            EncodedImage(data=path.read_bytes(), **size),
            EncodedImage(data=colour.read_bytes(), **size),
        )


@pytest.fixture(scope="module")
def in_process(seven_scenes, tmp_path_factory):
    return replay(seven_scenes, tmp_path_factory.mktemp("replay"))


@pytest.mark.timeout(600)
def test_a_python_stream_gives_the_trajectory_of_the_replay(client, seven_scenes, in_process):
    report, expected = in_process
    session = client.sessions.create(sensors=[camera_of(seven_scenes)])
    with session.stream() as stream:
        for stamp_ns, depth, colour in frames(seven_scenes):
            stream.send_rgbd("camera", stamp_ns=stamp_ns, depth=depth, colour=colour, metres_per_unit=0.001)
    assert stream.summary.accepted == FRAMES
    assert session.map.export("trajectory_tum").data == expected
    assert report["frames"] == FRAMES


@pytest.mark.timeout(600)
def test_a_replay_into_a_server_gives_the_trajectory_of_the_replay(server, seven_scenes, in_process, tmp_path):
    _, expected = in_process
    _, streamed = replay(seven_scenes, tmp_path, "--server", server.grpc)
    assert streamed == expected


@pytest.mark.timeout(600)
def test_the_trajectory_is_right(client, seven_scenes, in_process):
    report, _ = in_process
    assert report["tracked"] >= 0.99 * FRAMES or report["tracked"] >= 0.99
    assert report["ate_rmse_m"] < 0.03

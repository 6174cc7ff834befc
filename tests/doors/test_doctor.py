"""The stream doctor: what is wrong with a stream is told by itself, with a remedy, at every door."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import subprocess
import time
import urllib.request

import numpy as np
import pytest
from percept import Client, InvalidArgument, NotFound, Pose

from support import robots, ros2, world
from support.ros2 import Robot, Router
from support.server import Server, binary, eventually, free_port


def status(session, sensor: str):
    return next(s for s in session.sensors.list() if s.spec.sensor_id == sensor)


def kinds(session, sensor: str) -> list[str]:
    return [t.kind for t in status(session, sensor).troubles]


def send_depth(session, count: int, metres_per_unit: float = 0.001, *, covered: bool = False) -> None:
    for i, pose in enumerate(world.drive(count)):
        image = world.depth_image(pose) * (0 if covered else 1)
        session.send_depth("camera", stamp_ns=world.stamp(i), depth=image, metres_per_unit=metres_per_unit)


def doctor(server, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [binary(), "doctor", "--server", f"http://{server.grpc}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_a_sound_stream_is_good_and_has_its_figures(server, client):
    session = client.sessions.create(sensors=[world.CAMERA])
    send_depth(session, 6)
    camera = status(session, "camera")
    assert camera.verdict == "good"
    figures = camera.figures
    assert figures.frame_bytes == pytest.approx(2 * 320 * 240)
    assert figures.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert figures.longest_interval_s == pytest.approx(world.FRAME_NS / 1e9, rel=1e-3)
    assert figures.measured_ratio == pytest.approx(1.0)
    truth_m = np.median(world.depth_image(world.drive(6)[5])) / 1000
    assert figures.median_range_m == pytest.approx(truth_m, rel=0.15)
    assert 0 < figures.latency_p50_s <= figures.latency_p95_s < 5
    assert 0 <= figures.quiet_s < 30
    # Its stamps are of 1970.
    assert figures.delay_s > 1e9
    ran = doctor(server, session.session_id)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "6 frames" in ran.stdout


def test_depth_in_millimetres_is_told(server, client):
    session = client.sessions.create(sensors=[world.CAMERA])
    send_depth(session, 3, metres_per_unit=1.0)
    assert "range_unit" in kinds(session, "camera")
    ran = doctor(server, session.session_id)
    assert ran.returncode == 1
    assert "RANGE_UNIT" in ran.stdout
    assert "metres_per_unit 0.001" in ran.stdout
    # REST says the same as the command line's JSON.
    with urllib.request.urlopen(f"{server.rest_url}/v1/sessions/{session.session_id}/sensors") as answer:
        (told,) = json.load(answer)["sensors"]
    (line,) = doctor(server, session.session_id, "--json").stdout.splitlines()
    assert [t["kind"] for t in told["troubles"]] == [t["kind"] for t in json.loads(line)["sensors"][0]["troubles"]]


def test_a_covered_camera_is_told(client):
    session = client.sessions.create(sensors=[world.CAMERA])
    send_depth(session, 3, covered=True)
    assert "sees_little" in kinds(session, "camera")


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"t_base_sensor": Pose.from_xyz(0.0, 0.0, 1.2)}, "optical_frame", "(-0.5, 0.5, -0.5, 0.5)"),
        # Those of 640 x 480, for images of half the size.
        (
            {"intrinsics": dataclasses.replace(world.INTRINSICS, fx_px=580, fy_px=580, cx_px=319.5, cy_px=239.5)},
            "intrinsics",
            "320x240",
        ),
        ({"intrinsics": dataclasses.replace(world.INTRINSICS, fy_px=29.0)}, "intrinsics", "square"),
    ],
    ids=["body_frame", "other_size", "typo"],
)
def test_a_camera_declared_as_no_camera_is_told(client, change, kind, words):
    session = client.sessions.create(sensors=[dataclasses.replace(world.CAMERA, **change)])
    send_depth(session, 1)
    (trouble,) = [t for t in status(session, "camera").troubles if t.kind == kind]
    assert words in trouble.message


def test_refusals_are_told_by_reason(client):
    session = client.sessions.create(sensors=[world.CAMERA])
    send_depth(session, 2)
    small = np.ones((4, 4), np.uint16)
    for stamp_ns, image in [(1, world.depth_image(world.drive(1)[0])), (2, small), (world.stamp(9), small)]:
        with pytest.raises(InvalidArgument):
            session.send_depth("camera", stamp_ns=stamp_ns, depth=image, metres_per_unit=0.001)
    camera = status(session, "camera")
    assert camera.rejected == 3
    assert sum(r.count for r in camera.refusals) == 3
    assert {r.reason for r in camera.refusals} >= {"INTRINSICS_MISMATCH"}
    assert all(r.reason in camera.verdict_message and r.message in camera.verdict_message for r in camera.refusals)


@pytest.mark.parametrize(
    ("way", "turn", "words"),
    [(1.0, 1.0, "good"), (1.0, 0.5, "times the turning"), (2.0, 1.0, "2.0"), (-1.0, 1.0, "the other way")],
    ids=["honest", "half_the_turning", "double_the_way", "backwards"],
)
def test_wheels_that_contradict_the_scans_are_told(client, way, turn, words):
    session = client.sessions.create(sensors=[world.LASER, world.WHEELS])
    poses = [robots.laps()[i % len(robots.laps())] for i in range(250)]
    t_odom_base = np.eye(4)
    with session.stream() as stream:
        for i, pose in enumerate(poses):
            if i:
                step = np.linalg.inv(poses[i - 1].matrix) @ pose.matrix
                yaw = np.arctan2(step[1, 0], step[0, 0]) * turn
                told = Pose.from_xy_yaw(way * step[0, 3], way * step[1, 3], yaw).matrix
                t_odom_base = t_odom_base @ told
            yaw = float(np.arctan2(t_odom_base[1, 0], t_odom_base[0, 0]))
            base = Pose.from_xy_yaw(float(t_odom_base[0, 3]), float(t_odom_base[1, 3]), yaw)
            stream.send_odometry("wheels", stamp_ns=world.stamp(i), t_odom_base=base)
            stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
    wheels = status(session, "wheels")
    assert words in wheels.verdict_message, wheels.verdict_message
    assert all(t.kind == "wheels_unlike" for t in wheels.troubles)
    assert status(session, "laser").verdict == "good"


def test_a_sensor_that_falls_silent_is_told_while_others_go_on(client):
    session = client.sessions.create(sensors=[world.LASER, world.WHEELS])
    for i, pose in enumerate(world.drive(8)):
        session.send_odometry("wheels", stamp_ns=world.stamp(i), t_odom_base=pose)
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    assert kinds(session, "wheels") == []
    time.sleep(2.2)
    # All are silent: the drive is over.
    assert kinds(session, "wheels") == []
    session.send_scan("laser", stamp_ns=world.stamp(9), **world.scan(pose))
    assert kinds(session, "wheels") == ["silent"]
    assert kinds(session, "laser") == []


def test_a_clock_that_is_ahead_is_told(client):
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(3)):
        session.send_scan("laser", stamp_ns=time.time_ns() + 30 * 10**9 + i, **world.scan(pose))
    (trouble,) = status(session, "laser").troubles
    assert trouble.kind == "clock_ahead"
    assert status(session, "laser").figures.delay_s == pytest.approx(-30, abs=3)


def test_topics_of_ros_that_are_not_used_are_told_with_the_reason(tmp_path):
    with Router() as router:
        config = tmp_path / "percept.toml"
        config.write_text(f'[[ros2.robots]]\nsession = "robot"\nconnect = "{router.endpoint}"\n')
        server = Server(tmp_path / "data", "--config", str(config))
        try:
            with Robot(router.endpoint) as robot, Client(server.grpc) as client:
                # A transform of another frame: nothing leads from the laser to the robot.
                static = ros2.transform(world.stamp(0), "base_link", "camera_link", world.LASER.t_base_sensor)
                robot.publish("/tf_static", ros2.transforms(static), latched=True)

                stamps = itertools.count()

                def told():
                    scan = world.scan(world.drive(1)[0])
                    message = ros2.scan(world.stamp(next(stamps)), "laser_link", scan)
                    robot.publish("/scan", message)
                    time.sleep(0.2)
                    with contextlib.suppress(NotFound):
                        notes = client.session("robot").info().stream_notes
                        return next((n for n in notes if n.stream == "/scan"), None)

                note = eventually(told)
                assert note, "nothing is said of /scan"
                assert "laser_link" in note.message
                ran = doctor(server, "robot")
                assert ran.returncode == 1
                assert "laser_link" in ran.stdout
        finally:
            server.stop()


def test_a_server_that_is_not_there_is_told():
    command = [binary(), "doctor", "--server", f"http://127.0.0.1:{free_port()}"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 1
    assert ran.stderr.startswith("percept: ")


def test_without_a_session_all_that_are_awake_are_looked_at(server, client):
    sessions = [client.sessions.create(sensors=[world.LASER]) for _ in range(2)]
    for session in sessions:
        session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    ran = doctor(server)
    assert all(session.session_id in ran.stdout for session in sessions), ran.stdout + ran.stderr
    unknown = doctor(server, "no-such-session")
    assert unknown.returncode == 1
    assert "no-such-session" in unknown.stderr

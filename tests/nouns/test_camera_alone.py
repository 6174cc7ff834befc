"""A session with nothing but a camera, and what tells it its scale."""

from __future__ import annotations

import numpy as np
import pytest

from support import world

STEPS = 40


def drive():
    """4 cm and 2 degrees a step."""
    return world.drive(2 * STEPS)[::2]


@pytest.fixture(scope="module")
def images():
    return [world.colour_image(pose) for pose in drive()]


def camera_session(client, images, *others):
    session = client.sessions.create(sensors=[world.EYE, *others])
    poses = drive()
    with session.stream() as stream:
        for i, image in enumerate(images):
            if others:
                stream.send_odometry("wheels", stamp_ns=world.stamp(i), t_odom_base=poses[i])
            stream.send_colour("eye", stamp_ns=world.stamp(i), colour=image)
        acks = [a for a in stream.acks() if a.sensor_id == "eye"]
    assert stream.summary.rejected == 0, stream.summary.rejections
    return session, [a.result.pose for a in acks]


@pytest.fixture(scope="module")
def alone(client, images):
    return camera_session(client, images)


@pytest.fixture(scope="module")
def on_wheels(client, images):
    return camera_session(client, images, world.WHEELS)


def scaled_error_m(estimate, truth):
    """RMSE after the similarity of least squares: Umeyama 1991."""
    x, y = estimate - estimate.mean(0), truth - truth.mean(0)
    u, s, vt = np.linalg.svd(y.T @ x)
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ d) / (x**2).sum()
    return float(np.sqrt(((y - scale * x @ (u @ d @ vt).T) ** 2).sum(1).mean()))


def test_a_camera_alone_waits_for_parallax_then_tracks_and_says_that_scale_is_unknown(alone):
    session, poses = alone
    assert poses[0].state == "initialising"
    assert poses[0].waiting_for == "second_view"
    assert "sideways" in poses[0].waiting_message
    tracked = [p for p in poses if p.state == "tracking"]
    assert len(tracked) > STEPS / 2
    assert {p.scale for p in poses} == {"unknown"}
    assert poses[-1].scale_source == "none"
    assert "no map is built" in poses[-1].scale_message
    assert session.pose() == poses[-1]


def test_planning_from_where_a_camera_alone_is_says_that_its_scale_is_unknown(alone):
    session, _ = alone
    none = session.plan((1.0, 0.0))
    assert not none
    assert none.reason == "scale_unknown"
    assert "wheel odometry" in none.detail


def test_the_trajectory_of_a_camera_alone_is_right_but_for_its_scale(alone):
    session, _ = alone
    trajectory = session.trajectory()
    assert set(trajectory.scales) == {"unknown"}
    assert set(trajectory.states) <= {"tracking", "lost"}
    # Without scale the poses are the camera's.
    by_stamp = {world.stamp(i): (pose.matrix @ world.EYE.t_base_sensor.matrix)[:3, 3] for i, pose in enumerate(drive())}
    truth = np.array([by_stamp[s] for s in trajectory.stamps_ns.tolist()])
    assert scaled_error_m(trajectory.positions, truth) < 0.03


def test_no_map_is_built_without_scale(alone):
    session, _ = alone
    info = session.info()
    assert (info.num_keyframes, info.num_objects, info.map_version) == (0, 0, 0)


def test_wheels_make_lengths_metres_and_the_map_begins(on_wheels):
    session, poses = on_wheels
    scales = [p.scale for p in poses]
    first = scales.index("metric")
    assert scales == ["unknown"] * first + ["metric"] * (len(poses) - first)
    assert poses[-1].scale_source == "odometry"
    assert poses[-1].scale_message == "by wheel odometry"
    assert session.info().num_keyframes > 0
    truth = world.truth_in_map(drive())
    # Wheels without a covariance count for a tenth of the way, here 1.5 m.
    assert world.position_error_m(poses[-1].t_map_base, truth[-1]) < 0.15
    trajectory = session.trajectory()
    assert trajectory.scales[-1] == "metric"


def test_images_that_show_nothing_are_lost_with_the_reason_and_found_again(client, images):
    session, _ = camera_session(client, images)

    def send(i, colour):
        return session.send_colour("eye", stamp_ns=world.stamp(STEPS + i), colour=colour).pose

    for i, (shade, why) in enumerate([(0, "bad_exposure"), (255, "bad_exposure"), (120, "no_texture")]):
        pose = send(i, np.full_like(images[0], shade))
        assert pose.state == "lost"
        assert pose.lost_reason == why
        assert why.split("_")[1] in pose.lost_message
    found = send(3, images[-1])
    assert found.state == "tracking"
    assert found.relocalised
    assert not send(4, images[-1]).relocalised


def test_an_image_of_another_size_and_a_stamp_from_the_past_are_refused_precisely(client, images):
    session, poses = camera_session(client, images)
    with session.stream() as stream:
        stream.send_colour("eye", stamp_ns=world.stamp(STEPS), colour=images[0][:100])
        stream.send_colour("eye", stamp_ns=world.stamp(3) + 1, colour=images[0])
    reasons = [ack.rejection.reason for ack in stream.summary.rejections]
    assert reasons == ["INTRINSICS_MISMATCH", "STAMP_NOT_INCREASING"]
    assert "320x100" in stream.summary.rejections[0].rejection.message
    assert session.pose() == poses[-1]


def test_colour_and_grey_images_give_the_same(client, images, alone):
    _, grey = alone
    _, poses = camera_session(client, [np.repeat(i[..., None], 3, axis=2) for i in images])
    assert np.allclose(poses[-1].t_map_base.matrix, grey[-1].t_map_base.matrix, atol=1e-9)

"""Somebody says where a robot is: one that was carried off, or was found in a wrong place."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx
import numpy as np
import pytest
from percept import FailedPrecondition, InvalidArgument, NotFound, Pose, SessionMode, TrackingState

from support import world


@pytest.fixture
def mapped(client):
    """One that has mapped the room, and where it stands in the world; then somebody carried it."""
    session = client.sessions.create(sensors=[world.LASER])
    poses = world.circle()
    with session.stream() as stream:
        for i, pose in enumerate(poses):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    assert stream.summary.rejected == 0
    return session, poses


def stand(session, here: Pose, first: int, tell):
    """Scans come from one place while `tell` is asked; what it answers."""
    with ThreadPoolExecutor(1) as beside:
        answer = beside.submit(tell)
        i = first
        while not answer.done() and i < first + 500:
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(here))
            i += 1
        return answer.result(timeout=10)


def in_map(poses, here: Pose) -> np.ndarray:
    return world.truth_in_map([poses[0], here])[1]


def test_a_robot_that_was_carried_off_is_where_somebody_says(mapped):
    session, poses = mapped
    here, long_after = poses[20], 5000
    truth = in_map(poses, here)
    pointed_out = Pose.from_matrix(truth @ Pose.from_xy_yaw(0.3, -0.2, 0.15).matrix)
    told = stand(session, here, long_after, lambda: session.set_pose(pointed_out))
    assert told.state is TrackingState.TRACKING
    assert told.tentative, "what it sees elsewhere has to agree"
    assert told.relocalised
    assert world.position_error_m(told.t_map_base, truth) < 0.08
    assert world.position_error_m(session.pose().t_map_base, truth) < 0.08


def test_what_the_robot_sees_has_the_last_word_and_nothing_is_changed(mapped, server):
    session, poses = mapped
    here, first = poses[-1], len(poses)
    truth = in_map(poses, here)
    turned = Pose.from_matrix(truth @ Pose.from_xy_yaw(0.0, 0.0, np.pi / 2).matrix)
    with pytest.raises(FailedPrecondition) as error:
        stand(session, here, first, lambda: session.set_pose(turned))
    assert error.value.reason == "POSE_REFUTED"
    pose = session.pose()
    assert pose.state is TrackingState.TRACKING
    assert not pose.tentative
    assert world.position_error_m(pose.t_map_base, truth) < 0.08


def test_it_is_said_by_rest_as_well(mapped, server):
    session, poses = mapped
    here = poses[10]
    x, y, yaw = in_map(poses, here)[0, 3], in_map(poses, here)[1, 3], np.arctan2(*in_map(poses, here)[[1, 0], 0])

    def by_rest():
        place = {
            "translation": {"x": x, "y": y},
            "rotation": {"w": np.cos(yaw / 2), "z": np.sin(yaw / 2)},
        }
        url = f"{server.rest_url}/v1/sessions/{session.session_id}/pose"
        return httpx.post(url, json={"t_map_base": place}, timeout=10)

    answer = stand(session, here, 5000, by_rest)
    assert answer.status_code == 200, answer.text
    assert answer.json()["compared"] is True
    assert answer.json()["pose"]["tentative"] is True
    nowhere = httpx.post(f"{server.rest_url}/v1/sessions/{session.session_id}/pose", json={}, timeout=10)
    assert (nowhere.status_code, nowhere.json()["reason"]) == (400, "FIELD_MISSING")
    silent = by_rest()
    assert (silent.status_code, silent.json()["reason"]) == (409, "ROBOT_SILENT")


def test_where_there_is_nothing_to_compare_with_it_is_said(client):
    empty = client.sessions.create(sensors=[world.LASER])
    with pytest.raises(FailedPrecondition) as error:
        empty.set_pose(Pose())
    assert error.value.reason == "MAP_EMPTY"
    counting = client.sessions.create(sensors=[world.LASER], mode=SessionMode.INGEST_ONLY)
    with pytest.raises(FailedPrecondition) as error:
        counting.set_pose(Pose())
    assert error.value.reason == "SESSION_NOT_MAPPING"
    with pytest.raises(NotFound):
        client.session("nobody").set_pose(Pose())


@pytest.mark.parametrize(("row", "value"), [(0, np.nan), (1, np.inf), (2, 1e300)])
def test_a_pose_that_is_none_is_refused(mapped, row, value):
    session, _ = mapped
    bad = np.eye(4)
    bad[row, 3] = value
    with pytest.raises(InvalidArgument):
        session.set_pose(bad)

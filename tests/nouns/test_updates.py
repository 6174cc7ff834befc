"""Sessions and sensors that change while they live: what may, what may not, and who was quicker."""

from __future__ import annotations

import concurrent.futures

import httpx
import numpy as np
import pytest
from percept import (
    Aborted,
    Client,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    OdometryFrame,
    Pose,
    SensorSpec,
)

from support import world


def send_scans(session, first, last):
    poses = world.drive(last)
    for i in range(first, last):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))


@pytest.fixture
def http(server):
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        yield http


def test_name_labels_and_parameters_change_and_nothing_else_does(client, name):
    session = client.sessions.create(name, display_name="Seven", labels={"site": "north"}, sensors=[world.LASER])
    before = session.info()
    assert dict(before.labels) == {"site": "north"}
    after = session.update(display_name="Eight", params={"planning": {"robot_radius_m": 0.31}})
    assert (after.display_name, dict(after.labels)) == ("Eight", {"site": "north"})
    assert after.params["planning"]["robot_radius_m"] == 0.31
    rest = {**after.params["planning"], "robot_radius_m": before.params["planning"]["robot_radius_m"]}
    assert {**after.params, "planning": rest} == before.params
    assert (after.etag != before.etag, after.create_time_ns) == (True, before.create_time_ns)
    assert dict(session.update(labels={"site": "south", "hall": "2"}).labels) == {
        "site": "south",
        "hall": "2",
    }
    assert dict(session.update(labels={}).labels) == {}
    assert session.update(display_name="").display_name == ""
    back = session.update(params={"planning": {"robot_radius_m": None}})
    assert back.params == before.params, "None puts a parameter back to its default"


def test_changes_survive_a_kill(own_server, name):
    with Client(own_server.grpc) as client:
        session = client.sessions.create(name, sensors=[world.LASER])
        send_scans(session, 0, 2)
        changed = session.update(display_name="Eight", labels={"site": "north"}, params={"detection": {"range_m": 4.5}})
        sensor = session.sensors.update("laser", overload_policy="drop_oldest")
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.session(name)
        for _ in range(2):
            info = session.info()
            assert (info.display_name, dict(info.labels)) == ("Eight", {"site": "north"})
            assert info.params == changed.params
            assert session.sensors.get("laser").etag == sensor.etag
            assert session.sensors.get("laser").spec.overload_policy == "drop_oldest"
            # Once asleep, as found after the start, once awake.
            assert len(session.trajectory()) == 2
        assert session.update(display_name="Nine", etag=info.etag).display_name == "Nine"


def test_a_parameter_that_changes_is_in_force_from_the_next_frame_on(client):
    """With keyframes every 5 cm the same drive makes more of them."""
    session = client.sessions.create(sensors=[world.LASER])
    send_scans(session, 0, 10)
    few = session.info().num_keyframes
    session.update(params={"slam": {"odometry": {"keyframe": {"distance_m": 0.05}}}})
    send_scans(session, 10, 20)
    # 20 cm at 5 cm each; the first ten frames are 18 cm at 50.
    assert few == 1
    assert session.info().num_keyframes >= few + 3


def test_paths_are_planned_with_the_radius_that_was_set(client):
    session = client.sessions.create(sensors=[world.LASER])
    send_scans(session, 0, 10)
    goal = world.to_map(-0.2, 0.2)
    assert session.plan(goal).waypoints.shape[0] > 0
    session.update(params={"planning": {"robot_radius_m": 3.0, "inflation_radius_m": 3.0}})
    refused = session.plan(goal)
    assert refused.reason in ("start_does_not_fit", "goal_does_not_fit", "unreachable")


@pytest.mark.parametrize(
    ("params", "field"),
    [
        ({"map": {"cloud": {"voxel_size_m": 0.5}}}, "params.map.cloud.voxel_size_m"),
        ({"slam": {"pose_sensor": "other"}}, "params.slam.pose_sensor"),
        ({"slam": {"odometry": {"tracking": {"max_gap_s": 9.0}}}}, "params.slam.odometry.tracking.max_gap_s"),
        (
            {"slam": {"odometry": {"keyframe": {"features": "sift"}}}},
            "params.slam.odometry.keyframe.features",
        ),
    ],
)
def test_what_is_fixed_with_the_creation_is_refused_by_name(client, params, field):
    session = client.sessions.create()
    before = session.info()
    with pytest.raises(InvalidArgument) as error:
        session.update(display_name="New", params=params)
    assert (error.value.reason, error.value.field) == ("FIELD_IMMUTABLE", field)
    assert "create another session" in error.value.message
    after = session.info()
    assert (after.display_name, after.params, after.etag) == (before.display_name, before.params, before.etag)


def test_the_same_value_is_no_change(client):
    session = client.sessions.create(display_name="A")
    params = session.info().params
    assert session.update(display_name="A", params=params).etag == session.info().etag


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"params": {"planning": {"robot_radius_m": -1.0}}}, "PARAMETER_OUT_OF_RANGE"),
        ({"labels": {"a b": "c"}}, "LABELS_INVALID"),
        ({"labels": {"a": "b,c"}}, "LABELS_INVALID"),
        ({"labels": {str(i): "" for i in range(33)}}, "TOO_MANY_LABELS"),
        ({"display_name": "x" * 257}, "DISPLAY_NAME_INVALID"),
        ({"display_name": "a\nb"}, "DISPLAY_NAME_INVALID"),
        ({}, "FIELD_MISSING"),
    ],
)
def test_values_that_cannot_be_change_nothing(client, change, reason):
    session = client.sessions.create()
    before = session.info().etag
    with pytest.raises(InvalidArgument) as error:
        session.update(**change)
    assert error.value.reason == reason
    assert session.info().etag == before
    if change and "params" not in change:
        with pytest.raises(InvalidArgument) as error:
            client.sessions.create(**change)
        assert error.value.reason == reason


def test_who_has_not_seen_the_newest_state_is_told(client):
    session = client.sessions.create(sensors=[world.LASER])
    seen = session.info().etag
    session.update(display_name="by another")
    with pytest.raises(Aborted) as error:
        session.update(display_name="mine", etag=seen)
    assert (error.value.reason, error.value.field) == ("ETAG_MISMATCH", "etag")
    newest = session.info()
    assert newest.display_name == "by another"
    assert newest.etag in error.value.message
    assert session.update(display_name="mine", etag=newest.etag).display_name == "mine"


def test_of_many_at_once_who_have_seen_the_same_one_wins(client):
    session = client.sessions.create()
    seen = session.info().etag

    def change(i):
        try:
            return session.update(display_name=str(i), etag=seen).display_name
        except Aborted:
            return None

    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        won = [name for name in pool.map(change, range(8)) if name is not None]
    assert won == [session.info().display_name]


def test_frames_do_not_change_an_etag_and_lists_tell_it_too(client, name):
    session = client.sessions.create(name, sensors=[world.LASER])
    tag, sensor = session.info().etag, session.sensors.get("laser").etag
    send_scans(session, 0, 3)
    assert (session.info().etag, session.sensors.get("laser").etag) == (tag, sensor)
    assert [s.etag for s in client.sessions.list() if s.session_id == name] == [tag]
    session.sensors.declare("wheels", kind="odometry")
    assert session.info().etag != tag, "sensors' declarations are the session's, too"


def test_a_session_under_an_id_that_is_used_again_has_another_etag(client, name):
    seen = client.sessions.create(name).info().etag
    client.sessions.delete(name)
    session = client.sessions.create(name)
    with pytest.raises(Aborted):
        session.update(display_name="the old one", etag=seen)


def test_a_sensor_changes_where_nothing_hangs_on_it(client):
    session = client.sessions.create(sensors=[world.LASER])
    moved = Pose.from_xy_yaw(0.1, 0.0, 0.0)
    assert session.sensors.update("laser", t_base_sensor=moved).spec.t_base_sensor == moved
    session.sensors.update("laser", t_base_sensor=world.LASER.t_base_sensor, time_offset_s=0.5)
    send_scans(session, 0, 2)
    assert session.pose().stamp_ns == world.stamp(1) + 500_000_000
    changed = session.sensors.update("laser", overload_policy="drop_oldest")
    assert (changed.spec.overload_policy, changed.accepted) == ("drop_oldest", 2), "what was counted stays"
    assert session.sensors.update("laser", time_offset_s=0.5).etag == changed.etag, "the same is no change"
    for change in ({"t_base_sensor": moved}, {"time_offset_s": 0.1}):
        with pytest.raises(FailedPrecondition) as error:
            session.sensors.update("laser", **change)
        assert (error.value.reason, error.value.field) == ("SENSOR_IN_USE", next(iter(change)))
        assert "under another name" in error.value.message


def test_the_clock_of_wheels_that_have_sent_may_be_corrected(client):
    """Wheels whose stamps are 10 s late: once that is told, they are the prior of a scan that says nothing."""
    session = client.sessions.create(sensors=[world.LASER, SensorSpec("odom", kind="odometry")])
    start = world.drive(1)[0]
    end = Pose.from_xy_yaw(start.translation[0] + 0.3, 0.05, 0.1)
    late_ns = 10 * 10**9
    session.send(OdometryFrame("odom", stamp_ns=1, t_odom_base=Pose()))
    with pytest.raises(Aborted):
        session.sensors.update("odom", time_offset_s=-10.0, etag="0")
    changed = session.sensors.update("odom", time_offset_s=-10.0)
    assert (changed.spec.time_offset_s, changed.accepted) == (-10.0, 1)
    for i, pose in enumerate((start, end)):
        t_odom_base = Pose.from_matrix(np.linalg.inv(start.matrix) @ pose.matrix)
        stamp_ns = world.stamp(10 * i)
        session.send(OdometryFrame("odom", stamp_ns=stamp_ns + late_ns, t_odom_base=t_odom_base))
        session.send_scan("laser", stamp_ns=stamp_ns, **world.scan(pose))
    truth = world.truth_in_map([start, end])[-1]
    assert world.position_error_m(session.pose().t_map_base, truth) < 0.03


def test_sensors_that_are_not_there_and_impossible_ones_are_refused(client):
    session = client.sessions.create(sensors=[world.CAMERA])
    for ask in (session.sensors.get, lambda name: session.sensors.update(name, time_offset_s=0.1)):
        with pytest.raises(NotFound) as error:
            ask("nobody")
        assert error.value.reason == "SENSOR_NOT_FOUND"
    with pytest.raises(InvalidArgument) as error:
        session.sensors.update("camera", time_offset_s=float("nan"))
    assert error.value.reason == "OUT_OF_RANGE"
    with pytest.raises(InvalidArgument) as error:
        session.sensors.update("camera", overload_policy="explode")
    assert error.value.reason == "ENUM_UNKNOWN"
    with pytest.raises(InvalidArgument) as error:
        session.sensors.update("camera")
    assert error.value.reason == "FIELD_MISSING"


def test_rest_patches_with_entity_tags(http, client, name):
    client.sessions.create(name, sensors=[world.LASER])
    url = f"/v1/sessions/{name}"
    tag = http.get(url).headers["etag"]
    assert tag == f'"{client.session(name).info().etag}"'
    changed = http.patch(url, json={"display_name": "Eight"}, headers={"if-match": tag})
    assert (changed.status_code, changed.json()["session"]["display_name"]) == (200, "Eight")
    assert changed.headers["etag"] not in ("", tag)
    stale = http.patch(url, json={"display_name": "Nine"}, headers={"if-match": tag})
    assert (stale.status_code, stale.json()["reason"]) == (412, "ETAG_MISMATCH")
    assert http.patch(url, json={"display_name": "Nine"}, headers={"if-match": "*"}).status_code == 200
    named = http.patch(f"{url}?update_mask=display_name,labels", json={"labels": {"site": "north"}}).json()["session"]
    assert (named["display_name"], named["labels"]) == ("", {"site": "north"})
    one = {"params": {"planning": {"robot_radius_m": 0.31}}}
    after = http.patch(url, json=one).json()["session"]
    assert (after["params"]["planning"]["robot_radius_m"], after["labels"]) == (0.31, {"site": "north"})
    sensor = f"{url}/sensors/laser"
    tag = http.get(sensor).headers["etag"]
    policy = {"overload_policy": "OVERLOAD_POLICY_DROP_OLDEST"}
    changed = http.patch(sensor, json=policy, headers={"if-match": tag})
    assert changed.json()["sensor"]["spec"]["overload_policy"] == "OVERLOAD_POLICY_DROP_OLDEST"
    stale = http.patch(sensor, json={"overload_policy": "OVERLOAD_POLICY_BLOCK"}, headers={"if-match": tag})
    assert stale.status_code == 412


@pytest.mark.parametrize(
    ("query", "body", "status", "reason", "field"),
    [
        ("?update_mask=colour", {}, 400, "MASK_PATH_UNKNOWN", "update_mask"),
        ("?update_mask=params.sparkle", {}, 400, "MASK_PATH_UNKNOWN", "update_mask"),
        ("?update_mask=pose", {}, 400, "FIELD_READ_ONLY", "pose"),
        ("?update_mask=sensors", {}, 400, "FIELD_READ_ONLY", "sensors"),
        ("?update_mask=display_name&update_mask=labels", {}, 400, "QUERY_INVALID", "update_mask"),
        ("?mask=display_name", {}, 400, "QUERY_INVALID", "mask"),
        ("", {}, 400, "FIELD_MISSING", "update_mask"),
        ("", {"mode": "SESSION_MODE_INGEST_ONLY"}, 400, "FIELD_IMMUTABLE", "mode"),
        ("", {"session_id": "another"}, 400, "PATH_MISMATCH", "session.session_id"),
        ("", {"displayname": "A"}, 400, "JSON_INVALID", "displayname"),
        ("", {"labels": {"a b": "c"}}, 400, "LABELS_INVALID", "labels"),
    ],
)
def test_a_patch_that_cannot_be_is_refused_by_name(http, client, name, query, body, status, reason, field):
    client.sessions.create(name)
    answer = http.patch(f"/v1/sessions/{name}{query}", json=body)
    problem = answer.json()
    assert (answer.status_code, problem["reason"], problem["field"]) == (status, reason, field)


def test_a_session_that_is_read_may_be_sent_back_whole(http, client, name):
    """What the server tells is no change, so that a client may edit what it got."""
    client.sessions.create(name, sensors=[world.LASER])
    whole = http.get(f"/v1/sessions/{name}").json()["session"]
    whole["display_name"] = "Eight"
    changed = http.patch(f"/v1/sessions/{name}", json=whole)
    assert changed.status_code == 200, changed.text
    assert changed.json()["session"]["display_name"] == "Eight"
    again = http.patch(f"/v1/sessions/{name}", json=whole)
    assert (again.status_code, again.json()["reason"]) == (412, "ETAG_MISMATCH"), "its own etag counts"


@pytest.mark.parametrize("tag", ["unquoted", 'W/"weak"', '"a", "b"', '""'])
def test_a_tag_that_is_none_is_refused(http, client, name, tag):
    client.sessions.create(name)
    answer = http.patch(f"/v1/sessions/{name}", json={"display_name": "A"}, headers={"if-match": tag})
    assert (answer.status_code, answer.json()["reason"]) == (400, "HEADER_INVALID")

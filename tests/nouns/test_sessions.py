from __future__ import annotations

import asyncio
import dataclasses

import percept
import pytest
from percept import (
    AlreadyExists,
    AsyncClient,
    FailedPrecondition,
    InvalidArgument,
    Keyframe,
    NotFound,
    Pose,
    PoseEstimate,
    Resync,
    SensorSpec,
)

from support import world


def send_scans(session, first, last):
    poses = world.drive(last)
    with session.stream() as stream:
        for i in range(first, last):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))
    assert stream.summary.rejected == 0


def test_a_session_is_created_found_listed_and_deleted(client, name):
    session = client.sessions.create(name, display_name="Robot Seven", sensors=[world.LASER])
    info = client.sessions.get(name).info()
    assert (info.session_id, info.display_name, info.mode) == (name, "Robot Seven", "mapping")
    assert info.create_time_ns > 1_600_000_000 * 10**9
    assert [s.spec.sensor_id for s in info.sensors] == ["laser"]
    assert (info.pose, info.num_keyframes, info.num_objects) == (None, 0, 0)
    assert name in [s.session_id for s in client.sessions.list()]
    session.delete()
    with pytest.raises(NotFound) as error:
        client.sessions.get(name)
    assert error.value.reason == "SESSION_NOT_FOUND"
    with pytest.raises(NotFound):
        session.delete()


def test_a_session_without_a_name_is_given_one(client):
    one, two = client.sessions.create(), client.sessions.create()
    assert one.session_id != two.session_id


def test_pages_join_to_the_whole_list(client, name):
    names = sorted(f"{name}-{i}" for i in range(5))
    for n in names:
        client.sessions.create(n)
    listed = [s.session_id for s in client.sessions.list(page_size=2)]
    assert [n for n in listed if n.startswith(name)] == names
    assert listed == sorted(listed)


def test_creation_is_idempotent_by_its_request_id(client, name):
    one = client.sessions.create(request_id=name)
    two = client.sessions.create(request_id=name)
    assert one.session_id == two.session_id


def test_a_name_that_is_taken_is_refused(client, name):
    client.sessions.create(name)
    with pytest.raises(AlreadyExists) as error:
        client.sessions.create(name)
    assert (error.value.reason, error.value.field) == ("SESSION_EXISTS", "session_id")


def test_a_program_that_is_run_again_goes_on_with_its_session(client, name):
    second = dataclasses.replace(world.LASER, sensor_id="second")
    first = client.sessions.create(name, sensors=[world.LASER], exist_ok=True)
    first.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    again = client.sessions.create(name, sensors=[world.LASER, second], exist_ok=True)
    assert again.pose() == first.pose()
    assert {s.spec.sensor_id for s in again.sensors.list()} == {"laser", "second"}
    moved = dataclasses.replace(world.LASER, t_base_sensor=Pose.from_xyz(1.0, 0.0, 0.0))
    with pytest.raises(FailedPrecondition) as error:
        client.sessions.create(name, sensors=[moved], exist_ok=True)
    assert error.value.reason == "SENSOR_IN_USE"


@pytest.mark.parametrize("bad", ["a/b", "..", "ü", "a b", "x" * 65])
def test_impossible_names_are_refused(client, bad):
    with pytest.raises(InvalidArgument) as error:
        client.sessions.create(bad)
    assert (error.value.reason, error.value.field) == ("ID_INVALID", "session_id")


def test_two_sensors_of_one_name_are_refused(client):
    with pytest.raises(InvalidArgument) as error:
        client.sessions.create(sensors=[world.LASER, world.LASER])
    assert error.value.reason == "SENSOR_DECLARED_TWICE"


def leaves(tree, path=()):
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, (*path, name))
        else:
            yield (*path, name), value


def nested(path, value):
    for name in reversed(path):
        value = {name: value}
    return value


def test_parameters_that_are_set_replace_the_defaults(client):
    defaults = client.sessions.default_params()
    path = ("map", "cloud", "voxel_size_m")
    value = dict(leaves(defaults))[path]
    session = client.sessions.create(params=nested(path, value * 2))
    changed = {p: v for p, v in leaves(session.info().params) if v != dict(leaves(defaults)).get(p)}
    assert changed.pop(("preset",)) == "indoor"
    assert changed == {path: pytest.approx(value * 2)}


def test_parameters_out_of_their_bounds_are_refused_by_name(client):
    defaults = client.sessions.default_params()
    path = ("map", "cloud", "voxel_size_m")
    value = dict(leaves(defaults))[path]
    with pytest.raises(InvalidArgument) as error:
        client.sessions.create(params=nested(path, -value))
    assert error.value.reason == "PARAMETER_OUT_OF_RANGE"
    assert error.value.field.startswith("params")
    assert "voxel_size_m" in f"{error.value.field} {error.value.message}"


def test_choices_are_words_and_unknown_ones_are_refused_by_name(client):
    def choose(features):
        return client.sessions.create(params=nested(path, features))

    path = ("slam", "odometry", "keyframe", "features")
    assert dict(leaves(client.sessions.default_params()))[path] == "orb"
    assert dict(leaves(choose("sift").info().params))[path] == "sift"
    with pytest.raises(InvalidArgument) as error:
        choose("surf")
    assert error.value.field == "params.slam.odometry.keyframe.features"
    assert "'surf'; choose one of orb, sift" in error.value.message
    # A newer client may know more than this server.
    with pytest.raises(InvalidArgument) as error:
        choose(9)
    assert error.value.reason == "PARAMETER_OUT_OF_RANGE"
    assert error.value.field == "params.slam.odometry.keyframe.features"
    assert "9 is unknown; use orb or sift" in error.value.message


def test_a_trajectory_follows_the_robot(client, laser_session):
    trajectory = laser_session.trajectory()
    poses = world.drive(30)
    assert trajectory.stamps_ns.tolist() == [world.stamp(i) for i in range(30)]
    assert set(trajectory.states) <= {"initialising", "tracking"}
    truth = world.truth_in_map(poses)
    estimate = trajectory.t_map_base
    errors = [abs(e[:2, 3] - t[:2, 3]).max() for e, t in zip(estimate, truth, strict=True)]
    # Scans are exact; what is left is the discretisation of the local map.
    assert max(errors) < 0.03
    assert trajectory.length_m == pytest.approx(29 * 0.02, rel=0.3)


def test_keyframes_are_counted_and_belong_to_the_trajectory(laser_session):
    keyframes = list(laser_session.keyframes(page_size=1))
    assert [k.keyframe_id for k in keyframes] == list(range(len(keyframes)))
    assert len(keyframes) >= 1
    trajectory = laser_session.trajectory()
    marked = [i for i in trajectory.keyframe_ids if i is not None]
    assert marked == [k.keyframe_id for k in keyframes]
    stamps = dict(zip(trajectory.keyframe_ids, trajectory.stamps_ns.tolist(), strict=True))
    assert all(stamps[k.keyframe_id] == k.stamp_ns for k in keyframes)
    assert laser_session.info().num_keyframes == len(keyframes)


def test_lost_is_a_state_not_an_error(client):
    """The robot is carried away between two scans, into another room as it were."""
    session = client.sessions.create(sensors=[world.LASER])
    send_scans(session, 0, 5)
    elsewhere = world.scan(world.drive(1)[0])
    elsewhere["ranges_m"] = elsewhere["ranges_m"][::-1] * 0.2 + 0.1
    result = session.send_scan("laser", stamp_ns=world.stamp(100), **elsewhere)
    assert result.pose is not None
    assert result.pose.state == "lost"
    assert result.pose.lost
    assert result.pose.lost_reason != "unspecified"
    assert result.pose.lost_message
    assert session.pose() == result.pose
    # What a lost robot sees does not enter the map.
    assert result.keyframe_id is None


def test_ingest_only_counts_and_does_nothing_more(client):
    session = client.sessions.create(mode="ingest_only", sensors=[world.CAMERA])
    depth = world.depth_image(world.drive(1)[0])
    for i in range(3):
        result = session.send_depth("camera", stamp_ns=world.stamp(i), depth=depth, metres_per_unit=0.001)
        assert result.pose is None
    info = session.info()
    assert (info.mode, info.pose, info.num_keyframes) == ("ingest_only", None, 0)
    assert info.sensors[0].accepted == 3


def test_a_watch_tells_what_happens_and_resumes_after_a_token(client):
    session = client.sessions.create(sensors=[world.LASER])
    with session.watch() as watch:
        send_scans(session, 0, 3)
        seen = []
        while sum(isinstance(e.event, PoseEstimate) for e in seen) < 3:
            seen.append(next(watch))
    assert [e.token for e in seen] == list(range(seen[0].token, seen[0].token + len(seen)))
    assert any(isinstance(e.event, Keyframe) for e in seen)
    send_scans(session, 3, 5)
    with session.watch(resume_token=watch.token) as again:
        resumed = []
        while sum(isinstance(e.event, PoseEstimate) for e in resumed) < 2:
            resumed.append(next(again))
    assert resumed[0].token == watch.token + 1
    assert [e.event.stamp_ns for e in resumed if isinstance(e.event, PoseEstimate)] == [
        world.stamp(3),
        world.stamp(4),
    ]


def test_a_token_that_the_server_never_gave_gets_a_resync(client):
    session = client.sessions.create(sensors=[world.LASER])
    send_scans(session, 0, 1)
    with session.watch(resume_token=10**9) as watch:
        assert isinstance(next(watch).event, Resync)


def test_a_token_of_a_session_that_is_gone_gets_a_resync_in_another_of_its_name(client, name):
    for _ in range(2):
        session = client.sessions.create(name, sensors=[world.LASER])
        with session.watch(resume_token=0) as watch:
            send_scans(session, 0, 3)
            seen = [next(watch) for _ in range(3)]
        assert not any(isinstance(e.event, Resync) for e in seen), "0 means from the very first"
        last = seen[-1].token
        session.delete()
    session = client.sessions.create(name, sensors=[world.LASER])
    send_scans(session, 0, 9)
    with session.watch(resume_token=last) as watch:
        assert isinstance(next(watch).event, Resync)


def test_asyncio_does_the_same(server):
    async def scenario():
        async with AsyncClient(server.grpc) as client:
            assert await client.health()
            session = await client.sessions.create(sensors=[world.LASER])
            async with session.watch() as watch, session.stream() as stream:
                for i, pose in enumerate(world.drive(5)):
                    await stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
                acks = [ack async for ack in stream.acks()]
                assert [a.accepted for a in acks] == [True] * 5
                await anext(watch)
            assert stream.summary.durable == 5
            pose, trajectory, grid = await asyncio.gather(session.pose(), session.trajectory(), session.map.occupancy())
            assert pose.stamp_ns == trajectory.stamps_ns[-1] == world.stamp(4)
            assert grid.stamp.map_version == pose.map_version
            assert [k.keyframe_id async for k in session.keyframes()][:1] == [0]
            with pytest.raises(percept.NotFound):
                await client.sessions.get("nobody")
            await session.delete()

    asyncio.run(scenario())


def test_the_preset_goes_by_the_sensors_and_what_is_set_stands_over_it(client):
    far = SensorSpec("lidar", kind="lidar3d", range_max_m=120.0)
    outdoors = client.sessions.create(sensors=[far]).info()
    assert outdoors.params["preset"] == "outdoor"
    assert outdoors.sensors[0].spec.range_max_m == 120.0
    assert outdoors.params["map"]["occupancy"]["resolution_m"] == 0.2
    assert outdoors.params["map"]["height"]["enabled"]
    own = {"map": {"occupancy": {"resolution_m": 0.1}}}
    finer = client.sessions.create(sensors=[far], params=own).info()
    assert finer.params["map"]["occupancy"]["resolution_m"] == 0.1
    assert finer.params["map"]["cloud"]["voxel_size_m"] == 0.2
    indoors = client.sessions.create(sensors=[far], params={"preset": "indoor"}).info()
    usual = client.sessions.create().info()
    assert indoors.params == usual.params
    assert usual.params["preset"] == indoors.params["preset"]

"""What zenoh alone has: publishing, gaps, refused frames that only counters tell."""

from __future__ import annotations

import threading

import pytest
from percept import (
    FailedPrecondition,
    InvalidArgument,
    Keyframe,
    MapChanged,
    NotFound,
    PerceptError,
    PoseEstimate,
    SensorSpec,
)
from percept.v1 import error_pb2, session_pb2, sessions_service_pb2
from percept.zenoh import MapReader, SensorPublisher

from support import world
from support.server import eventually


@pytest.fixture
def session(client):
    return client.sessions.create(sensors=[world.LASER])


def test_poses_and_events_are_published_after_every_frame(server, session):
    poses = world.drive(6)
    with (
        MapReader(server.zenoh, session_id=session.session_id) as reader,
        SensorPublisher(server.zenoh, session_id=session.session_id) as publisher,
        reader.poses() as published,
        reader.events() as events,
    ):
        for i, pose in enumerate(poses):
            publisher.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
        received = []
        while not received or received[-1].stamp_ns < world.stamp(5):
            received.append(published.receive(timeout_s=10))
        assert isinstance(received[-1], PoseEstimate)
        truth = world.truth_in_map(poses)[-1]
        assert world.position_error_m(received[-1].t_map_base, truth) < 0.03
        seen = []
        of_poses = []
        while not of_poses or of_poses[-1] < world.stamp(5):
            seen.append(events.receive(timeout_s=10))
            of_poses = [e.event.stamp_ns for e in seen if isinstance(e.event, PoseEstimate)]
        # The first frame is a keyframe and gives the map its first version; each frame has a pose.
        assert {type(e.event) for e in seen} == {PoseEstimate, Keyframe, MapChanged}
        assert of_poses == [world.stamp(i) for i in range(6)]
        assert [e.event.keyframe_id for e in seen if isinstance(e.event, Keyframe)][:1] == [0]
        assert [e.token for e in seen] == list(range(seen[0].token, seen[0].token + len(seen)))


def test_missing_numbers_are_counted(server, session):
    scans = [world.scan(pose) for pose in world.drive(3)]
    with SensorPublisher(server.zenoh, session_id=session.session_id) as publisher:
        publisher.send_scan("laser", stamp_ns=world.stamp(0), **scans[0])
        publisher._sequences["laser"] += 5
        publisher.send_scan("laser", stamp_ns=world.stamp(1), **scans[1])
        assert eventually(lambda: session.sensors.list()[0].accepted == 2)
    status = session.sensors.list()[0]
    assert status.gaps == 5
    assert "5" in status.verdict_message


def test_noise_is_counted_as_refused_and_harms_nobody(server, session):
    with (
        SensorPublisher(server.zenoh, session_id=session.session_id) as publisher,
        MapReader(server.zenoh, session_id=session.session_id) as reader,
    ):
        publisher.publish_raw("laser", b"\xff" * 100)
        publisher.publish_raw("nobody", b"\xff" * 100)
        assert eventually(lambda: reader.sensors()[0].rejected == 1)
        publisher.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
        assert eventually(lambda: reader.sensors()[0].accepted == 1)
        assert reader.graph().nodes
        assert reader.objects() == list(session.scene.objects())
        assert reader.rooms() == session.scene.rooms(with_places=True)
        assert eventually(lambda: reader.occupancy().cells.size > 0)
        assert reader.cloud().stamp.frame_id == "map"


def test_questions_about_nothing_are_errors(server, name):
    with MapReader(server.zenoh, session_id=name) as reader, pytest.raises(NotFound) as error:
        reader.occupancy()
    assert error.value.reason == "SESSION_NOT_FOUND"


def flooded(server, client, policy, count):
    """A camera's status after it has sent faster than the server works, far more than its queue holds."""
    camera = SensorSpec(
        "camera",
        kind="depth",
        t_base_sensor=world.CAMERA.t_base_sensor,
        intrinsics=world.INTRINSICS,
        overload_policy=policy,
    )
    session = client.sessions.create(sensors=[camera])
    images = [world.depth_image(pose) for pose in world.drive(8)]

    def status():
        return session.sensors.list()[0]

    def done(s):
        return s.accepted + s.dropped + s.rejected

    with SensorPublisher(server.zenoh, session_id=session.session_id) as publisher:
        for i in range(count):
            publisher.send_depth("camera", stamp_ns=world.stamp(i), depth=images[i % 8], metres_per_unit=0.001)
        assert eventually(lambda: done(status()) == count, seconds=60)
    return status()


def test_a_slow_server_holds_a_blocking_sensor_instead_of_losing_frames(server, client):
    # Of as many frames, a sensor that may drop some does: they come faster than they are worked on.
    count = 60
    assert flooded(server, client, "drop_oldest", count).dropped > 0
    status = flooded(server, client, "block", count)
    assert (status.accepted, status.dropped, status.gaps, status.rejected) == (count, 0, 0, 0)


def test_a_busy_session_does_not_hold_another(server, client):
    busy, other = (client.sessions.create(sensors=[world.LIDAR, world.LASER]) for _ in range(2))
    clouds = [world.cloud(pose, rings=64, columns=1800) for pose in world.drive(8)]
    count, sent, taken = 240, 0, 0

    def flood():
        nonlocal sent
        with SensorPublisher(server.zenoh, session_id=busy.session_id) as publisher:
            for i in range(count):
                publisher.send_cloud("lidar", stamp_ns=world.stamp(i), points=clouds[i % 8])
                sent = i + 1

    def accepted(session, sensor_id):
        return {s.spec.sensor_id: s.accepted for s in session.sensors.list()}[sensor_id]

    def is_taken():
        nonlocal taken
        now = accepted(busy, "lidar")
        if accepted(other, "laser") == 2:
            return True
        # Only what was seen while the scan waited counts: this thread may itself be late.
        taken = now
        return False

    with SensorPublisher(server.zenoh, session_id=other.session_id) as publisher:
        # The first of a sensor waits until the server listens.
        first, second = (world.scan(pose) for pose in world.drive(2))
        publisher.send_scan("laser", stamp_ns=world.stamp(0), **first)
        flooding = threading.Thread(target=flood)
        flooding.start()
        # Many frames fill the buffers on the way: sent, and not taken yet.
        are_ahead = eventually(lambda: 5 < accepted(busy, "lidar") < sent - 20, seconds=30)
        assert are_ahead, "frames were taken as fast as they came; this shows nothing"
        before, ahead = accepted(busy, "lidar"), sent
        publisher.send_scan("laser", stamp_ns=world.stamp(1), **second)
        assert eventually(is_taken, seconds=30)
        assert taken - before < 0.7 * (ahead - before), "it waited behind the busy session's frames"
        flooding.join()
    assert eventually(lambda: accepted(busy, "lidar") == count, seconds=60)


def test_a_robot_plugs_in_by_zenoh_alone(server, name):
    """Nothing but zenoh: the session and its sensors, frames, questions with words, what changes a session."""
    poses = world.drive(8)
    with SensorPublisher(server.zenoh, session_id=name, sensors=[world.LASER]) as publisher:
        for i, pose in enumerate(poses):
            publisher.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
        robot = publisher.session
        assert eventually(lambda: robot.info().last_stamp_ns == world.stamp(7))
        assert robot.pose() == MapReader(server.zenoh, session_id=name).pose()
        position = robot.pose().t_map_base.translation
        found = robot.space.points([position, [position[0] + 500.0, 0.0, 0.0]])
        assert [str(s) for s in found.states] == ["free", "unknown"]
        assert robot.plan((position[0] + 0.3, position[1]))
        assert next(iter(robot.keyframes())).keyframe_id == 0
        assert len(robot.trajectory().stamps_ns) == 8
        assert robot.map.occupancy().cells.shape == MapReader(server.zenoh, session_id=name).occupancy().cells.shape
        robot.update(display_name="by zenoh")
        assert robot.info().display_name == "by zenoh"
        with pytest.raises(InvalidArgument) as error:
            robot.plan((float("nan"), 0.0))
        assert error.value.field.startswith("goal")
        with pytest.raises(FailedPrecondition, match=r"percept\.Client"):
            robot.watch()
    # Again, as a program that is started anew; and with another sensor of that name.
    with SensorPublisher(server.zenoh, session_id=name, sensors=[world.LASER]) as publisher:
        assert publisher.session.info().display_name == "by zenoh"
    other = SensorSpec("laser", kind="lidar3d")
    with pytest.raises(PerceptError) as error:
        SensorPublisher(server.zenoh, session_id=name, sensors=[other])
    assert error.value.reason == "SENSOR_IN_USE"


def test_a_wildcard_asks_all_sessions_that_are_awake(server, client, name):
    ids = [f"{name}-{i}" for i in range(3)]
    for i, session_id in enumerate(ids):
        client.sessions.create(session_id, sensors=[world.LASER]).send_scan(
            "laser", stamp_ns=world.stamp(i), **world.scan(world.drive(1)[0])
        )
    with MapReader(server.zenoh, session_id=ids[0]) as reader:
        network = reader._zenoh

        def asked(key, request=None):
            replies = list(network.get(key, payload=request, timeout=10.0))
            refused = [error_pb2.ErrorInfo.FromString(r.err.payload.to_bytes()) for r in replies if r.ok is None]
            return {str(r.ok.key_expr): r.ok.payload.to_bytes() for r in replies if r.ok is not None}, refused

        said, refused = asked(f"percept/{name}-$*/pose")
        assert set(said) == {f"percept/{i}/pose" for i in ids} and not refused
        stamps = {session_pb2.PoseEstimate.FromString(data).stamp_ns for data in said.values()}
        assert stamps == {world.stamp(i) for i in range(3)}
        said, refused = asked(f"percept/{name}-$*/rpc/SessionsService/GetPose")
        assert len(said) == 3 and not refused
        said, refused = asked(f"percept/{ids[0]}/scene/*")
        assert set(said) == {f"percept/{ids[0]}/scene/{what}" for what in ("graph", "objects", "rooms")}
        # What changes a session is asked of one that is named, and nobody means all rpcs.
        said, refused = asked(f"percept/{name}-$*/rpc/SessionsService/UpdateSession", b"")
        assert not said and refused[0].reason == "KEY_UNKNOWN" and "name the session" in refused[0].message
        assert asked(f"percept/{ids[0]}/rpc/**") == ({}, [])
        for key, request, reason in (
            (f"percept/{ids[0]}/rpc/SessionsService/Nothing", b"", "KEY_UNKNOWN"),
            (f"percept/{ids[0]}/rpc/SessionsService/ListSessions", b"", "KEY_UNKNOWN"),
            (f"percept/{ids[0]}/rpc/SessionsService/GetPose", b"\xff\xff", "PROTOBUF_INVALID"),
            (
                f"percept/{ids[0]}/rpc/SessionsService/GetPose",
                sessions_service_pb2.GetPoseRequest(session_id=ids[1]).SerializeToString(),
                "PATH_MISMATCH",
            ),
            (f"percept/{name}-nobody/rpc/SessionsService/GetPose", b"", "SESSION_NOT_FOUND"),
        ):
            said, refused = asked(key, request)
            assert not said and [r.reason for r in refused] == [reason], key


def test_who_is_there_is_told_by_liveliness(server, session):
    session_id = session.session_id
    session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    with MapReader(server.zenoh, session_id=session_id) as reader:
        assert eventually(reader.is_alive)
        publisher = SensorPublisher(server.zenoh, session_id=session_id)
        publisher.send_scan("laser", stamp_ns=world.stamp(1), **world.scan(world.drive(2)[1]))
        assert eventually(lambda: session.info().last_stamp_ns == world.stamp(1))
        assert not session.info().stream_notes
        # Gone without a word; what is no sensor of the session is not told of.
        strange = publisher._zenoh.liveliness().declare_token(f"percept/{session_id}/nothing/alive")
        assert strange
        publisher._zenoh.close()
        assert eventually(lambda: session.info().stream_notes)
        (note,) = session.info().stream_notes
        assert note.stream == "laser" and "left the zenoh network" in note.message
        with SensorPublisher(server.zenoh, session_id=session_id) as again:
            again.send_scan("laser", stamp_ns=world.stamp(2), **world.scan(world.drive(3)[2]))
            assert eventually(lambda: not session.info().stream_notes)
        session.delete()
        assert eventually(lambda: not reader.is_alive())

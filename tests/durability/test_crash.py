"""Killed, stopped, reopened: what was acknowledged as durable is there, and the session goes on."""

from __future__ import annotations

import numpy as np
import pytest
from percept import Client, Resync, Unavailable

from support import world
from support.server import Server, free_port


def stream_until_killed(server, session, poses, kill_after):
    """Streams; kills the server once so many are acknowledged. Returns the largest durable count seen."""
    stream = session.stream(max_in_flight=8, resume=False)
    with pytest.raises(Unavailable):
        for i, pose in enumerate(poses):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
            summary = stream.summary
            if summary.accepted + summary.rejected >= kill_after:
                server.kill()
        stream.close()
    assert stream.summary.rejected == 0
    return stream.summary.durable


@pytest.mark.parametrize("kill_after", [5, 17, 40])
def test_what_was_durable_survives_a_kill_and_the_session_goes_on(own_server, kill_after):
    poses = world.drive(120)
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER], display_name="Seven")
        durable = stream_until_killed(own_server, session, poses, kill_after)

    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.sessions.get("robot")
        assert session.info().display_name == "Seven"
        trajectory = session.trajectory()
        kept = len(trajectory)
        assert kept >= durable
        assert trajectory.stamps_ns.tolist() == [world.stamp(i) for i in range(kept)]
        truth = np.array(world.truth_in_map(poses))[:kept]
        assert np.abs(trajectory.positions[:, :2] - truth[:, :2, 3]).max(initial=0) < 0.05
        if kept:
            assert session.map.occupancy().cells.size > 0
            assert session.info().num_keyframes == len(list(session.keyframes())) >= 1
            # A frame that is already in does nothing more when it is sent again.
            session.send_scan("laser", stamp_ns=world.stamp(kept - 1), **world.scan(poses[kept - 1]))
            assert len(session.trajectory()) == kept
        with session.stream() as stream:
            for i in range(kept, kept + 20):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))
        assert stream.summary.durable == 20
        pose = session.pose()
        assert pose.state == "tracking"
        truth = world.truth_in_map(poses)[kept + 19]
        assert world.position_error_m(pose.t_map_base, truth) < 0.08
        assert len(session.trajectory()) == kept + 20


def test_a_single_frame_is_durable_when_it_is_answered(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        for i, pose in enumerate(world.drive(3)):
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        assert len(client.session("robot").trajectory()) == 3


def test_creation_declaration_and_deletion_are_durable_when_answered(own_server):
    with Client(own_server.grpc) as client:
        client.sessions.create("kept", request_id="once").sensors.declare(world.LASER)
        client.sessions.create("gone").delete()
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        assert [s.session_id for s in client.sessions.list()] == ["kept"]
        assert client.session("kept").sensors.list()[0].spec == world.LASER
        assert client.sessions.create(request_id="once").session_id == "kept"


def test_a_graceful_stop_keeps_everything(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        with session.stream() as stream:
            for i, pose in enumerate(world.lidar_drive()):
                stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=world.cloud(pose))
        before = session.trajectory()
        grid, cloud = session.map.occupancy(), session.map.cloud()
        keyframes = list(session.keyframes())
        assert len(keyframes) > 1
        assert (grid.cells > 50).any()
    assert own_server.stop() == 0
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.session("robot")
        after = session.trajectory()
        assert np.array_equal(after.stamps_ns, before.stamps_ns)
        assert np.allclose(after.positions, before.positions, atol=1e-6)
        assert [k.stamp_ns for k in session.keyframes()] == [k.stamp_ns for k in keyframes]
        # The same keyframes in the same order give the same map, to the byte.
        again, cloud_again = session.map.occupancy(), session.map.cloud()
        assert np.array_equal(again.origin, grid.origin)
        assert np.array_equal(again.cells, grid.cells)
        assert np.array_equal(cloud_again.cloud.points, cloud.cloud.points)


def test_a_stop_in_the_middle_of_a_stream_tells_the_sender(own_server):
    with Client(own_server.grpc, timeout_s=10) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        scans = [world.scan(pose) for pose in world.drive(5)]
        stream = session.stream(resume=False)
        for i, scan in enumerate(scans):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        list(stream.acks())
        assert own_server.stop() == 0
        with pytest.raises(Unavailable):
            for i in range(5, 1000):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scans[0])
        stream.cancel()


@pytest.mark.parametrize("end", [Server.kill, Server.stop])
def test_a_watch_goes_on_when_the_server_is_back_and_is_told_that_events_are_missing(tmp_path, end):
    server = Server(tmp_path / "fixed", grpc=f"127.0.0.1:{free_port()}")
    try:
        with Client(server.grpc) as client:
            session = client.sessions.create("robot", sensors=[world.LASER])
            scan = world.scan(world.drive(1)[0])
            with session.watch(resume_token=0) as watch:
                session.send_scan("laser", stamp_ns=1, **scan)
                next(watch)
                end(server)
                server.start()
                # More events than before: their places in the order must not be taken for the old ones.
                for stamp_ns in range(2, 8):
                    session.send_scan("laser", stamp_ns=stamp_ns, **scan)
                events = []
                while not events or events[-1].stamp_ns < 7:
                    events.append(next(watch))
    finally:
        server.kill()
    new = [e for e in events if e.stamp_ns > 1 or isinstance(e.event, Resync)]
    assert isinstance(new[0].event, Resync)
    tokens = [e.token for e in events]
    assert tokens == sorted(set(tokens))


def test_a_stop_ends_a_watch_with_a_reason(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        # One that does not wait for the server to come back.
        with session.watch(resume_timeout_s=0) as watch:
            assert own_server.stop() == 0
            with pytest.raises(Unavailable) as error:
                next(watch)
    assert error.value.reason == "STOPPING"

"""A robot goes round and round: loops and what they moved survive a crash, and can be taken out."""

from __future__ import annotations

import numpy as np
from percept import Client

from support import world

ROUND, ROUNDS = world.ROUND, 32


def rounds(first: int, last: int):
    """Scans of frames `first` to `last`, those of the first round again and again."""
    scans = [world.scan(pose) for pose in world.circle()]
    return ((i, scans[i % ROUND]) for i in range(first, last))


def test_a_session_with_loops_goes_on_after_a_crash(own_server):
    end = ROUND * ROUNDS
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        with session.stream() as stream:
            for i, scan in rounds(0, end):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        assert stream.summary.durable == end
        session.map.optimise()
        loops, keyframes, before = list(session.map.loops()), list(session.keyframes()), session.trajectory()
    # 15 keyframes a round were made; those that newer ones stand for are gone.
    assert keyframes[-1].keyframe_id > 400 > len(keyframes) == len({k.keyframe_id for k in keyframes})
    alive = {k.keyframe_id for k in keyframes}
    assert len(loops) > 20
    assert all(loop.from_keyframe_id in alive and loop.to_keyframe_id in alive for loop in loops)
    own_server.kill()
    own_server.start()
    truth = np.array(world.truth_in_map(world.circle()))[np.arange(end) % ROUND, :3, 3]
    with Client(own_server.grpc) as client:
        session = client.session("robot")
        after = session.trajectory()
        assert np.array_equal(after.stamps_ns, before.stamps_ns)
        assert np.abs(after.positions - before.positions).max() < 0.01
        assert np.linalg.norm(after.positions - truth, axis=1).max() < 0.08
        assert [k.keyframe_id for k in session.keyframes()] == [k.keyframe_id for k in keyframes]
        assert [(x.loop_id, x.state) for x in session.map.loops()] == [(x.loop_id, x.state) for x in loops]
        believed = next(x.loop_id for x in loops if x.state == "active")
        assert session.map.veto_loop(believed).loop.state == "vetoed"
        assert session.map.allow_loop(believed).loop.state == "active"
        with session.stream() as stream:
            for i, scan in rounds(end, end + 2 * ROUND):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        assert stream.summary.durable == 2 * ROUND
        assert session.pose().state == "tracking"
        newest = session.trajectory().positions[end:]
        assert np.linalg.norm(newest - truth[: 2 * ROUND], axis=1).max() < 0.08
        assert max(x.loop_id for x in session.map.loops()) > max(x.loop_id for x in loops)

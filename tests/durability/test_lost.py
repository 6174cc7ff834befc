"""A robot is carried off while it sees nothing: it says so, finds itself, and a crash forgets none of it."""

from __future__ import annotations

import numpy as np
from percept import Client

from support import world

ROUND = world.ROUND
#: Frames before the robot is carried, those that see nothing, and where on the arc it is put down.
BEFORE, BLIND, AFTER = 2 * ROUND, 40, 3 * ROUND
PUT_DOWN = ROUND // 2


def frames():
    """Scans, and where the robot is in the map; none while it is carried."""
    poses = world.circle()
    truth = world.truth_in_map(poses)
    scans = [world.scan(pose) for pose in poses]
    covered = {**scans[0], "ranges_m": np.full(360, np.inf, dtype=np.float32)}
    yield from ((scans[i % ROUND], truth[i % ROUND]) for i in range(BEFORE))
    yield from ((covered, None) for _ in range(BLIND))
    yield from ((scans[(PUT_DOWN + i) % ROUND], truth[(PUT_DOWN + i) % ROUND]) for i in range(AFTER))


def test_who_was_carried_off_finds_itself_and_keeps_its_map_over_a_crash(own_server):
    placed = []
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        for i, (scan, truth) in enumerate(frames()):
            result = session.send_scan("laser", stamp_ns=world.stamp(i), **scan)
            if result.pose.state == "tracking":
                assert truth is not None, f"frame {i} shows nothing"
                placed.append((i, np.linalg.norm(result.pose.t_map_base.translation - truth[:3, 3])))
        session.map.optimise()
        before, loops = session.trajectory(), list(session.map.loops())
        keyframes = [k.t_map_base.translation for k in session.keyframes()]
    assert max(off for _, off in placed) < 0.1, "said to be where it was not"
    after_loss = [i for i, _ in placed if i >= BEFORE + BLIND]
    assert after_loss, "never found"
    # A lap has 7 m; a metre and a half of it must have been seen before a place counts.
    assert after_loss[0] < BEFORE + BLIND + ROUND
    assert after_loss == list(range(after_loss[0], BEFORE + BLIND + AFTER)), "lost again"
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.session("robot")
        assert np.abs(session.trajectory().positions - before.positions).max() < 1e-6
        # What odometry guessed while the robot was carried ties nothing: without a loop the map stays.
        believed = [x.loop_id for x in loops if x.state == "active"]
        session.map.veto_loop(believed[-1])
        now = [k.t_map_base.translation for k in session.keyframes()]
        assert np.linalg.norm(np.array(now) - keyframes, axis=1).max() < 0.05
        states = {x.loop_id: x.state for x in session.map.loops()}
        assert [states[k] for k in believed[:-1]] == ["active"] * (len(believed) - 1)

"""Small editions of the attacks: what they may cost is bounded, and who is served goes on being served.

`python attacks/try_all.py` runs them at full size and prints what they cost.
"""

from __future__ import annotations

import pytest
from percept import Client

from attacks import connections, payloads
from attacks.connections import Target
from support import raw, robots, world
from support.measure import peak_mb, reset_peak, rss_mb


@pytest.fixture
def target(own_server):
    """A server with a session of some frames, attacked for a moment at a tenth of the full number."""
    with Client(own_server.grpc) as client:
        robots.mapped(client, "victim", frames=20)
        yield Target(own_server, "victim", client, seconds=0.6, scale=0.1)


def unharmed(target: Target) -> bool:
    """Whether the session goes on: a frame, a question over each door."""
    session = target.client.session("victim")
    taken = robots.send_scans(session, 20, 23) == 3
    answer = raw.exchange(target.server.rest, raw.request_head("GET", "/v1/sessions/victim/pose", connection="close"))
    return taken and raw.status_of(answer) == 200 and session.pose().state == "tracking"


def cost_mb(target: Target, attack) -> float:
    """Memory that an attack makes the server take at most, and that it bears it."""
    pid = target.server.process.pid
    before = rss_mb(pid)
    reset_peak(pid)
    result = attack(target)
    cost = peak_mb(pid) - before
    assert not result.broken, result.broken
    assert unharmed(target)
    return cost


def test_pages_of_other_sites_are_not_served(target):
    assert payloads.dns_rebinding(target).broken == []


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "{}", "localhost:{port}"])
def test_who_calls_the_server_by_its_name_is_served(own_server, host):
    port = own_server.rest.rsplit(":", 1)[1]
    head = raw.request_head("GET", "/v1/sessions", host=host.format(own_server.rest, port=port), connection="close")
    assert raw.status_of(raw.exchange(own_server.rest, head)) == 200


def test_no_path_and_no_name_leads_out_of_the_data(target):
    assert cost_mb(target, payloads.path_traversal) < 50


def test_handles_cannot_be_guessed(target):
    assert payloads.guessed_handles(target).broken == []


def test_bodies_that_never_end_take_bounded_memory(target):
    target.scale = 0.25
    # 10 bodies of 41 MB.
    assert cost_mb(target, connections.endless_bodies) < 512


def test_messages_that_never_end_take_bounded_memory(target):
    target.scale = 0.4
    # 80 messages of 5 MB.
    assert cost_mb(target, connections.half_messages) < 250


def test_streams_that_are_opened_and_left_are_limited(target):
    result = connections.half_open_streams(target)
    # Two connections with 500 streams each; what is over the limit is refused.
    assert result.ended > 0
    assert unharmed(target)


def test_giant_heads_are_refused(target):
    assert cost_mb(target, connections.giant_headers) < 50


def test_a_head_that_goes_on_for_ever_is_cut_off(target):
    target.scale = 1.0
    assert connections.continuation_flood(target).ended
    assert unharmed(target)


def test_streams_that_are_reset_at_once_end_the_connection(target):
    target.scale = 0.5
    assert connections.rapid_reset(target).ended
    assert unharmed(target)


def test_pings_that_nobody_reads_take_bounded_memory(target):
    assert cost_mb(target, connections.ping_flood) < 50


def test_bombs_are_refused(target):
    assert cost_mb(target, payloads.image_bombs) < 100
    for bomb in (payloads.laz_bombs, payloads.gzip_bombs, payloads.nested_json):
        result = bomb(target)
        assert result.ended == result.sent, (bomb.__name__, result.note)


def test_garbage_over_zenoh_does_not_fill_the_log(target):
    before = target.server.log.stat().st_size
    result = payloads.zenoh_flood(target)
    assert result.sent > 1000
    assert not result.broken, result.broken
    grown = target.server.log.stat().st_size - before
    assert grown < 64 << 10, f"{result.sent} samples wrote {grown >> 10} KiB into the log"
    # The counters still tell.
    assert unharmed(target)


def test_storage_is_served_when_no_descriptor_is_left(target):
    result = connections.no_descriptors_left(target)
    assert result.sent > 200
    assert result.broken == []


def test_watchers_that_do_not_read_take_bounded_memory_and_hold_nobody_up(target):
    target.seconds = 1.5
    assert cost_mb(target, connections.unread_watchers) < 100


def test_a_watcher_that_came_late_is_told_so(target):
    """One that read nothing for long gets a resync, not a backlog, and the session was not held up."""
    session = target.client.session("victim")
    with session.watch() as watch:
        assert robots.send_scans(session, 20, 180) == 160
        session.sensors.declare(world.WHEELS)
        last = world.stamp(179)
        tokens = []
        while not tokens or tokens[-1][1] < last:
            event = next(watch)
            tokens.append((event.token, event.stamp_ns))
    assert [t for t, _ in tokens] == sorted({t for t, _ in tokens})

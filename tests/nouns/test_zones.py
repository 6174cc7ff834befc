"""Zones that are stored with a session: every path through its map keeps to them."""

from __future__ import annotations

import numpy as np
import pytest
from percept import GridMap, InvalidArgument, NoPath, Path, PathOptions, Zone

#: A hall of 8 x 4 m, its lower left corner at the origin.
HALL = GridMap(cells=np.zeros((80, 160), np.int8), resolution_m=0.05, origin=(0.0, 0.0))
START, GOAL = (1.0, 2.0), (7.0, 2.0)
#: Across the hall but for a gap of 1 m at its upper side.
BAR = Zone(polygon=[(3.9, -1), (4.1, -1), (4.1, 3.0), (3.9, 3.0)], name="wet floor")
WALL = Zone(polygon=[(3.9, -1), (4.1, -1), (4.1, 5), (3.9, 5)], name="closed")
SLOW = Zone(polygon=[(2, -1), (6, -1), (6, 5), (2, 5)], speed_share=0.2, name="nursery")


@pytest.fixture
def hall(client):
    params = {"map": {"occupancy": {"resolution_m": 0.05}}}
    session = client.sessions.create(params=params)
    session.map.import_map(HALL)
    return session


def test_paths_keep_to_the_zones_of_the_session(hall):
    straight = hall.plan(GOAL, start=START)
    assert isinstance(straight, Path)
    info = hall.update(zones=[BAR])
    assert [(z.name, len(z.polygon), z.speed_share) for z in info.zones] == [("wet floor", 4, None)]
    around = hall.plan(GOAL, start=START)
    assert around.length_m > straight.length_m + 0.3
    assert around.waypoints[:, 1].max() > 3.0
    # What was planned before is not to be driven any more, and says where.
    misfit = hall.validate_path(straight)
    assert misfit is not None
    assert abs(misfit.pose.translation[0] - 4.0) < 1.0
    hall.update(zones=[WALL])
    none = hall.plan(GOAL, start=START)
    assert isinstance(none, NoPath)
    assert none.reason == "unreachable"
    beyond = hall.plan(GOAL, start=START, options=PathOptions(ignore_session_zones=True))
    assert beyond.length_m == pytest.approx(straight.length_m)
    # Zones of the question come on top.
    hall.update(zones=[])
    assert isinstance(hall.plan(GOAL, start=START, options=PathOptions(zones=[WALL])), NoPath)
    assert hall.plan(GOAL, start=START).length_m == pytest.approx(straight.length_m)


def test_a_speed_zone_takes_time(hall):
    fast = hall.plan(GOAL, start=START)
    hall.update(zones=[SLOW])
    slow = hall.plan(GOAL, start=START)
    assert slow.duration_s > fast.duration_s + 5


def test_zones_stay_with_the_session_and_count_for_its_etag(client, hall):
    before = hall.info().etag
    hall.update(zones=[BAR, SLOW])
    info = client.session(hall.session_id).info()
    assert info.etag != before
    assert [z.name for z in info.zones] == ["wet floor", "nursery"]
    assert np.allclose(info.zones[0].polygon, BAR.polygon)
    assert info.zones[1].speed_share == 0.2
    # Another change leaves them alone.
    assert [z.name for z in hall.update(display_name="hall").zones] == ["wet floor", "nursery"]


@pytest.mark.parametrize(
    ("zone", "field"),
    [
        (Zone(polygon=[(0, 0), (1, 0)]), "zones[1]"),
        (Zone(polygon=[(0, 0), (1, 0), (1, 1)], speed_share=7.0), "zones[1]"),
        (Zone(polygon=[(0, 0), (1, 0), (1, 1)], name="x" * 65), "zones[1].name"),
    ],
)
def test_zones_that_are_none_are_refused_and_those_before_stay(hall, zone, field):
    hall.update(zones=[BAR])
    with pytest.raises(InvalidArgument) as error:
        hall.update(zones=[SLOW, zone])
    assert error.value.field == field
    assert [z.name for z in hall.info().zones] == ["wet floor"]

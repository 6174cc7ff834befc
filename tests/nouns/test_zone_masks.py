"""Zones cell by cell: the masks of nav2's costmap filters."""

from __future__ import annotations

import numpy as np
import pytest
from percept import (
    GridMap,
    InvalidArgument,
    NoPath,
    Path,
    PathOptions,
    ResourceExhausted,
    SpeedLimits,
    SpeedMask,
    ZoneMask,
)

from support.server import Server

#: A hall of 8 x 4 m, its lower left corner at the origin.
HALL = GridMap(cells=np.zeros((80, 160), np.int8), resolution_m=0.05, origin=(0.0, 0.0))
START, GOAL = (1.0, 2.0), (7.0, 2.0)


def mask_of(columns, rows, value=100, rest=0) -> GridMap:
    """Cells of 0.1 m over the hall, with a value in some."""
    cells = np.full((40, 80), rest, np.int8)
    cells[rows, columns] = value
    return GridMap(cells=cells, resolution_m=0.1, origin=(0.0, 0.0))


#: Across the hall but for a gap of 1 m at its upper side.
BAR = mask_of(slice(39, 41), slice(0, 30))


@pytest.fixture
def hall(client):
    session = client.sessions.create(params={"map": {"occupancy": {"resolution_m": 0.05}}})
    session.map.import_map(HALL)
    return session


def test_paths_keep_out_of_a_mask(hall):
    straight = hall.plan(GOAL, start=START)
    info = hall.update(zone_masks=[ZoneMask(name="wet floor", cells=BAR)])
    [told] = info.zone_masks
    assert (told.name, told.speed, told.cells) == ("wet floor", None, None)
    assert (told.geometry.width, told.geometry.height, told.geometry.resolution_m) == (80, 40, 0.1)
    around = hall.plan(GOAL, start=START)
    assert around.length_m > straight.length_m + 0.3
    assert around.waypoints[:, 1].max() > 3.0
    misfit = hall.validate_path(straight)
    assert misfit is not None
    assert misfit.blocking.state == "keep_out"
    whole = mask_of(slice(39, 41), slice(None))
    hall.update(zone_masks=[ZoneMask(name="closed", cells=whole)])
    none = hall.plan(GOAL, start=START)
    assert isinstance(none, NoPath)
    assert (none.reason, none.blocking.state) == ("unreachable", "keep_out")
    beyond = hall.plan(GOAL, start=START, options=PathOptions(ignore_session_zones=True))
    assert beyond.length_m == pytest.approx(straight.length_m)
    hall.update(zone_masks=[])
    assert hall.plan(GOAL, start=START).length_m == pytest.approx(straight.length_m)


def seconds(session, **speed) -> float:
    path = session.plan(GOAL, start=START, options=PathOptions(speed=SpeedLimits(**speed)))
    assert isinstance(path, Path), path
    return path.duration_s


def test_a_mask_of_speeds_is_per_cent_metres_a_second_or_by_base_and_multiplier(hall):
    free = seconds(hall)
    values = mask_of(slice(20, 60), slice(None), value=20)
    hall.update(zone_masks=[ZoneMask(name="slow", cells=values, speed=SpeedMask())])
    # Four metres at a fifth of 0.5 m/s take 32 s more, but for the ramps.
    fifth = seconds(hall)
    assert fifth - free == pytest.approx(32.0, abs=1.5)
    # 90 - 3.5 * 20 = 20 per cent; 0.02 + 0.004 * 20 = 0.1 m/s.
    falling = SpeedMask(base=90.0, multiplier=-3.5)
    absolute = SpeedMask(base=0.02, multiplier=0.004, unit="metres_per_second")
    for speed in (falling, absolute):
        # The cells stay.
        info = hall.update(zone_masks=[ZoneMask(name="slow", speed=speed)])
        assert info.zone_masks[0].speed == speed
        assert seconds(hall) == pytest.approx(fifth)
    # For a slower robot 0.1 m/s is no less, per cent are.
    assert seconds(hall, max_speed_mps=0.1) == pytest.approx(60.0, abs=0.5)


def test_masks_stay_with_the_session_also_over_a_restart(tmp_path):
    from percept import Client

    server = Server(tmp_path / "data")
    try:
        with Client(server.grpc) as client:
            session = client.sessions.create("depot", params={"map": {"occupancy": {"resolution_m": 0.05}}})
            session.map.import_map(HALL)
            before = session.info().etag
            slow = ZoneMask(name="slow", cells=mask_of(slice(20, 60), slice(None), 50, -1), speed=SpeedMask())
            session.update(zone_masks=[ZoneMask(name="wet floor", cells=BAR), slow])
            info, path = session.info(), session.plan(GOAL, start=START)
            assert info.etag != before
            # Another change leaves them alone, and lists do not tell them.
            assert session.update(display_name="depot").zone_masks == info.zone_masks
            assert [s.zone_masks for s in client.sessions.list()] == [()]
        server.stop()
        server.start()
        with Client(server.grpc) as client:
            session = client.session("depot")
            assert session.info().zone_masks == info.zone_masks
            again = session.plan(GOAL, start=START)
            assert np.array_equal(again.waypoints, path.waypoints)
            assert (again.cost, again.length_m) == (path.cost, path.length_m)
            assert session.map.export("overview_png").data.startswith(b"\x89PNG")
    finally:
        server.kill()


def pgm(folder, name, cells, mode, text=""):
    """A nav2 map's two files, cells as nav2 writes them raw."""
    height, width = cells.shape
    (folder / f"{name}.pgm").write_bytes(b"P5 %d %d 255\n" % (width, height) + cells[::-1].astype(np.uint8).tobytes())
    path = folder / f"{name}.yaml"
    path.write_text(
        f"image: {name}.pgm\nmode: {mode}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        f"occupied_thresh: 0.65\nfree_thresh: 0.25\n{text}"
    )
    return path


def test_nav2s_files_are_masks(hall, tmp_path):
    raw = pgm(tmp_path, "speed", mask_of(slice(20, 60), slice(None), 20).cells, "raw")
    free = seconds(hall)
    hall.update(zone_masks=[ZoneMask(name="slow", cells=raw, speed=SpeedMask())])
    assert seconds(hall) - free == pytest.approx(32.0, abs=1.5)
    # A trinary image knows no value between 0 and 100: as a mask of speeds it is a mistake, and the one before stays.
    trinary = pgm(tmp_path, "mistake", np.where(mask_of(slice(20, 60), slice(None)).cells, 0, 254), "trinary")
    with pytest.raises(InvalidArgument, match="mode: scale or raw") as error:
        hall.update(zone_masks=[ZoneMask(name="slow", cells=trinary, speed=SpeedMask())])
    assert error.value.field == "zone_masks[0].speed"
    assert seconds(hall) - free == pytest.approx(32.0, abs=1.5)
    hall.update(zone_masks=[ZoneMask(name="slow", cells=trinary)])
    assert isinstance(hall.plan(GOAL, start=START), NoPath)


@pytest.mark.parametrize(
    ("masks", "field"),
    [
        ([ZoneMask(name="")], "zone_masks[0].name"),
        ([ZoneMask(name="x" * 65, cells=BAR)], "zone_masks[0].name"),
        ([ZoneMask(name="a", cells=BAR), ZoneMask(name="a", cells=BAR)], "zone_masks[1].name"),
        ([ZoneMask(name="nobody")], "zone_masks[0].map"),
        ([ZoneMask(name="a", cells=GridMap(cells=np.zeros((0, 0), np.int8), resolution_m=0.1))], "zone_masks[0].grid"),
        (
            [ZoneMask(name="a", cells=GridMap(cells=np.full((2, 2), 101, np.int8), resolution_m=0.1))],
            "zone_masks[0].grid.cells",
        ),
        (
            [ZoneMask(name="a", cells=GridMap(cells=BAR.cells, resolution_m=np.nan))],
            "zone_masks[0].grid.geometry.resolution_m",
        ),
        ([ZoneMask(name="a", cells=BAR, speed=SpeedMask(base=np.nan))], "zone_masks[0].speed.base"),
        ([ZoneMask(name="a", cells=BAR, speed=SpeedMask(multiplier=1e9))], "zone_masks[0].speed.multiplier"),
        ([ZoneMask(name="a", cells=BAR, speed=SpeedMask(multiplier=-1.0))], "zone_masks[0].speed"),
        ([ZoneMask(name=str(i), cells=BAR) for i in range(9)], "zone_masks"),
    ],
)
def test_masks_that_are_none_are_refused_and_those_before_stay(hall, masks, field):
    hall.update(zone_masks=[ZoneMask(name="wet floor", cells=BAR)])
    with pytest.raises(InvalidArgument) as error:
        hall.update(zone_masks=masks)
    assert error.value.field == field, error.value
    assert [m.name for m in hall.info().zone_masks] == ["wet floor"]


def test_a_gigantic_mask_is_refused_before_it_is_read(hall, tmp_path):
    small = pgm(tmp_path, "huge", BAR.cells, "trinary")
    (tmp_path / "huge.pgm").write_bytes(b"P5 100000 100000 255\n\0")
    with pytest.raises(InvalidArgument) as error:
        hall.update(zone_masks=[ZoneMask(name="a", cells=small)])
    assert error.value.field == "zone_masks[0].nav2.image"
    noise = np.random.default_rng(1).integers(0, 101, (2000, 2000), np.int8)
    with pytest.raises(ResourceExhausted, match="packed") as refused:
        hall.update(zone_masks=[ZoneMask(name="a", cells=GridMap(cells=noise, resolution_m=0.1))])
    assert refused.value.field == "zone_masks"

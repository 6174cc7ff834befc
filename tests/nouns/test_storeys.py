"""A building of two floors, one above the other: paths on each of them."""

from __future__ import annotations

import numpy as np
import pytest
from percept import FailedPrecondition, GridMap, InvalidArgument, NoPath, Path, PathOptions, Pose, StoreyOptions

from support import world

#: Inside of the building, and what stands in it: the upper floor leaves a shaft open, where a lift goes up.
OUTER = (np.array([-1.0, -3.0, 0.0]), np.array([12.0, 3.0, 6.0]))
UPPER_M = 3.0
BOXES = [
    (np.array(low, float), np.array(high, float))
    for low, high in [
        ((1.5, -3.0, 2.8), (12.0, 3.0, UPPER_M)),
        # A low wall across the upper floor, with a gap at its left end.
        ((5.0, -3.0, UPPER_M), (5.2, 1.2, UPPER_M + 0.4)),
        ((3.0, 1.8, 0.0), (3.6, 2.4, 0.8)),
        ((-0.9, -2.5, 0.0), (-0.5, -1.5, 1.6)),
        ((-0.9, 1.0, 3.6), (-0.6, 2.0, 4.4)),
        ((6.5, -2.6, 0.0), (7.2, -2.0, 1.0)),
        ((8.8, 2.2, UPPER_M), (9.4, 2.8, UPPER_M + 1.0)),
    ]
]
AZIMUTH, ELEVATION = np.meshgrid(np.linspace(-np.pi, np.pi, 400, endpoint=False), np.linspace(-0.9, 0.6, 40))
RAYS = np.stack([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), np.sin(ELEVATION)], axis=-1)
START, GOAL = (3.5, -1.0), (7.0, -1.0)
#: Middle of the third.
BOX = (3.3, 2.1)


def cloud(x: float, y: float, z: float) -> np.ndarray:
    """(N, 3) of a lidar 1.2 m above base, sensor frame."""
    origin = np.array([x, y, z + 1.2])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((bound - origin) / RAYS for bound in OUTER)
        hit = np.fmax(a, b).min(-1)
        for low, high in BOXES:
            a, b = (low - origin) / RAYS, (high - origin) / RAYS
            near, far = np.fmin(a, b).max(-1), np.fmax(a, b).min(-1)
            hit = np.where((near < far) & (near > 0) & (near < hit), near, hit)
    return (RAYS * hit[..., None]).reshape(-1, 3).astype(np.float32)


@pytest.fixture(scope="module")
def building(client):
    """Nine metres along the lower floor and back, up in the lift, and along the upper floor."""
    session = client.sessions.create(sensors=[world.LIDAR], params={"map": {"height": {"enabled": True}}})
    below = [0.2 * i for i in range(46)]
    way = [(x, 0.0, 0.0) for x in below + below[-2::-1]]
    way += [(0.0, 0.0, 0.1 * i) for i in range(1, 31)] + [(0.1 * i, 0.0, UPPER_M) for i in range(1, 42)]
    with session.stream() as stream:
        for i, place in enumerate(way):
            stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=cloud(*place))
    assert np.linalg.norm(session.pose().t_map_base.translation - (4.1, 0.0, UPPER_M)) < 0.05
    return session


def on(storey: str, z: float = 0.0) -> PathOptions:
    return PathOptions(storey=StoreyOptions(storey=storey, near_z_m=z))


def test_a_path_is_planned_on_the_storey_that_is_asked_for(building):
    lower, upper = on("nearest", 0.0), on("nearest", UPPER_M)
    # A box stands there on the lower floor; above it there is nothing.
    in_the_box = building.plan(BOX, start=START, options=lower)
    assert isinstance(in_the_box, NoPath)
    assert in_the_box.reason in {"goal_occupied", "goal_does_not_fit", "goal_unknown"}
    above_it = building.plan(BOX, start=START, options=upper)
    assert isinstance(above_it, Path), above_it
    assert building.validate_path(above_it, options=upper) is None
    misfit = building.validate_path(above_it, options=lower)
    assert misfit is not None
    assert np.linalg.norm(misfit.pose.translation[:2] - BOX) < 1.0
    picture = building.draw_path(BOX, start=START, options=upper)
    assert picture.outcome == above_it
    # The wall of the upper floor.
    across = [Pose.from_xy_yaw(4.0, 2.0, -1.2), Pose.from_xy_yaw(4.2, 0.0, 0.0), Pose.from_xy_yaw(7.0, 0.0, 0.0)]
    stopped = building.validate_path(across, options=upper)
    assert stopped is not None
    assert 4.3 < stopped.pose.translation[0] < 5.3


def test_ground_that_is_not_of_the_storey_is_unknown(building):
    nowhere = building.plan(GOAL, start=START, options=on("nearest", 20.0))
    assert isinstance(nowhere, NoPath)
    assert nowhere.reason in {"start_unknown", "start_outside_map"}
    # In the shaft there is no upper floor.
    shaft = building.plan((0.0, -2.0), start=START, options=on("nearest", UPPER_M))
    assert isinstance(shaft, NoPath)


def test_a_storey_needs_heights_and_is_told_what_is_wrong(client, building, laser_session):
    with pytest.raises(FailedPrecondition) as off:
        laser_session.plan((0.5, 0.0), options=on("lowest"))
    assert (off.value.reason, off.value.field) == ("LAYER_OFF", "options.storey")
    for storey, field in [
        (StoreyOptions(storey="nearest", near_z_m=np.nan), "options.storey.near_z_m"),
        (StoreyOptions(storey="nearest", near_within_m=-1.0), "options.storey.near_within_m"),
    ]:
        with pytest.raises(InvalidArgument) as error:
            building.plan(GOAL, start=START, options=PathOptions(storey=storey))
        assert error.value.field == field
    flat = GridMap(cells=np.zeros((20, 20), np.int8), resolution_m=0.1)
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.plan_on_map(flat, (0.5, 0.5), (1.5, 1.5), options=on("lowest"))
    assert error.value.field == "options.storey"

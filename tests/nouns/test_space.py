from __future__ import annotations

import httpx
import numpy as np
import pytest
from percept import (
    FailedPrecondition,
    InvalidArgument,
    OrientedBox,
    Pose,
    Region,
    ResourceExhausted,
    SpaceState,
)

from support import world

UNKNOWN, FREE, OCCUPIED = SpaceState.UNKNOWN, SpaceState.FREE, SpaceState.OCCUPIED


@pytest.fixture
def http(server):
    with httpx.Client(base_url=server.rest_url, timeout=30) as client:
        yield client


def at(x, y, z):
    return [*world.to_map(x, y), z]


def test_points_are_free_occupied_or_unknown_and_know_how_far_the_next_wall_is(lidar_session):
    where = [at(0, 0, 1.0), at(2.98, 0.6, 1.0), at(1.6, 1.0, 0.3), at(0, 0, 9.0), at(2.2, 0.4, 1.5), at(2.3, -0.1, 0.4)]
    found = lidar_session.space.points(where)
    assert (found.layer, found.stamp.stamp_ns) == ("voxels", world.stamp(world.LIDAR_LAST))
    assert found.states[:4] == (FREE, OCCUPIED, UNKNOWN, UNKNOWN)
    assert found.distances_m[3] == pytest.approx(found.max_distance_m)
    assert found.max_distance_m > 1.8
    # The wall at x = 3 lies 0.8 m away, on the border of two voxels; the next to the last point is the floor.
    assert abs(found.distances_m[4] - 0.8) < 0.12
    assert found.gradients[4][0] < -0.8
    assert abs(found.distances_m[5] - 0.4) < 0.12
    assert found.gradients[5][2] > 0.8


def test_points_of_a_planar_map_are_asked_of_the_grid(laser_session):
    found = laser_session.space.points([at(0, 0, 1.0), at(2.3, 0.2, 0.0), at(3.5, 0, 0)])
    assert (found.layer, found.states[0], found.states[2]) == ("occupancy", FREE, UNKNOWN)
    assert abs(found.distances_m[1] - 0.7) < 0.16
    assert found.gradients[1][2] == 0
    assert laser_session.space.points(np.empty((0, 3))).states == ()


def test_rays_end_where_the_world_says(lidar_session):
    origin = np.array([-0.5, 0.2, 1.2])
    angles = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    ways = np.stack([np.cos(angles), np.sin(angles), np.full(90, -0.1)], axis=1)
    true = world.cast(origin, ways) * np.linalg.norm(ways, axis=1)
    found = lidar_session.space.rays([at(*origin)], ways * 3.0, max_range_m=10.0)
    assert set(found.states) == {OCCUPIED}
    off = np.abs(found.distances_m - true)
    # Walls lie on borders of voxels.
    assert np.median(off) < 0.11
    assert np.quantile(off, 0.9) < 0.3
    walked = np.linalg.norm(found.points - np.array(at(*origin)), axis=1)
    assert np.allclose(walked, found.distances_m)
    short = lidar_session.space.rays([at(*origin)], ways, max_range_m=0.5)
    assert set(short.states) == {FREE}
    assert np.all(short.distances_m == 0.5)
    up = lidar_session.space.rays([at(0, 0, 3.5)], [[0, 0, 1]], max_range_m=2.0, unknown_ends=True)
    assert (up.states, up.distances_m[0]) == ((UNKNOWN,), 0.0)


def box(x, y, z, size):
    return OrientedBox(t_frame_box=Pose.from_xyz(*at(x, y, z)), size_m=np.full(3, size))


def test_boxes_are_free_where_nothing_stands(lidar_session):
    found = lidar_session.space.boxes([box(0, 0, 1.0, 0.4), box(3.0, 0, 1.0, 0.4), box(0, 0, 9, 0.4), box(0, 0, 1, 0)])
    assert found.states == (FREE, OCCUPIED, UNKNOWN, FREE)
    assert (found.counts[0].tolist(), found.counts[3].tolist()) == ([0, 64, 0], [0, 1, 0])


def test_voxels_come_whole_in_a_box_and_by_what_changed(lidar_session):
    space = lidar_session.space
    whole = space.voxels()
    assert whole.voxel_size_m == 0.1
    walls = whole.centres()
    assert len(walls) > 2000
    # What is occupied lies where the world has a surface: floor, ceiling, walls or furniture.
    near = (walls[:, 2] < 0.1) | (walls[:, 2] > 2.4)
    first = np.array([*world.to_map(0, 0), 0.0])
    for low, high in [world.ROOM, *world.FURNITURE]:
        p = walls - first
        inside = np.all((p > low - 0.1) & (p < high + 0.1), axis=1)
        near |= inside & np.any((np.abs(p - low) < 0.1) | (np.abs(p - high) < 0.1), axis=1)
    assert near.mean() > 0.97
    part = space.voxels(low=at(-1, -1, 0.5), high=at(1, 1, 1.5), occupied_only=False)
    assert 20 * 20 * 10 * 0.8 < (part.cells >= 0).sum() <= 20 * 20 * 10
    assert (space.voxels(occupied_only=True).cells > 50).sum() == len(walls)
    changes = space.changes()
    assert changes.layer == "voxels"
    assert len(changes.regions) >= 1
    later = changes.stamp.map_version
    assert space.changes(later).regions == ()
    assert space.voxels(since_version=later).cells.size == 0
    assert len(space.changes(layer="cloud").regions) >= 1


def test_the_ground_is_where_the_floor_is_and_furniture_stands_on_it(lidar_session):
    heights = lidar_session.space.heights()
    assert heights.resolution_m == 0.1
    assert heights.ground_m.shape == heights.traversability.shape

    def cell(x, y):
        column, row = ((np.array(world.to_map(x, y)) - heights.origin) / 0.1).astype(int)
        return row, column

    # Between rings nothing was seen.
    row, column = cell(2.3, -0.1)
    floor = np.s_[row - 4 : row + 5, column - 4 : column + 5]
    assert abs(np.nanmedian(heights.ground_m[floor])) < 0.02
    assert np.nanmedian(heights.slope_rad[floor]) < 0.05
    assert np.nanmedian(heights.traversability[floor]) > 0.8
    # The table's edge stands 0.75 m above the floor.
    assert np.nanmax(heights.top_m[cell(1.25, 1.0)[0] - 1 : cell(1.25, 1.0)[0] + 2]) > 0.6
    part = lidar_session.space.heights(region=Region(0, 0, 1, 1))
    assert part.ground_m.shape == (11, 11)
    nearest = lidar_session.space.heights(storey="nearest", near_z_m=9.0)
    assert np.isnan(nearest.ground_m).all()


def test_the_surface_is_a_mesh_along_the_walls(lidar_session):
    mesh = lidar_session.space.mesh()
    assert len(mesh.triangles) > 5000
    assert len(mesh.positions) == len(mesh.normals) == len(mesh.colours)
    assert mesh.triangles.max() < len(mesh.positions)
    p = mesh.positions - np.array([*world.to_map(0, 0), 0.0])
    off = np.min(np.abs(np.stack([p - bound for bound in world.ROOM])).reshape(-1, len(p), 3).min(axis=2), axis=0)
    for low, high in world.FURNITURE:
        gap = np.maximum(np.maximum(low - p, p - high), 0)
        outside = np.linalg.norm(gap, axis=1)
        inside = np.minimum(p - low, high - p).min(axis=1)
        off = np.minimum(off, np.where(outside > 0, outside, np.abs(inside)))
    assert np.median(off) < 0.01
    assert np.quantile(off, 0.95) < 0.05
    part = lidar_session.space.mesh(low=at(2.5, -1, 0.5), high=at(3.5, 1, 2.0))
    assert 100 < len(part.triangles) < len(mesh.triangles) / 2
    wall = part.normals[np.abs(part.positions[:, 0] - at(3, 0, 0)[0]) < 0.02]
    assert np.median(wall[:, 0]) < -0.95
    with pytest.raises(ResourceExhausted) as refused:
        lidar_session.space.mesh(max_triangles=10)
    assert refused.value.reason == "MESH_TOO_LARGE"


def test_what_cannot_be_answered_is_refused_with_field_and_remedy(lidar_session, laser_session):
    space = lidar_session.space

    def ray(way=(1, 0, 0), range_m=1.0):
        return space.rays([[0, 0, 1]], [way], max_range_m=range_m)

    for ask, error, reason, field in [
        (lambda: laser_session.space.voxels(), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: laser_session.space.boxes([box(0, 0, 1, 1)]), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: laser_session.space.heights(), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: laser_session.space.mesh(), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: laser_session.space.changes(layer="surface"), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: laser_session.map.export("voxels_bt"), FailedPrecondition, "LAYER_OFF", "layer"),
        (lambda: space.points([[0, 0, 0], [0, float("nan"), 0]]), InvalidArgument, "OUT_OF_RANGE", "points[1]"),
        (lambda: space.points([[1e300, 0, 0]]), InvalidArgument, "REGION_TOO_FAR", "points[0]"),
        (lambda: space.points([0, 1, 2]), InvalidArgument, "SIZE_MISMATCH", "points"),
        (lambda: space.points(np.zeros((100_001, 3))), ResourceExhausted, "TOO_MANY_QUERIES", "points"),
        (lambda: space.points([[0, 0, 0]], layer="cloud"), InvalidArgument, "ENUM_UNKNOWN", "layer"),
        (lambda: ray((0, 0, 0)), InvalidArgument, "OUT_OF_RANGE", "rays[0].direction"),
        (lambda: ray(range_m=1e9), InvalidArgument, "OUT_OF_RANGE", "rays[0].max_range_m"),
        (lambda: ray(range_m=float("nan")), InvalidArgument, "OUT_OF_RANGE", "rays[0].max_range_m"),
        (lambda: space.boxes([box(0, 0, 1, 1e6)]), ResourceExhausted, "GRID_TOO_LARGE", "boxes"),
        (lambda: space.boxes([box(0, 0, 1, -1)]), InvalidArgument, "OUT_OF_RANGE", "boxes[0]"),
        (lambda: space.voxels(low=[1, 1, 1], high=[0, 2, 2]), InvalidArgument, "REGION_EMPTY", "region"),
    ]:
        with pytest.raises(error) as refused:
            ask()
        assert (refused.value.reason, refused.value.field) == (reason, field)


def test_the_rest_door_answers_the_same(http, lidar_session):
    def asked(path, body=None):
        url = f"/v1/sessions/{lidar_session.session_id}/map/{path}"
        return (http.get(url) if body is None else http.post(url, json=body)).json()

    x, y, z = at(2.2, 0.4, 1.5)
    point = asked("points", {"points": [{"x": x, "y": y, "z": z}]})
    ours = lidar_session.space.points([[x, y, z]])
    assert point["points"][0]["state"] == "SPACE_STATE_FREE"
    assert point["points"][0]["distance_m"] == ours.distances_m[0]
    ray = asked("rays", {"rays": [{"origin": {"x": x, "y": y, "z": z}, "direction": {"x": 1}, "max_range_m": 5}]})
    assert abs(ray["rays"][0]["distance_m"] - 0.8) < 0.12
    assert len(asked("voxels")["blocks"]) == len(lidar_session.space.voxels().keys)
    assert asked("changes")["regions"]
    assert asked("boxes", {"boxes": []})["stamp"]["frame_id"] == "map"
    assert asked("rays", {"rays": [{"origin": {"x": x}}]})["field"] == "rays[0].direction"

"""Samples, crops, ground, regions, objects on a table, registration's methods, pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from percept import InvalidArgument, OrientedBox, PointCloud, Pose, ResourceExhausted, Step

from support import world


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def sphere(rng, centre, radius, n):
    """Points on the upper, visible side."""
    v = rng.normal(size=(n, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v[:, 2] = np.abs(v[:, 2])
    return (v * radius + centre).astype(np.float32)


def surface(rng, low, high, n, z=0.0, noise=0.0005):
    xy = rng.uniform(low, high, (n, 2))
    return np.column_stack([xy, z + rng.normal(0, noise, n)]).astype(np.float32)


def test_samples_are_as_many_as_asked_for_and_spread(client, rng):
    points = rng.uniform(0, 1, (2000, 3)).astype(np.float32)
    points[5] = np.nan
    every = client.toolbox.sample_points(points, every=10)
    finite = np.flatnonzero(np.isfinite(points).all(1))
    assert np.array_equal(every.indices, finite[::10])
    random = client.toolbox.sample_points(points, random=300, seed=2)
    assert len(random.cloud) == 300
    assert np.array_equal(random.cloud.points, points[random.indices])
    assert random == client.toolbox.sample_points(points, random=300, seed=2)
    far = client.toolbox.sample_points(points, farthest=50)
    gaps = np.linalg.norm(far.cloud.points[:, None] - far.cloud.points[None], axis=2) + 10 * np.eye(50)
    # The greedy choice: no point is farther from the chosen ones than they are from each other.
    away = np.linalg.norm(points[finite][:, None] - far.cloud.points[None], axis=2).min(1)
    assert away.max() <= gaps.min() + 1e-5
    with pytest.raises(InvalidArgument):
        client.toolbox.sample_points(points)
    with pytest.raises(ResourceExhausted) as error:
        client.toolbox.sample_points(np.zeros((500_000, 3), np.float32), farthest=400_000)
    assert error.value.reason == "SAMPLE_TOO_LARGE"


def test_crops_hold_what_numpy_says(client, rng):
    points = rng.uniform(-2, 2, (3000, 3)).astype(np.float32)
    turn = Pose.from_xyz(0.3, -0.2, 0.1, yaw_rad=0.7)
    box = OrientedBox(t_frame_box=turn, size_m=(2.0, 1.0, 1.5))
    inverse = np.linalg.inv(turn.matrix)
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    inside = (np.abs(local) <= box.size_m / 2).all(1)
    assert np.array_equal(client.toolbox.crop_cloud(points, box=box).indices, np.flatnonzero(inside))
    others = client.toolbox.crop_cloud(points, box=box, outside=True)
    assert np.array_equal(others.indices, np.flatnonzero(~inside))
    distance = np.linalg.norm(points - (0.5, 0, 0), axis=1)
    band = client.toolbox.crop_cloud(points, range_m=(0.5, 1.5), centre=(0.5, 0, 0))
    assert np.array_equal(band.indices, np.flatnonzero((distance >= 0.5) & (distance <= 1.5)))
    # A triangle by its three half-planes.
    x, y, z = points.T
    triangle = (y > -1) & (x > -1) & (x + y < 1) & (np.abs(z) <= 0.5)
    corners = np.array([[-1.0, -1], [2, -1], [-1, 2]])
    prism = client.toolbox.crop_cloud(points, polygon=corners, z_m=(-0.5, 0.5))
    assert np.array_equal(prism.indices, np.flatnonzero(triangle))
    with pytest.raises(InvalidArgument):
        client.toolbox.crop_cloud(points, range_m=(2.0, 1.0))
    with pytest.raises(InvalidArgument):
        client.toolbox.crop_cloud(points, polygon=corners[:2])


def test_the_ground_is_what_lies_low_and_flat(client, rng):
    angle, radius = rng.uniform(-np.pi, np.pi, 20000), rng.uniform(3, 30, 20000)
    ground = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(20000, -1.73)])
    ground[:, 2] += 0.02 * ground[:, 0] + rng.normal(0, 0.02, 20000)
    car = rng.uniform((8, 2, -1.2), (12, 4, 0), (2000, 3))
    scan = np.vstack([ground, car]).astype(np.float32)
    found = client.toolbox.segment_ground(scan)
    is_ground = np.zeros(len(scan), bool)
    is_ground[found.indices] = True
    assert is_ground[:20000].mean() > 0.97
    assert is_ground[20000:].mean() < 0.03
    assert all(p.plane.normal[2] > 0.9 for p in found.patches)
    rest = client.toolbox.run_pipeline(scan, [Step("segment_ground")], send_cloud=True)
    assert np.array_equal(rest.cloud.points, scan[~is_ground])
    assert rest.steps[0].answer == found


def test_regions_end_where_the_surface_bends(client, rng):
    floor = surface(rng, 0, 1, 4000)
    wall = surface(rng, 0, 1, 4000)[:, [2, 0, 1]] + np.array([0, 0, 0.08], np.float32)
    found = client.toolbox.grow_regions(np.vstack([floor, wall]), radius_m=0.06)
    assert found.num_clusters == 2
    for part, label in ((found.labels[:4000], 0), (found.labels[4000:], 1)):
        assert (part == label).mean() > 0.9


def test_two_things_that_touch_are_two(client, rng):
    table = surface(rng, -0.4, 0.4, 20000)
    # Two balls that touch at (0, 0).
    balls = [sphere(rng, (x, 0, 0.03), 0.06, 6000) for x in (-0.059, 0.059)]
    scene = np.vstack([table, *balls])
    found = client.toolbox.segment_objects(scene, viewpoint_m=(0, 0, 1))
    assert found.num_objects == 2
    assert abs(found.support.normal[2]) > 0.999
    _, first, second = np.split(found.labels, [20000, 26000])
    most = [np.bincount(part[part >= 0]).argmax() for part in (first, second)]
    assert most[0] != most[1]
    # Supervoxels are not cut where the balls touch.
    assert all((part[part >= 0] == label).mean() > 0.95 for part, label in zip((first, second), most))
    patches = client.toolbox.compute_supervoxels(scene, viewpoint_m=(0, 0, 1))
    assert len(patches.centres) == len(patches.normals) == patches.labels.max() + 1
    assert (patches.edges[:, 0] < patches.edges[:, 1]).all()
    assert patches.edges.max() < len(patches.centres)


def test_supervoxels_are_grouped_where_the_surface_is_convex(client, rng):
    # Of two balls in one another, what is outside of both.
    halves = [sphere(rng, (x, 0, 0.03), 0.08, 8000) for x in (-0.05, 0.05)]
    balls = np.vstack([half[half[:, 0] * x > 0] for half, x in zip(halves, (-1, 1))])
    parts = client.toolbox.compute_supervoxels(balls, viewpoint_m=(0, 0, 1))
    groups = client.toolbox.group_convex(parts)
    assert len(groups.labels) == len(parts.centres)
    assert groups.num_clusters == 2
    of_point = groups.labels[parts.labels[parts.labels >= 0]]
    side = balls[parts.labels >= 0, 0] > 0
    assert max((of_point == side).mean(), (of_point != side).mean()) > 0.95
    # What may bend inward by half a turn is all one.
    assert client.toolbox.group_convex(parts, concavity_tolerance_rad=3.2, max_step_m=1.0).num_clusters <= 2
    none = dataclasses.replace(parts, centres=parts.centres[:0], normals=parts.normals[:0], edges=parts.edges[:0])
    assert client.toolbox.group_convex(none).num_clusters == 0
    wrong = np.array([[0, len(parts.centres)]], np.uint32)
    for bad, field in (
        ({"edges": wrong}, "edges"),
        ({"normals": parts.normals[1:]}, "normals"),
        ({"centres": parts.centres * np.float32(np.nan)}, "centres"),
    ):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.group_convex(dataclasses.replace(parts, **bad))
        assert error.value.field == field
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.group_convex(parts, min_supervoxels=0)
    assert error.value.field == "min_supervoxels"


@pytest.mark.parametrize("method", ["point_to_point", "point_to_plane", "gicp", "vgicp", "coloured"])
def test_every_method_finds_how_the_cloud_was_moved(client, rng, method):
    points = world.cloud(world.drive(1)[0])
    # A colour that is a function of the place.
    shade = (127 + 100 * np.sin(3 * points.sum(1))).astype(np.uint8)
    target = PointCloud(points, colours=np.repeat(shade[:, None], 3, axis=1))
    moved = Pose.from_xyz(0.1, -0.05, 0.02, yaw_rad=0.03)
    back = np.linalg.inv(moved.matrix)
    source = PointCloud((points @ back[:3, :3].T + back[:3, 3]).astype(np.float32), colours=target.colours)
    found = client.toolbox.register_clouds(
        source, target=target, method=method, max_distance_m=0.5, kernel="huber", kernel_scale_m=0.2
    )
    assert found.outcome in ("converged", "max_iterations"), found
    assert np.allclose(found.t_target_source.matrix, moved.matrix, atol=0.03)


def test_registration_says_what_it_misses(client, rng):
    points = rng.uniform(size=(500, 3)).astype(np.float32)
    for bad in (
        {"method": "coloured"},
        {"kernel": "huber"},
        {"colour_share": 2.0, "method": "coloured"},
        {"num_neighbours": 2},
        {"voxel_sizes_m": [0.1] * 17},
        {"method": "magic"},
    ):
        with pytest.raises(InvalidArgument):
            client.toolbox.register_clouds(points, target=points, **bad)
    far = client.toolbox.register_clouds(points, target=points + np.float32(100), max_distance_m=0.1)
    assert not far.converged
    assert far.outcome == "too_few_pairs"


def test_pictures_have_the_size_and_colours_that_were_asked_for(client, rng):
    floor = surface(rng, -1, 1, 5000)
    labels = (floor[:, 0] > 0).astype(np.int32)
    png = client.toolbox.render_cloud(floor, view="top", colouring="label", labels=labels, width_px=320, height_px=240)
    picture = client.toolbox.decode_colour(png)
    assert picture.shape == (240, 320, 3)
    left, right = picture[120, 130].astype(int), picture[120, 190].astype(int)
    assert np.abs(left - right).max() > 40
    for view in ("front", "side", "perspective", "camera"):
        assert client.toolbox.render_cloud(floor, view=view).startswith(b"\x89PNG")
    depth = np.tile(np.linspace(1, 3, 64, dtype=np.float32), (48, 1))
    depth[:8] = 0
    drawn = client.toolbox.decode_colour(client.toolbox.render_depth(depth, near_m=1.0, far_m=3.0)).astype(int)
    assert drawn.shape == (48, 64, 3)
    assert not drawn[:8].any()
    assert drawn[20, 2, 2] > drawn[20, 2, 0]
    assert drawn[20, -2, 0] > drawn[20, -2, 2]
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.render_cloud(floor, labels=labels[:-1])
    assert error.value.field == "labels"
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.render_depth(depth, near_m=1.0)
    assert error.value.field == "far_m"
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.render_cloud(floor, width_px=8)
    assert error.value.field == "width_px"

import numpy as np
import pytest

from percept import (
    Clusters,
    FilteredCloud,
    Ground,
    InvalidArgument,
    OrientedBox,
    Plane,
    PlaneSegment,
    PointCloud,
    Pose,
    SupportedObjects,
)
from percept._convert.toolbox import regions

POINTS = np.arange(12, dtype=np.float32).reshape(4, 3)
FLAT = Plane(normal=np.array([0.0, 0, 1]), offset_m=0)
TURNED = Pose.from_xyz(1.5, 2.5, 3.5, yaw_rad=np.pi / 2)
CLOUD = PointCloud(POINTS, intensities=np.arange(4, dtype=np.float32))


def test_a_part_of_a_cloud_keeps_its_channels():
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    cloud = PointCloud(points, colours=colours)
    mask = points[:, 2] > 3
    for chosen in (mask, [1, 2, 3], slice(1, None), np.array([-3, -2, -1])):
        part = cloud[chosen]
        assert np.array_equal(part.points, points[1:])
        assert np.array_equal(part.colours, colours[1:])
        assert part.normals is None
    assert len(cloud[np.zeros(4, bool)]) == len(cloud[[]]) == 0
    for wrong in (np.ones(3, bool), np.array([4]), np.array([[0]]), np.array([0.5])):
        with pytest.raises(InvalidArgument):
            cloud[wrong]


@pytest.mark.parametrize(
    ("part", "label", "chosen"),
    [
        (
            PlaneSegment(plane=FLAT, kind="floor", indices=np.array([1, 3], np.uint32)),
            None,
            [1, 3],
        ),
        (Ground(indices=np.array([], np.uint32), patches=()), None, []),
        (FilteredCloud(cloud=CLOUD, indices=np.array([0], np.uint32)), None, [0]),
        (Clusters(labels=np.array([0, -1, 1, 0], np.int32), num_clusters=2), 0, [0, 3]),
        (Clusters(labels=np.array([0, -1, 1, 0], np.int32), num_clusters=2), -1, [1]),
        (Clusters(labels=np.array([0, -1, 1, 0], np.int32), num_clusters=2), 7, []),
        (SupportedObjects(labels=np.array([0, 0, 1, 1], np.int32), num_objects=2, support=None), 1, [2, 3]),
        # A box turned by a quarter: its long edge lies along y. A point on its face belongs to it.
        (
            OrientedBox(t_frame_box=TURNED, size_m=(8, 3.1, 3)),
            None,
            [0, 1],
        ),
    ],
)
def test_what_was_found_is_selected_with_its_channels(part, label, chosen):
    found = CLOUD.select(part, label=label)
    assert np.array_equal(found.points, POINTS[chosen])
    assert found.intensities.tolist() == chosen
    rest = CLOUD.select(part, label=label, rest=True)
    assert rest.intensities.tolist() == [i for i in range(4) if i not in chosen]


@pytest.mark.parametrize(
    ("part", "label", "field"),
    [
        (Clusters(labels=np.zeros(4, np.int32), num_clusters=1), None, "label"),
        (Clusters(labels=np.zeros(5, np.int32), num_clusters=1), 0, "labels"),
        (Ground(indices=np.array([4]), patches=()), None, "part"),
        (Ground(indices=np.array([3]), patches=()), 0, "label"),
        (np.ones(4, bool), None, "part"),
    ],
)
def test_parts_of_other_clouds_and_other_things_are_not_selected(part, label, field):
    with pytest.raises(InvalidArgument) as error:
        CLOUD.select(part, label=label)
    assert error.value.field == field


def test_clusters_are_labels():
    clusters = Clusters(labels=np.array([0, -1, 1, 0], np.int32), num_clusters=2)
    by_them = regions.render_cloud(CLOUD, clusters, None).request
    assert by_them == regions.render_cloud(CLOUD, clusters.labels, None).request
    assert by_them == regions.render_cloud(CLOUD, np.array([0, -1, 1, 0]), None).request
    assert np.frombuffer(by_them.labels, "<i4").tolist() == [0, -1, 1, 0]
    for wrong in (np.zeros(4), np.zeros((4, 1), np.int32), "0110"):
        with pytest.raises(InvalidArgument, match="labels"):
            regions.render_cloud(CLOUD, wrong, None)

"""Objects that stand on a table, touching and stacked: the labelled scenes, with the defaults."""

from __future__ import annotations

import numpy as np
import pytest

from support.server import recorded


@pytest.fixture(scope="module")
def scenes():
    folder = recorded("cloud-osd-labelled")
    if folder is None:
        pytest.skip("recorded data is not there")
    return sorted(folder.glob("*.pcd"))


def labels_of(pcd):
    """The label of each point of a compressed PCD, field after field: 0 where nothing was measured,
    below 20 for the table; ten numbers are parts of one object."""
    header, _, body = pcd.partition(b"DATA binary_compressed\n")
    entries = {line.split()[0]: line.split()[1:] for line in header.decode().splitlines() if line}
    count, number = int(entries["POINTS"][0]), entries["FIELDS"].index("label")
    assert set(entries["SIZE"]) == {"4"}
    packed = body[8 : 8 + int.from_bytes(body[:4], "little")]
    column = unpacked(packed, 4 * count * (number + 1))[4 * count * number :]
    return np.frombuffer(column, "<u4")


def unpacked(data, size):
    """The first `size` bytes of what LZF packed."""
    out, i = bytearray(), 0
    while len(out) < size:
        control = data[i]
        if control < 32:
            out += data[i + 1 : i + 2 + control]
            i += 2 + control
            continue
        length, i = control >> 5, i + 1
        if length == 7:
            length, i = 7 + data[i], i + 1
        back, i = ((control & 31) << 8) + data[i] + 1, i + 1
        for _ in range(length + 2):
            out.append(out[-back])
    return bytes(out[:size])


def overlaps(found, truth):
    """For each object, the best ratio of intersection to union with something that was found."""
    objects, clusters = np.unique(truth[truth >= 2]), np.unique(found[found >= 0])
    masks = [found == c for c in clusters]
    best = [max(((m & (truth == t)).sum() / (m | (truth == t)).sum() for m in masks), default=0) for t in objects]
    return np.array(best)


def test_every_object_of_the_labelled_scenes_is_found(client, scenes):
    ratios, too_many = [], 0
    for path in scenes:
        pcd = path.read_bytes()
        labels, points = labels_of(pcd), client.toolbox.decode_cloud(pcd).cloud.points
        assert len(points) == len(labels)
        seen = np.isfinite(points).all(1) & (labels > 0)
        found = client.toolbox.segment_objects(points[seen])
        ratios.append(overlaps(found.labels, labels[seen] // 10))
        too_many += found.num_objects - len(ratios[-1])
    ratios = np.concatenate(ratios)
    assert len(ratios) == 13
    # Above a half nothing can be two objects' best.
    assert (ratios > 0.5).all(), ratios
    assert ratios.mean() >= 0.94, ratios
    # A piece of something in the last scene is one more.
    assert too_many <= 1

"""Where a toolbox call's cloud comes from: sent, kept, a file, or a session's map."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from percept import (
    AsyncClient,
    CloudFile,
    InvalidArgument,
    NotFound,
    PerceptError,
    PointCloud,
    SessionCloud,
    Step,
)

from support import world


@pytest.fixture(scope="module")
def session(client):
    session = client.sessions.create(sensors=[world.CAMERA])
    for i, pose in enumerate(world.drive(6)):
        depth = world.depth_image(pose)
        session.send_depth("camera", stamp_ns=world.stamp(i), depth=depth, metres_per_unit=0.001)
    yield session
    session.delete()


@pytest.fixture(scope="module")
def cloud(session):
    return session.map.cloud().cloud


def test_a_cloud_is_the_same_wherever_it_comes_from(client, session, cloud):
    toolbox = client.toolbox
    assert cloud.num_points > 1000
    kept = toolbox.upload_cloud(cloud)
    data = toolbox.encode_cloud(cloud, "pcd")
    sources = [
        cloud.points,
        kept,
        data,
        CloudFile(data, "pcd"),
        SessionCloud(session.session_id),
    ]
    wanted = toolbox.downsample_voxels(cloud, voxel_size_m=0.2)
    for source in sources:
        assert np.array_equal(toolbox.downsample_voxels(source, voxel_size_m=0.2).points, wanted.points)
        found = toolbox.run_pipeline(source, [Step("segment_planes", seed=4)]).steps[0]
        assert found.answer == toolbox.segment_planes(cloud, seed=4)
        laid = toolbox.register_clouds(source, target=SessionCloud(session.session_id), max_distance_m=0.1)
        assert np.allclose(laid.t_target_source.matrix, np.eye(4), atol=1e-6)
    again = toolbox.upload_cloud(SessionCloud(session.session_id))
    assert toolbox.download_cloud(again) == cloud
    twice = toolbox.upload_cloud(again)
    toolbox.drop_cloud(again)
    assert toolbox.download_cloud(twice) == cloud
    for handle in (kept, twice):
        toolbox.drop_cloud(handle)


def test_a_part_of_a_sessions_cloud_is_what_the_map_says_is_there(client, session, cloud):
    centre = cloud.points[0]
    there = session.map.cloud(centre=centre, radius_m=0.7).cloud
    assert 0 < there.num_points < cloud.num_points
    part = client.toolbox.remove_non_finite(SessionCloud(session.session_id, centre=centre, radius_m=0.7))
    assert part == there


def test_a_session_without_a_map_has_an_empty_cloud(client):
    empty = client.sessions.create(sensors=[world.LASER])
    assert client.toolbox.remove_non_finite(SessionCloud(empty.session_id)).num_points == 0
    empty.delete()


def refusal(call) -> tuple[str, str]:
    with pytest.raises(PerceptError) as error:
        call()
    return error.value.reason, error.value.field


def test_a_source_that_gives_nothing_is_refused_by_its_field(client, session):
    def ask(source, t=client.toolbox):
        return refusal(lambda: t.compute_shape_features(source))

    assert ask(SessionCloud("no-such-session")) == ("SESSION_NOT_FOUND", "cloud.session.session_id")
    assert ask(SessionCloud("../etc"))[1] == "cloud.session.session_id"
    assert ask(SessionCloud(session.session_id, centre=(0, 0, 0))) == (
        "FIELD_MISSING",
        "cloud.session.radius_m",
    )
    assert ask(SessionCloud(session.session_id, centre=(0, 0, 0), radius_m=-1.0))[0] == "OUT_OF_RANGE"
    assert ask(b"\x00\x01\x02\x03") == ("FORMAT_UNKNOWN", "cloud.file.format")
    assert ask(CloudFile(b"ply\n", "pcd"))[1].startswith("cloud.file")
    both = refusal(
        lambda: client.toolbox.register_clouds(np.zeros((9, 3), np.float32), target=SessionCloud("none-here"))
    )
    assert both == ("SESSION_NOT_FOUND", "target.session.session_id")
    with pytest.raises(NotFound):
        client.toolbox.upload_cloud(SessionCloud("no-such-session"))
    with pytest.raises(InvalidArgument):
        client.toolbox.upload_cloud(b"")


def test_asyncio_reads_the_same(server, session, cloud):
    async def scenario():
        async with AsyncClient(server.grpc) as other:
            return await other.toolbox.remove_non_finite(SessionCloud(session.session_id))

    assert asyncio.run(scenario()) == cloud


def test_a_large_answer_comes_whole(client):
    rng = np.random.default_rng(8)
    cloud = PointCloud(
        rng.uniform(-9, 9, (400_000, 3)).astype(np.float32),
        colours=rng.integers(0, 256, (400_000, 3), dtype=np.uint8),
        intensities=rng.uniform(0, 1, 400_000).astype(np.float32),
    )
    steps = [
        Step("remove_radius_outliers", radius_m=0.5, min_neighbours=1),
        Step("cluster_points", eps_m=0.05),
    ]
    whole = client.toolbox.run_pipeline(cloud, steps, send_cloud=True)
    assert whole.cloud == cloud
    assert np.array_equal(whole.steps[0].answer, np.arange(400_000))
    assert whole.steps[1].answer == client.toolbox.cluster_points(cloud, eps_m=0.05)


@pytest.mark.parametrize("count", [101_376, 101_377, 205_000, 307_200])
def test_no_point_is_lost_between_parts(client, count):
    points = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
    cloud = PointCloud(points, colours=np.full((count, 3), 7, np.uint8))
    assert client.toolbox.remove_non_finite(cloud) == cloud
    assert client.toolbox.decode_cloud(client.toolbox.encode_cloud(cloud, "pcd")).cloud == cloud


def test_a_cloud_is_read_from_a_file_and_written_to_one(client, cloud, tmp_path):
    toolbox = client.toolbox
    for ending in ("ply", "pcd", "laz", "xyz", "bin"):
        path = tmp_path / f"cloud.{ending}"
        toolbox.write_cloud(cloud, path)
        read = toolbox.read_cloud(path)
        assert np.abs(read.points - cloud.points).max() < 1e-3, ending
        near = read[read.points[:, 2] < 0.5]
        assert 0 < near.num_points < read.num_points
    far = tmp_path / "far.txt"
    far.write_text("500123.456 5400000.001 12.5\n500124.457 5400001.002 13.5\n")
    with pytest.warns(UserWarning, match="relative to"):
        assert toolbox.read_cloud(far).num_points == 2
    with pytest.raises(InvalidArgument, match="end it in one of"):
        toolbox.write_cloud(cloud, tmp_path / "cloud.stl")
    with pytest.raises(InvalidArgument, match="hello world"):
        toolbox.decode_cloud(b"hello world")

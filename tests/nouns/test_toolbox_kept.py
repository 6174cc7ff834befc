"""Clouds kept on the server, files of clouds, pipelines, images in other encodings."""

from __future__ import annotations

import asyncio
import base64

import httpx
import numpy as np
import pytest
from percept import (
    AsyncClient,
    Client,
    DeadlineExceeded,
    InvalidArgument,
    NotFound,
    PointCloud,
    Pose,
    ResourceExhausted,
    Step,
)

from support.server import Server


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def coloured(rng, n):
    normals = rng.normal(size=(n, 3)).astype(np.float32)
    return PointCloud(
        rng.uniform(-1, 1, (n, 3)).astype(np.float32),
        colours=rng.integers(0, 256, (n, 3), dtype=np.uint8),
        intensities=rng.uniform(0, 1, n).astype(np.float32),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
    )


def table_scene(rng):
    """A floor of 4 x 4 m with two boxes of points on it."""
    floor = np.column_stack([rng.uniform(-2, 2, (6000, 2)), rng.normal(0, 0.002, 6000)])
    boxes = [rng.uniform(-0.5, 0.5, (1500, 3)) * (0.4, 0.3, 0.2) + c for c in ((1, 1, 0.3), (-1, 0, 0.4))]
    return np.vstack([floor, *boxes]).astype(np.float32)


def test_a_kept_cloud_is_as_good_as_a_sent_one(client, rng):
    cloud = coloured(rng, 3000)
    kept = client.toolbox.upload_cloud(cloud)
    assert kept.num_points == 3000
    assert kept.handle in [c.handle for c in client.toolbox.list_clouds().clouds]
    # 12 positions, 3 colours, 4 intensities, 12 normals.
    assert kept.size_bytes == 3000 * 31
    for call in (
        lambda c: client.toolbox.downsample_voxels(c, voxel_size_m=0.2),
        lambda c: client.toolbox.remove_radius_outliers(c, radius_m=0.2, min_neighbours=3),
        lambda c: client.toolbox.cluster_points(c, eps_m=0.1),
        lambda c: client.toolbox.compute_shape_features(c),
    ):
        assert call(kept) == call(cloud)
    assert client.toolbox.download_cloud(kept) == cloud
    client.toolbox.drop_cloud(kept)
    with pytest.raises(NotFound) as error:
        client.toolbox.downsample_voxels(kept)
    assert (error.value.reason, error.value.field) == ("CLOUD_NOT_FOUND", "cloud.handle")
    with pytest.raises(NotFound):
        client.toolbox.drop_cloud(kept)


def test_a_large_cloud_goes_up_and_comes_down_in_parts(client, rng):
    cloud = coloured(rng, 600_000)
    kept = client.toolbox.upload_cloud(cloud)
    assert client.toolbox.download_cloud(kept) == cloud
    data = client.toolbox.download_file(kept, "pcd")
    assert len(data) > 16 << 20
    again = client.toolbox.upload_cloud(data)
    assert np.array_equal(client.toolbox.download_cloud(again).points, cloud.points)
    for handle in (kept, again):
        client.toolbox.drop_cloud(handle)


@pytest.mark.parametrize(
    "file_format",
    [
        *("ply", "ply_ascii", "ply_big_endian", "pcd", "pcd_ascii", "pcd_compressed"),
        *("xyz", "kitti_bin", "las", "laz"),
    ],
)
def test_files_hold_what_went_in(client, rng, file_format):
    cloud = coloured(rng, 500)
    data = client.toolbox.encode_cloud(cloud, file_format)
    # A raw array of floats says nothing of what it is.
    told = {"file_format": file_format} if file_format == "kitti_bin" else {}
    decoded = client.toolbox.decode_cloud(data, **told)
    back = decoded.cloud
    # LAS counts millimetres, and intensities in 16 bits; XYZ has colours and normals, or intensities.
    las = file_format in ("las", "laz")
    assert np.allclose(back.points + decoded.origin_m, cloud.points, atol=6e-4 if las else 1e-6)
    if not las and file_format != "xyz":
        assert np.allclose(back.intensities, cloud.intensities, atol=1e-6)
    if file_format != "kitti_bin":
        assert np.array_equal(back.colours, cloud.colours)
    # Cut short, it is refused.
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.decode_cloud(data[: len(data) // 2 + 3], **told)
    assert (error.value.reason, error.value.field) == ("FILE_INVALID", "file.data")


def test_a_file_of_unknown_kind_is_refused(client):
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.decode_cloud(b"\x00\x01\x02\x03")
    assert (error.value.reason, error.value.field) == ("FORMAT_UNKNOWN", "file.format")
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.decode_cloud(client.toolbox.encode_cloud(np.zeros((3, 3), np.float32)), file_format="pcd")
    assert (error.value.reason, error.value.field) == ("FORMAT_MISMATCH", "file.format")


def test_coordinates_of_a_survey_keep_their_millimetres(client, rng):
    cloud = rng.uniform(-50, 50, (200, 3)).astype(np.float32)
    origin = np.array([4_512_345.0, 5_400_321.0, 312.0])
    data = client.toolbox.encode_cloud(cloud, "laz", origin_m=origin)
    decoded = client.toolbox.decode_cloud(data)
    assert np.allclose(decoded.cloud.points.astype(float) + decoded.origin_m, cloud + origin, atol=1e-3)
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.encode_cloud(cloud, "ply", origin_m=origin)
    assert (error.value.reason, error.value.field) == ("ORIGIN_UNSUPPORTED", "origin_m")


def test_the_budget_of_kept_clouds_is_held_and_nothing_is_forgotten_for_it(tmp_path):
    config = tmp_path / "percept.toml"
    config.write_text("[limits]\nmax_kept_clouds = 3\nmax_kept_bytes = 1200\nmax_kept_s = 60\n")
    server = Server(tmp_path / "data", "--config", str(config))
    try:
        with Client(server.grpc) as client:
            points = np.zeros((40, 3), np.float32)
            first = client.toolbox.upload_cloud(points)
            second = client.toolbox.upload_cloud(points)
            with pytest.raises(ResourceExhausted) as error:
                client.toolbox.upload_cloud(points)
            assert error.value.reason == "KEPT_CLOUDS_FULL"
            listed = client.toolbox.list_clouds()
            assert [c.handle for c in listed.clouds] == [first.handle, second.handle]
            assert (listed.used_bytes, listed.max_bytes) == (960, 1200)
            client.toolbox.drop_cloud(first)
            assert client.toolbox.upload_cloud(points).handle not in (first.handle, second.handle)
            for keep_s in (0.0, -1.0, 61.0, float("nan")):
                with pytest.raises(InvalidArgument) as error:
                    client.toolbox.upload_cloud(points, keep_s=keep_s)
                assert error.value.field == "keep_s"
    finally:
        server.stop()


def test_computing_has_an_end(tmp_path, rng):
    config = tmp_path / "percept.toml"
    config.write_text("[limits]\nmax_computation_ms = 1\n")
    server = Server(tmp_path / "data", "--config", str(config))
    try:
        with Client(server.grpc) as client, pytest.raises(DeadlineExceeded) as error:
            client.toolbox.remove_statistical_outliers(rng.uniform(size=(200_000, 3)).astype(np.float32))
        assert error.value.reason == "COMPUTATION_TOO_LONG"
    finally:
        server.stop()


def test_a_pipeline_finds_what_its_steps_find_one_by_one(client, rng):
    cloud = table_scene(rng)
    steps = [
        Step("remove_statistical_outliers"),
        Step("downsample_voxels", voxel_size_m=0.02, quiet=True),
        Step("segment_planes", max_planes=1, seed=5, remainder="rest"),
        Step("cluster_points", eps_m=0.1, min_points=50),
        Step("compute_shape_features"),
    ]
    whole = client.toolbox.run_pipeline(cloud, steps, send_cloud=True, keep_result=True)
    kept = client.toolbox.remove_statistical_outliers(cloud)
    small = client.toolbox.downsample_voxels(kept.cloud, voxel_size_m=0.02)
    planes = client.toolbox.segment_planes(small, max_planes=1, seed=5)
    rest = np.delete(small.points, planes[0].indices, axis=0)
    clusters = client.toolbox.cluster_points(rest, eps_m=0.1, min_points=50)
    answers = [s.answer for s in whole.steps]
    assert np.array_equal(answers[0], kept.indices)
    assert answers[1:4] == [None, planes, clusters]
    assert [s.num_points_out for s in whole.steps] == [len(kept.cloud), len(small), *[len(rest)] * 3]
    assert np.array_equal(whole.cloud.points, rest)
    assert client.toolbox.download_cloud(whole.kept) == whole.cloud
    assert clusters.num_clusters == 2
    for i, found in enumerate(answers[4]):
        alone = client.toolbox.compute_shape_features(rest[clusters.labels == i])
        assert (found.label, found.features, found.upright_box) == (i, alone.features, alone.upright_box)
    # Truth: where the boxes were put.
    centres = np.array([found.features.centroid for found in answers[4]])
    assert np.allclose(sorted(centres[:, 0]), [-1, 1], atol=0.02)
    client.toolbox.drop_cloud(whole.kept)


def test_what_goes_on_after_planes_is_said(client, rng):
    cloud = table_scene(rng)
    left = {
        remainder: client.toolbox.run_pipeline(cloud, [Step("segment_planes", seed=1, remainder=remainder)]).steps[0]
        for remainder in ("rest", "planes", "all")
    }
    on_plane = len(left["all"].answer[0].indices)
    counts = [left[k].num_points_out for k in ("rest", "planes", "all")]
    assert counts == [len(cloud) - on_plane, on_plane, len(cloud)]


@pytest.mark.parametrize(
    ("steps", "reason", "field"),
    [
        ([], "STEPS_INVALID", "steps"),
        ([Step("remove_non_finite")] * 65, "STEPS_INVALID", "steps"),
        (
            [Step("remove_non_finite"), Step("downsample_voxels", voxel_size_m=-1.0)],
            "OUT_OF_RANGE",
            "steps[1].downsample_voxels.voxel_size_m",
        ),
        ([Step("downsample_voxels", keep_result=True)], "STEP_HAS_CLOUD", "steps[0].cloud"),
        ([Step("fly")], "STEP_UNKNOWN", "operation"),
        ([Step("downsample_voxels", voxel=1.0)], "PARAMS_INVALID", "voxel"),
    ],
)
def test_a_step_that_cannot_be_is_named(client, rng, steps, reason, field):
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.run_pipeline(rng.uniform(size=(10, 3)).astype(np.float32), steps)
    assert (error.value.reason, error.value.field) == (reason, field)


def test_filters_do_as_numpy_does(client, rng):
    cloud = coloured(rng, 1500)
    holes = cloud.points.copy()
    holes[::7, 1] = np.nan
    finite = client.toolbox.remove_non_finite(PointCloud(holes, intensities=cloud.intensities))
    there = np.isfinite(holes).all(1)
    assert np.array_equal(finite.points, holes[there])
    assert np.array_equal(finite.intensities, cloud.intensities[there])

    turn = Pose.from_xyz(0.4, -0.3, 2.0, yaw_rad=1.1)
    moved = client.toolbox.transform_cloud(cloud, t_a_b=turn)
    rotation = turn.matrix[:3, :3]
    assert np.allclose(moved.points, cloud.points @ rotation.T + turn.translation, atol=1e-5)
    assert np.allclose(moved.normals, cloud.normals @ rotation.T, atol=1e-5)

    kept = client.toolbox.remove_radius_outliers(cloud, radius_m=0.15, min_neighbours=4)
    distances = np.linalg.norm(cloud.points[:, None] - cloud.points[None], axis=2)
    enough = (distances < 0.15).sum(1) - 1 >= 4
    assert np.array_equal(kept.indices, np.flatnonzero(enough))


def test_depth_and_colour_change_their_encoding_and_nothing_else(client, rng):
    units = rng.integers(300, 5000, (48, 64), dtype=np.uint16)
    units[3, 4] = 0
    metres = client.toolbox.convert_depth(units, metres_per_unit=0.001)
    assert metres.dtype == np.float32
    assert np.allclose(metres, units / 1000)
    assert np.array_equal(client.toolbox.convert_depth(metres, metres_per_unit=0.001), units)
    png = client.toolbox.encode_depth(metres)
    assert png.startswith(b"\x89PNG")
    assert np.allclose(client.toolbox.decode_depth(png, metres_per_unit=0.001), metres)
    image = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    assert np.array_equal(client.toolbox.decode_colour(client.toolbox.encode_colour(image)), image)
    smooth = np.full((32, 32, 3), (200, 100, 50), np.uint8)
    jpeg = client.toolbox.encode_colour(smooth, encoding="jpeg", quality=95)
    assert np.abs(client.toolbox.decode_colour(jpeg).astype(int) - smooth).max() <= 4
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.decode_depth(png[:-20], metres_per_unit=0.001)
    assert error.value.reason == "FILE_INVALID"
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.encode_colour(image, encoding="jpeg", quality=101)
    assert error.value.field == "quality"


def b64(array):
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def test_rest_keeps_lists_serves_and_drops_clouds(server, rng):
    points = rng.uniform(-1, 1, (400, 3)).astype(np.float32)
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        cloud = {"num_points": 400, "positions": b64(points)}
        sent = {"cloud": cloud}
        kept = http.post("/v1/toolbox/clouds", json={"cloud": sent}).json()["kept"]
        listed = http.get("/v1/toolbox/clouds").json()
        assert kept["handle"] in [c["handle"] for c in listed["clouds"]]
        by_handle = {"handle": kept["handle"]}
        small = http.post(
            "/v1/toolbox/downsample-voxels", json={"cloud": by_handle, "voxel_size_m": 0.5, "keep_result": True}
        ).json()
        assert "cloud" not in small
        answer = http.get(f"/v1/toolbox/clouds/{small['kept']['handle']}").json()["points"]
        other = http.post("/v1/toolbox/downsample-voxels", json={"cloud": sent, "voxel_size_m": 0.5}).json()
        assert answer["cloud"]["positions"] == other["cloud"]["positions"]
        file = http.get(f"/v1/toolbox/clouds/{kept['handle']}?format=ply").json()["chunk"]
        assert base64.b64decode(file["data"]).startswith(b"ply\nformat binary_little_endian")
        assert http.delete(f"/v1/toolbox/clouds/{kept['handle']}").status_code == 200
        gone = http.post("/v1/toolbox/downsample-voxels", json={"cloud": by_handle})
        assert (gone.status_code, gone.json()["reason"]) == (404, "CLOUD_NOT_FOUND")
        both = http.post("/v1/toolbox/downsample-voxels", json={"cloud": {"cloud": cloud, "handle": "c-1"}})
        assert (both.status_code, both.json()["reason"]) == (400, "JSON_INVALID")
        for nothing in ({}, {"cloud": {}}):
            none = http.post("/v1/toolbox/downsample-voxels", json=nothing)
            assert (none.status_code, none.json()["field"]) == (400, "cloud")


def test_asyncio_does_the_same(server, client, rng):
    cloud = coloured(rng, 700_000)

    async def scenario():
        async with AsyncClient(server.grpc) as other:
            kept = await other.toolbox.upload_cloud(cloud)
            result = await other.toolbox.run_pipeline(kept, [Step("downsample_voxels", voxel_size_m=0.1)])
            back = await other.toolbox.download_cloud(kept)
            await other.toolbox.drop_cloud(kept)
            return result.steps[0].num_points_out, back

    count, back = asyncio.run(scenario())
    assert back == cloud
    assert count == client.toolbox.downsample_voxels(cloud.points, voxel_size_m=0.1).num_points

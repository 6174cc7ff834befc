from __future__ import annotations

import hashlib

import DracoPy
import numpy as np
import pytest
from percept import FailedPrecondition, InvalidArgument, MapFormat, NotFound, Region, ResourceExhausted

from support import world


def test_a_map_of_nothing_is_empty_and_has_no_files(client):
    session = client.sessions.create(sensors=[world.LASER])
    summary = session.map.summary()
    assert (summary.occupancy, summary.num_points, summary.num_keyframes) == (None, 0, 0)
    assert session.map.occupancy().cells.size == 0
    assert session.map.cloud().cloud.num_points == 0
    with pytest.raises(FailedPrecondition) as error:
        session.map.export("occupancy_png")
    assert error.value.reason == "MAP_EMPTY"


def test_the_summary_is_that_of_the_content(lidar_session):
    summary = lidar_session.map.summary()
    grid, cloud = lidar_session.map.occupancy(), lidar_session.map.cloud()
    assert (summary.occupancy.height, summary.occupancy.width) == grid.cells.shape
    assert summary.occupancy.resolution_m == grid.resolution_m
    assert np.array_equal(summary.occupancy.origin, grid.origin)
    assert summary.num_points == cloud.cloud.num_points > 1000
    assert summary.stamp == grid.stamp == cloud.stamp
    assert summary.stamp.stamp_ns == world.stamp(world.LIDAR_LAST)
    assert summary.stamp.frame_id == "map"


def test_the_grid_has_the_room_in_it(laser_session):
    grid = laser_session.map.occupancy()
    assert grid.cells.dtype == np.int8
    assert set(np.unique(grid.cells)) <= set(range(-1, 101))

    def occupied_near(x, y):
        around = [(x + dx, y + dy) for dx in (-0.1, 0, 0.1) for dy in (-0.1, 0, 0.1)]
        values = [grid.cell_at(*world.to_map(*p)) for p in around]
        return max(-1 if v is None else v for v in values)

    for x, y in [(3.0, 0.0), (-3.0, 0.0), (0.0, 2.0), (-1.0, -2.0), (1.2, 1.0), (2.0, -1.0), (0.6, -1.4)]:
        assert occupied_near(x, y) > 50, (x, y)
    for x, y in [(0.0, 0.0), (-1.5, 0.5), (1.0, 0.0), (-2.0, 1.0), (2.2, 0.0)]:
        assert 0 <= grid.cell_at(*world.to_map(x, y)) < 50, (x, y)
    # Inside of furniture, and outside of the room, nothing is known.
    assert grid.cell_at(*world.to_map(1.6, 1.0)) in (-1, None)
    assert grid.cell_at(*world.to_map(3.5, 0.0)) in (-1, None)


def test_a_region_is_cut_out_of_the_whole(laser_session):
    whole = laser_session.map.occupancy()
    part = laser_session.map.occupancy(region=Region(-1.0, -1.0, 1.0, 1.0))
    offset = np.round((part.origin - whole.origin) / whole.resolution_m).astype(int)
    height, width = part.cells.shape
    assert 2.0 / part.resolution_m <= width <= 2.0 / part.resolution_m + 1.5
    rows, columns = np.arange(height) + offset[1], np.arange(width) + offset[0]
    assert np.array_equal(part.cells, whole.cells[np.ix_(rows, columns)])


def test_a_coarser_cell_is_as_occupied_as_the_most_occupied_in_it(laser_session):
    fine = laser_session.map.occupancy()
    coarse = laser_session.map.occupancy(resolution_m=4 * fine.resolution_m)
    assert coarse.resolution_m == pytest.approx(4 * fine.resolution_m)
    rows, columns = np.nonzero(fine.cells >= 0)
    x = fine.origin[0] + (columns + 0.5) * fine.resolution_m
    y = fine.origin[1] + (rows + 0.5) * fine.resolution_m
    expected = np.full(coarse.cells.shape, -1, np.int8)
    where = (
        np.floor((y - coarse.origin[1]) / coarse.resolution_m).astype(int),
        np.floor((x - coarse.origin[0]) / coarse.resolution_m).astype(int),
    )
    np.maximum.at(expected, where, fine.cells[rows, columns])
    assert np.array_equal(coarse.cells, expected)


@pytest.mark.parametrize(
    ("arguments", "kind", "reason", "field"),
    [
        (
            {"region": Region(-5, -5, 5, 5), "resolution_m": 1e-6},
            ResourceExhausted,
            "GRID_TOO_LARGE",
            "region",
        ),
        ({"resolution_m": 1e-6}, InvalidArgument, "RESOLUTION_NOT_A_MULTIPLE", "resolution_m"),
        ({"resolution_m": 0.0}, InvalidArgument, "OUT_OF_RANGE", "resolution_m"),
        ({"resolution_m": float("nan")}, InvalidArgument, "OUT_OF_RANGE", "resolution_m"),
        ({"region": Region(1, 0, 0, 1)}, InvalidArgument, "REGION_EMPTY", "region"),
        ({"region": Region(0, 0, 1e12, 1)}, InvalidArgument, "REGION_TOO_FAR", "region"),
    ],
)
def test_grids_that_cannot_be_are_refused(laser_session, arguments, kind, reason, field):
    with pytest.raises(kind) as error:
        laser_session.map.occupancy(**arguments)
    assert (error.value.reason, error.value.field) == (reason, field)


def test_the_cloud_lies_on_the_surfaces_of_the_room(lidar_session):
    points = lidar_session.map.cloud().cloud.points.astype(float)
    points[:, :2] += world.drive(1)[0].translation[:2]
    to_room = np.abs(np.stack([points - world.ROOM[0], points - world.ROOM[1]])).min((0, 2))

    def to_box(low, high):
        outside = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
        inside = np.minimum(points - low, high - points).min(1)
        return np.where(outside > 0, outside, inside)

    distance = np.min([to_room, *(to_box(*box) for box in world.FURNITURE)], axis=0)
    # Voxel centroids across edges lie inside; nearly all lie on a surface.
    assert np.quantile(distance, 0.95) < 0.05


def test_a_part_of_the_cloud_is_around_its_centre(lidar_session):
    centre = (1.0, 0.5, 0.5)
    part = lidar_session.map.cloud(centre=centre, radius_m=1.0).cloud.points
    whole = lidar_session.map.cloud().cloud.points
    near = np.linalg.norm(whole - np.array(centre, np.float32), axis=1) < 1.0
    assert abs(len(part) - near.sum()) <= 2
    assert len(part) > 0
    assert np.linalg.norm(part - np.array(centre), axis=1).max() <= 1.0 + 1e-5
    with pytest.raises(InvalidArgument):
        lidar_session.map.cloud(centre=centre)


STARTS = {
    "occupancy_png": b"\x89PNG",
    "nav2_pgm": b"P5",
    "nav2_yaml": b"image:",
    "cloud_ply": b"ply\nformat binary_little_endian",
    "cloud_pcd": b"# .PCD",
    "cloud_las": b"LASF",
    "cloud_laz": b"LASF",
    "cloud_glb": b"glTF",
    "voxels_bt": b"# Octomap OcTree binary file",
    "voxels_ot": b"# Octomap OcTree file",
    "occupancy_tiff": b"II*\0",
    "occupancy_pgw": b"0.1\n",
    "mesh_ply": b"ply\nformat binary_little_endian",
    "mesh_glb": b"glTF",
    "cloud_draco": b"DRACO",
    "mesh_draco": b"DRACO",
    "trajectory_tum": b"",
    "overview_png": b"\x89PNG",
    "cloud_top_png": b"\x89PNG",
    "cloud_view_png": b"\x89PNG",
    "mesh_view_png": b"\x89PNG",
    "voxels_view_png": b"\x89PNG",
    "heights_png": b"\x89PNG",
    "traversability_png": b"\x89PNG",
    "layers_png": b"\x89PNG",
}


@pytest.mark.parametrize("file_format", list(MapFormat))
def test_maps_are_exported_as_files_with_a_checksum(lidar_session, tmp_path, file_format):
    file = lidar_session.map.export(file_format, path=tmp_path)
    assert file.data.startswith(STARTS[file_format])
    assert file.path == tmp_path / file.file_name
    assert file.path.read_bytes() == file.data
    assert hashlib.sha256(file.data).hexdigest() == file.sha256
    assert file.stamp.stamp_ns == world.stamp(world.LIDAR_LAST)
    assert [p.name for p in tmp_path.iterdir()] == [file.file_name], "no part is left behind"


def test_a_cloud_is_as_fine_as_its_reader_can_take(lidar_session):
    whole = lidar_session.map.cloud()
    kept_m = whole.voxel_size_m
    assert kept_m == lidar_session.map.summary().voxel_size_m
    few = lidar_session.map.cloud(max_points=300)
    assert 100 < few.cloud.num_points <= 300 and few.voxel_size_m > kept_m
    # What it says of its voxels is so: two points share none, and each is near what it stands for.
    cells = np.floor(few.cloud.points.astype(float) / few.voxel_size_m)
    assert len(np.unique(cells, axis=0)) > 0.97 * len(cells)
    off = np.linalg.norm(few.cloud.points[:, None] - whole.cloud.points[None], axis=2).min(axis=1)
    assert off.max() < few.voxel_size_m
    again = lidar_session.map.cloud(max_points=300)
    assert np.array_equal(again.cloud.points, few.cloud.points)
    by_size = lidar_session.map.cloud(voxel_size_m=few.voxel_size_m)
    assert np.array_equal(by_size.cloud.points, few.cloud.points)
    assert lidar_session.map.cloud(max_points=10**9).cloud.num_points == whole.cloud.num_points
    assert lidar_session.map.cloud(voxel_size_m=0.001).cloud.num_points == whole.cloud.num_points
    for wrong, field in [({"max_points": 0}, "max_points"), ({"voxel_size_m": float("nan")}, "voxel_size_m")]:
        with pytest.raises(InvalidArgument) as error:
            lidar_session.map.cloud(**wrong)
        assert (error.value.reason, error.value.field) == ("OUT_OF_RANGE", field)


def test_what_is_packed_is_off_by_no_more_than_was_asked_for(lidar_session):
    plain = lidar_session.map.cloud()
    sizes = []
    for bound in (0.0005, 0.01):
        packed = lidar_session.map.cloud(max_error_m=bound)
        assert (packed.stamp.map_version, packed.voxel_size_m) == (plain.stamp.map_version, plain.voxel_size_m)
        _within(packed.cloud.points, plain.cloud.points, bound)
        file = lidar_session.map.export("cloud_draco", max_error_m=bound)
        _within(DracoPy.decode(file.data).points, plain.cloud.points, bound)
        sizes.append(len(file.data))
    assert sizes[1] < sizes[0] < 0.6 * len(lidar_session.map.export("cloud_ply").data)
    mesh = lidar_session.space.mesh()
    packed = lidar_session.space.mesh(max_error_m=0.001)
    assert packed.triangles.shape == mesh.triangles.shape
    _within(packed.positions, mesh.positions, 0.001)
    area = [_areas(m.positions.astype(float), m.triangles).sum() for m in (mesh, packed)]
    assert area[1] == pytest.approx(area[0], rel=0.02)
    part = lidar_session.space.mesh(low=(0, -1, 0), high=(1, 1, 1), max_error_m=0.001)
    assert 0 < len(part.triangles) < len(mesh.triangles)
    nothing = lidar_session.space.mesh(low=(900, 900, 0), high=(901, 901, 1), max_error_m=0.001)
    assert nothing.triangles.shape == (0, 3)
    assert lidar_session.map.cloud(centre=(900, 0, 0), radius_m=1.0, max_error_m=0.1).cloud.num_points == 0


def _within(found, wanted, bound):
    """Each has one of the other within the bound, in whatever order; f32 rounds besides."""
    for some, others in ((found, wanted), (wanted, found)):
        cells = {}
        for i, key in enumerate(map(tuple, np.floor(others / 0.05).astype(int))):
            cells.setdefault(key, []).append(i)
        around = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
        for p in some[:: max(1, len(some) // 300)]:
            at = np.floor(p / 0.05).astype(int)
            near = [i for d in around for i in cells.get(tuple(at + d), [])]
            assert near and np.linalg.norm(others[near] - p, axis=1).min() <= bound + 1e-5


def _areas(positions, triangles):
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize("wrong", [0.0, -1.0, 5e-5, 2.0, float("nan"), float("inf")])
def test_a_bound_that_cannot_be_kept_is_refused(lidar_session, wrong):
    asked = {
        "draco_max_error_m": [
            lambda: lidar_session.map.cloud(max_error_m=wrong),
            lambda: lidar_session.space.mesh(max_error_m=wrong),
        ],
        "max_error_m": [
            lambda: lidar_session.map.export("cloud_draco", max_error_m=wrong),
            lambda: lidar_session.map.export("mesh_draco", max_error_m=wrong),
            lambda: lidar_session.map.export("cloud_ply", max_error_m=0.01),
        ],
    }
    for field, calls in asked.items():
        for call in calls:
            with pytest.raises(InvalidArgument) as error:
                call()
            assert (error.value.reason, error.value.field) == ("OUT_OF_RANGE", field)


def test_a_ply_holds_the_cloud(lidar_session):
    data = lidar_session.map.export("cloud_ply").data
    header, _, body = data.partition(b"end_header\n")
    count = int(next(x for x in header.split(b"\n") if x.startswith(b"element vertex")).split()[-1])
    assert count == lidar_session.map.summary().num_points
    assert len(body) % count == 0


def test_a_pgm_and_its_yaml_say_what_the_grid_says(laser_session):
    grid = laser_session.map.occupancy()
    height, width = grid.cells.shape
    pgm = laser_session.map.export("nav2_pgm").data
    lines = [x for x in pgm[:200].split(b"\n") if not x.startswith(b"#")]
    assert b" ".join(lines[:3]).split()[:4] == [b"P5", str(width).encode(), str(height).encode(), b"255"]
    pixels = np.frombuffer(pgm[-width * height :], np.uint8).reshape(height, width)[::-1]
    # As paths are planned in it: what was seen free once is not unknown.
    assert (pixels[grid.cells >= 60] == 0).all()
    assert (pixels[(grid.cells >= 0) & (grid.cells < 60)] == 254).all()
    assert (pixels[grid.cells < 0] == 205).all()
    yaml = dict(x.split(": ", 1) for x in laser_session.map.export("nav2_yaml").data.decode().splitlines() if ": " in x)
    assert float(yaml["resolution"]) == pytest.approx(grid.resolution_m)
    origin = [float(v) for v in yaml["origin"].strip("[]").split(",")]
    assert np.allclose(origin[:2], grid.origin, atol=1e-5)


def test_the_yaml_of_a_nav2_map_names_the_image_that_lies_beside_it(laser_session, tmp_path):
    # It named map.pgm whatever both were called, so that no reader found the image.
    def image_of(yaml):
        return dict(x.split(": ", 1) for x in yaml.read_text().splitlines() if ": " in x)["image"]

    export, kinds = laser_session.map.export, ("yaml", "pgm")
    by_name = [export(f"nav2_{kind}", path=tmp_path / f"hall.{kind}").path for kind in kinds]
    by_folder = [export(f"nav2_{kind}", path=tmp_path).path for kind in kinds]
    for yaml, pgm in (by_name, by_folder):
        assert yaml.with_name(image_of(yaml)) == pgm
    quoted = export("nav2_yaml", path=tmp_path / "hall: 2.yaml")
    assert image_of(quoted.path) == '"hall: 2.pgm"'
    assert hashlib.sha256(quoted.path.read_bytes()).hexdigest() == quoted.sha256


def test_a_tum_file_is_the_trajectory(laser_session):
    rows = laser_session.map.export("trajectory_tum").data.decode().splitlines()
    values = np.array([r.split() for r in rows if not r.startswith("#")], float)
    trajectory = laser_session.trajectory()
    assert np.allclose(values[:, 0], trajectory.stamps_ns / 1e9, atol=1e-6)
    assert np.allclose(values[:, 1:4], trajectory.positions, atol=1e-6)


def test_unknown_formats_and_sessions_are_refused(client, laser_session):
    with pytest.raises(InvalidArgument) as error:
        laser_session.map.export("obj")
    assert error.value.field == "format"
    with pytest.raises(NotFound):
        client.session("nobody").map.summary()


def test_coloured_frames_make_a_coloured_map(client):
    """The left half of every image is red, the right half blue."""
    import dataclasses

    spec = dataclasses.replace(world.CAMERA, kind="rgbd")
    session = client.sessions.create(sensors=[spec])
    colour = np.zeros((240, 320, 3), np.uint8)
    colour[:, :160, 0] = 200
    colour[:, 160:, 2] = 200
    depth = world.depth_image(world.drive(1)[0])
    session.send_rgbd("camera", stamp_ns=1, depth=depth, colour=colour, metres_per_unit=0.001)
    cloud = session.map.cloud().cloud
    assert cloud.colours is not None
    left, right = cloud.points[:, 1] > 0.2, cloud.points[:, 1] < -0.2
    assert cloud.colours[left].mean(0) == pytest.approx([200, 0, 0], abs=15)
    assert cloud.colours[right].mean(0) == pytest.approx([0, 0, 200], abs=15)


def test_a_map_without_loops_says_so(client):
    session = client.sessions.create(sensors=[world.LASER])
    assert list(session.map.loops()) == []
    assert session.map.optimise().num_keyframes_moved == 0
    for decide in (session.map.veto_loop, session.map.allow_loop):
        with pytest.raises(NotFound) as error:
            decide(3)
        assert (error.value.reason, error.value.field) == ("LOOP_NOT_FOUND", "loop_id")

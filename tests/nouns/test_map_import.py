"""A map that comes from elsewhere is a map: planned in, found in, drawn, exported."""

from __future__ import annotations

import numpy as np
import pytest
from percept import (
    FailedPrecondition,
    GridMap,
    InvalidArgument,
    MapFormat,
    NoPath,
    Path,
    PointCloud,
    Pose,
    SensorKind,
    SensorSpec,
    SessionCloud,
    TrackingState,
)

from support import world

RESOLUTION_M = 0.05


def floor_plan() -> GridMap:
    """The room at the height of the laser's beams, in the world's frame; nothing is known beyond the walls."""
    low, high = world.ROOM
    origin = low[:2] - 0.5
    width, height = np.round((high[:2] - low[:2] + 1.0) / RESOLUTION_M).astype(int)
    x, y = np.meshgrid(
        origin[0] + (np.arange(width) + 0.5) * RESOLUTION_M, origin[1] + (np.arange(height) + 0.5) * RESOLUTION_M
    )
    cells = np.full((height, width), -1, np.int8)

    def within(a, b, margin=0.0):
        return (x > a[0] - margin) & (x < b[0] + margin) & (y > a[1] - margin) & (y < b[1] + margin)

    cells[within(low, high, 2 * RESOLUTION_M)] = 100
    cells[within(low, high)] = 0
    for a, b in world.FURNITURE:
        cells[within(a, b)] = 100
    return GridMap(cells=cells, resolution_m=RESOLUTION_M, origin=tuple(origin))


def drive_through(session, poses, send, first=0):
    with session.stream() as stream:
        for i, pose in enumerate(poses):
            send(stream, world.stamp(first + i), pose)
    assert stream.summary.rejected == 0, stream.summary.rejections


def send_scan(stream, stamp_ns, pose):
    stream.send_scan("laser", stamp_ns=stamp_ns, **world.scan(pose))


def send_cloud(stream, stamp_ns, pose):
    stream.send_cloud("lidar", stamp_ns=stamp_ns, points=world.cloud(pose))


def fine_session(client, sensor):
    """One whose cells are those of the plan."""
    return client.sessions.create(sensors=[sensor], params={"map": {"occupancy": {"resolution_m": RESOLUTION_M}}})


def test_a_floor_plan_is_planned_in_and_a_robot_is_found_in_it(client):
    session = fine_session(client, world.LASER)
    plan = floor_plan()
    done = session.map.import_map(plan)
    assert done.found_by is SensorKind.LIDAR2D
    assert done.free_share > 0.99
    assert done.occupied_share > 0.2
    # The same cells come back, but for what lies inside of walls.
    grid = session.map.occupancy()
    for (row, column), value in np.ndenumerate(plan.cells):
        p = np.array(plan.origin) + (np.array([column, row]) + 0.5) * RESOLUTION_M
        now = grid.cell_at(*p)
        if value == 0:
            assert now is not None and 0 <= now < 50, p
        elif value == 100:
            assert now in (-1, None) or now > 60, p
    path = session.plan((-2.0, 1.0), start=(2.2, 0.2))
    assert isinstance(path, Path)
    through = session.plan((1.6, 1.0), start=(2.2, 0.2))
    assert isinstance(through, NoPath)

    poses = world.circle()
    drive_through(session, poses, send_scan)
    pose = session.pose()
    assert pose.state is TrackingState.TRACKING
    assert world.position_error_m(pose.t_map_base, poses[-1].matrix) < 0.05


def test_a_robot_starts_where_it_is_told_to_be(client):
    session = fine_session(client, world.LASER)
    poses = world.drive(12)
    told = poses[0].matrix @ Pose.from_xy_yaw(0.1, 0.05, 0.05).matrix
    session.map.import_map(floor_plan(), start=told)
    drive_through(session, poses[:1], send_scan)
    assert session.pose().state is TrackingState.TRACKING
    drive_through(session, poses[1:], send_scan, first=1)
    assert world.position_error_m(session.pose().t_map_base, poses[-1].matrix) < 0.05


def test_a_robot_that_only_localises_leaves_the_map_as_it_is_until_it_may_map(client):
    params = {"map": {"occupancy": {"resolution_m": RESOLUTION_M}}, "slam": {"localisation_only": True}}
    session = client.sessions.create(sensors=[world.LASER], params=params)
    poses = world.drive(40)
    drive_through(session, poses[:3], send_scan)
    assert session.pose().state is TrackingState.LOST, "without a map it is nowhere"
    # What the plan has there and is not stays, too.
    plan = floor_plan()
    plan.cells[24:28, 24:28] = 100
    session.map.import_map(plan)
    before = session.map.occupancy()
    drive_through(session, poses[3:], send_scan, first=3)
    pose = session.pose()
    assert pose.state is TrackingState.TRACKING
    assert world.position_error_m(pose.t_map_base, poses[-1].matrix) < 0.08
    assert np.array_equal(session.map.occupancy().cells, before.cells)
    session.update(params={"slam": {"localisation_only": False}})
    drive_through(session, poses, send_scan, first=len(poses))
    assert session.pose().state is TrackingState.TRACKING
    assert session.info().params["slam"]["localisation_only"] is False


@pytest.mark.parametrize("height_m", [world.LASER_HEIGHT_M, 0.0])
def test_what_a_plan_shows_and_is_not_there_leaves_the_map_while_the_robot_stands(client, height_m):
    """At base's own height, too: a laser whose mount nobody has declared."""
    mount = Pose.from_xyz(0.0, 0.0, height_m)
    laser = SensorSpec("laser", kind="lidar2d", t_base_sensor=mount, overload_policy="block")
    session, plan = fine_session(client, laser), floor_plan()
    low, high = (np.round((np.array(p) - plan.origin) / RESOLUTION_M).astype(int) for p in ((-1.7, 0.3), (-1.3, 0.7)))
    plan.cells[low[1] : high[1], low[0] : high[0]] = 100
    here = Pose.from_xyz(0.3, 0.1, 0.0)
    session.map.import_map(plan, start=here)
    side = (-1.33, 0.5)
    assert session.map.occupancy().cell_at(*side) > 60
    drive_through(session, [here] * 60, send_scan)
    assert session.pose().state is TrackingState.TRACKING
    assert session.map.occupancy().cell_at(*side) < 50
    assert session.map.occupancy().cell_at(3.02, 0.0) > 60, "walls stay"


def test_nav2s_files_of_one_session_begin_another(client, laser_session, tmp_path):
    session = fine_session(client, world.LASER)
    laser_session.map.export(MapFormat.NAV2_YAML, path=tmp_path / "map.yaml")
    laser_session.map.export(MapFormat.NAV2_PGM, path=tmp_path / "map.pgm")
    session.map.import_map(tmp_path / "map.yaml")
    poses = world.circle()
    drive_through(session, poses, send_scan)
    pose, truth = session.pose(), world.truth_in_map([world.drive(1)[0], poses[-1]])[1]
    assert pose.state is TrackingState.TRACKING
    assert world.position_error_m(pose.t_map_base, truth) < 0.08


@pytest.mark.parametrize("kind", ["octomap", "cloud"])
def test_a_3d_lidar_is_found_in_what_another_session_mapped(client, lidar_session, kind, tmp_path):
    session = client.sessions.create(sensors=[world.LIDAR])
    if kind == "octomap":
        lidar_session.map.export(MapFormat.VOXELS_BT, path=tmp_path / "map.bt")
        done = session.map.import_map(tmp_path / "map.bt")
    else:
        done = session.map.import_map(SessionCloud(lidar_session.session_id))
    assert done.found_by is SensorKind.LIDAR3D
    assert done.occupied_share > 0.5
    before = session.map.summary().num_points
    assert before > 1000
    poses = world.lidar_drive()[::-1]
    drive_through(session, poses, send_cloud)
    pose, truth = session.pose(), world.truth_in_map([world.drive(1)[0], poses[-1]])[1]
    assert pose.state is TrackingState.TRACKING
    error = pose.t_map_base.translation[:2] - truth[:2, 3]
    assert np.linalg.norm(error) < 0.1, error


def test_a_session_with_a_map_takes_no_other(client, laser_session):
    before = laser_session.map.summary()
    with pytest.raises(FailedPrecondition) as error:
        laser_session.map.import_map(floor_plan())
    assert error.value.reason == "MAP_NOT_EMPTY"
    assert laser_session.map.summary() == before


def test_what_cannot_be_a_map_is_refused_and_the_session_is_as_it_was(client):
    session = client.sessions.create(sensors=[world.LASER])
    unknown = GridMap(cells=np.full((4, 4), -1, np.int8), resolution_m=0.05, origin=(0.0, 0.0))
    some = PointCloud(np.random.default_rng(1).uniform(0, 1, (50, 3)).astype(np.float32))
    bad_pose = np.eye(4)
    bad_pose[0, 3] = np.nan
    for given, options, reason, field in [
        (unknown, {}, "MAP_UNUSABLE", "grid"),
        (np.zeros((0, 3), np.float32), {}, "MAP_UNUSABLE", "cloud"),
        (floor_plan(), {"sensor_height_m": 1e9}, "OUT_OF_RANGE", "sensor_height_m"),
        (floor_plan(), {"sensor_height_m": float("nan")}, "OUT_OF_RANGE", "sensor_height_m"),
        (some, {"voxel_size_m": 1e-9}, "OUT_OF_RANGE", "voxel_size_m"),
        (np.array([[1e30, 0, 0]], np.float32), {}, "OUT_OF_RANGE", "cloud"),
    ]:
        with pytest.raises(InvalidArgument) as error:
            session.map.import_map(given, **options)
        assert (error.value.reason, error.value.field.removeprefix("import_map.")) == (reason, field)
    with pytest.raises(InvalidArgument):
        session.map.import_map(floor_plan(), start=bad_pose)
    assert session.map.summary().num_keyframes == 0
    assert session.map.import_map(floor_plan()).num_keyframes > 5


def test_files_that_are_cut_are_refused(client, lidar_session, tmp_path):
    session = client.sessions.create(sensors=[world.LIDAR])
    whole = lidar_session.map.export(MapFormat.VOXELS_BT).data
    for size in (0, 20, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.bt").write_bytes(whole[:size])
        with pytest.raises(InvalidArgument) as error:
            session.map.import_map(tmp_path / "cut.bt")
        assert (error.value.reason, error.value.field) == ("FILE_INVALID", "octomap")


def city(cells_along: int = 1200) -> GridMap:
    """Blocks and streets: a map that takes a while."""
    cells = np.zeros((cells_along, cells_along), np.int8)
    along = np.arange(cells_along) % 80 >= 30
    cells[np.ix_(along, along)] = 100
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    return GridMap(cells=cells, resolution_m=RESOLUTION_M, origin=(0.0, 0.0))


def test_an_import_is_an_operation_and_waited_for_or_not_gives_the_same_map(client):
    waited, watched = (fine_session(client, world.LASER) for _ in range(2))
    done = waited.map.import_map(floor_plan())
    operation = watched.map.import_map(floor_plan(), wait=False, request_id="plan-1")
    assert operation.result(timeout_s=60) == done
    info = operation.info
    assert (info.kind, info.state, info.session_id) == ("import_map", "done", watched.session_id)
    assert (info.stage, info.fraction) == ("step 4 of 4: storing it", 1.0)
    assert np.array_equal(watched.map.occupancy().cells, waited.map.occupancy().cells)
    # Started again it is the same one; as another it is refused at once.
    again = watched.map.import_map(floor_plan(), wait=False, request_id="plan-1")
    assert again.operation_id == operation.operation_id
    with pytest.raises(FailedPrecondition) as error:
        watched.map.import_map(floor_plan(), wait=False)
    assert error.value.reason == "MAP_NOT_EMPTY"
    # What was waited for leaves none behind.
    assert waited.session_id not in [o.session_id for o in client.operations.list()]


def test_a_map_that_is_none_fails_the_operation_and_options_that_are_none_are_refused_at_once(client):
    session = fine_session(client, world.LASER)
    unknown = GridMap(cells=np.full((4, 4), -1, np.int8), resolution_m=0.05, origin=(0.0, 0.0))
    operation = session.map.import_map(unknown, wait=False)
    with pytest.raises(InvalidArgument) as error:
        operation.result(timeout_s=60)
    assert (error.value.reason, error.value.field) == ("MAP_UNUSABLE", "grid")
    assert operation.info.state == "failed"
    with pytest.raises(InvalidArgument) as error:
        session.map.import_map(floor_plan(), sensor_height_m=1e9, wait=False)
    assert error.value.field == "import_map.sensor_height_m"
    assert session.map.summary().num_keyframes == 0


@pytest.mark.parametrize("stage", ["looking", "entering"])
def test_an_import_that_is_cancelled_leaves_the_session_as_it_was(client, stage):
    session = fine_session(client, world.LASER)
    operation = session.map.import_map(city(), wait=False)
    for info in operation.watch(every_s=0.01):
        assert not info.has_ended, "it was meant to take long; give it more to do"
        if stage in info.stage:
            break
    operation.cancel()
    assert operation.wait(120).state == "cancelled"
    with pytest.raises(FailedPrecondition) as error:
        operation.result()
    assert error.value.reason == "OPERATION_CANCELLED"
    summary = session.map.summary()
    assert (summary.num_keyframes, summary.num_points) == (0, 0)
    assert session.map.import_map(floor_plan()).num_keyframes > 5
    drive_through(session, world.circle(), send_scan)
    assert session.pose().state is TrackingState.TRACKING

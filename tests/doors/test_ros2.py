"""Robots on ROS 2: their topics by zenoh in, poses and maps back."""

from __future__ import annotations

import time

import numpy as np
import pytest
from percept import Client, NotFound, Pose

from support import ros2, world
from support.links import Link
from support.ros2 import Robot, Router
from support.server import Server, eventually, free_port

#: Percept is given this long to look at what there is.
SETTLE_S = 2.0
#: And this much longer at most, where the machine does other things.
PATIENCE_S = 30.0


_STARTED: list[Server] = []


@pytest.fixture(autouse=True)
def no_server_stays():
    """Kills what a test that failed has left."""
    yield
    while _STARTED:
        _STARTED.pop().kill()


def serve(tmp_path, endpoint: str, config: str = "") -> Server:
    """A server with one robot."""
    file = tmp_path / "percept.toml"
    file.write_text(f'[[ros2.robots]]\nsession = "robot"\n{config or f"connect = {endpoint!r}"}\n')
    _STARTED.append(Server(tmp_path / "data", "--config", str(file)))
    return _STARTED[-1]


@pytest.fixture
def router():
    with Router() as router:
        yield router


def describe(robot: Robot, tf: str = "/tf_static") -> None:
    """Where the laser is, as a latched transform."""
    static = ros2.transform(world.stamp(0), "base_link", "laser_link", world.LASER.t_base_sensor)
    robot.publish(tf, ros2.transforms(static), latched=True)


def step(robot: Robot, i: int, truth: Pose, *, space: str = "", wheels: bool = True) -> None:
    """One scan, and where the wheels say the robot is: in a frame of their own."""
    now = world.stamp(i)
    drift = Pose.from_xyz(0.3, -0.2, 0.0)
    t_odom_base = drift @ truth
    if wheels:
        robot.publish(f"{space}/odom", ros2.odometry(now, t_odom_base))
    robot.publish(f"{space}/tf", ros2.transforms(ros2.transform(now, "odom", "base_link", t_odom_base)))
    robot.publish(f"{space}/scan", ros2.scan(now, "laser_link", world.scan(truth)))


def is_placed(client: Client) -> bool:
    """Whether percept has found the robot's sensors, and says where it is."""
    try:
        return client.session("robot").pose() is not None
    except NotFound:
        return False


def stand(client: Client, robot: Robot, truth: Pose, *, first: int = 0, seconds: float = SETTLE_S) -> int:
    """Stands still for so long, and until percept knows the robot; the number of the next step."""
    end, i = time.monotonic() + seconds, first
    while time.monotonic() < end or not is_placed(client):
        assert time.monotonic() < end + PATIENCE_S, "percept does not find the robot"
        step(robot, i, truth)
        time.sleep(0.066)
        i += 1
    return i


def drive(client: Client, robot: Robot, first: int, num: int, *, space: str = "") -> list[Pose]:
    """Drives through the room at the pace at which frames are taken; the truth of each step."""
    poses = world.drive(num)
    for k, truth in enumerate(poses):
        step(robot, first + k, truth, space=space)
        time.sleep(0.05)
    session = client.session("robot")
    last = world.stamp(first + num - 1)
    assert eventually(lambda: session.pose() and session.pose().stamp_ns == last), session.sensors.list()
    return poses


#: Humble is older than types' hashes, and its attachments have labels.
@pytest.mark.parametrize("kind", ["jazzy", "humble", "dds"])
def test_a_robot_is_mapped_and_gets_poses_and_a_map_back(tmp_path, router, kind):
    options = {"labels": kind == "humble", "humble": kind == "humble", "dds": kind == "dds"}
    with Robot(router.endpoint, **options) as robot:
        # Latched before anybody listens.
        describe(robot)
        protocol = "ros2dds" if kind == "dds" else "rmw_zenoh"
        server = serve(tmp_path, "", f"connect = {router.endpoint!r}\nprotocol = {protocol!r}")
        tf, poses = robot.subscribe("/tf", "tf2_msgs/msg/TFMessage"), None
        with Client(server.grpc) as client:
            start = world.drive(1)[0]
            first = stand(client, robot, start)
            session = client.session("robot")
            sensors = {s.spec.sensor_id: s for s in session.sensors.list()}
            assert set(sensors) == {"scan", "odom"}, server.tail()
            assert sensors["scan"].spec.kind == "lidar2d"
            np.testing.assert_allclose(sensors["scan"].spec.t_base_sensor.translation, [0, 0, world.LASER_HEIGHT_M])
            poses = robot.subscribe("/percept/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
            grids = robot.subscribe("/map", "nav_msgs/msg/OccupancyGrid", latched=True)
            truth = drive(client, robot, first, 25)
            # The map begins where the robot was when it was first seen, which is where it starts.
            expected = world.truth_in_map(truth)[-1]
            found = session.pose().t_map_base
            assert world.position_error_m(found, expected) < 0.03
            told = poses.newest().pose.pose.position
            np.testing.assert_allclose([told.x, told.y], found.translation[:2], atol=0.02)
            assert all(len(a) == 33 or kind == "dds" for a in poses.attachments)
            grid = grids.newest()
            assert set(np.unique(grid.data)) == {-1, 0, 100}  # as nav2's costmap wants it
            assert grid.header.frame_id == "map"
            assert grid.info.resolution == pytest.approx(session.map.occupancy().resolution_m)
            assert len(grid.data) == grid.info.width * grid.info.height
            # map -> odom, and odom -> base of the robot's own, are map -> base.
            last = world.stamp(first + 24)
            ours = lambda: [  # noqa: E731
                t
                for m in tf.messages
                for t in m.transforms
                if t.header.frame_id == "map" and t.header.stamp.sec * 10**9 + t.header.stamp.nanosec == last
            ]
            assert eventually(lambda: len(ours()) > 0), server.tail()
            moved = ours()[-1]
            assert moved.child_frame_id == "odom"
            at, turn = moved.transform.translation, moved.transform.rotation
            t_map_odom = Pose(
                translation=np.array([at.x, at.y, at.z]), rotation=np.array([turn.x, turn.y, turn.z, turn.w])
            )
            t_odom_base = Pose.from_xyz(0.3, -0.2, 0.0) @ truth[-1]
            assert world.position_error_m(t_map_odom @ t_odom_base, expected) < 0.04
        assert server.stop() == 0


def test_depth_and_colour_are_one_camera(tmp_path, router):
    truth = world.drive(12)
    with Robot(router.endpoint) as robot:
        server = serve(tmp_path, router.endpoint)
        static = ros2.transform(world.stamp(0), "base_link", "camera_optical", world.CAMERA.t_base_sensor)
        robot.publish("/tf_static", ros2.transforms(static), latched=True)

        def show(i: int, at: Pose) -> None:
            now = world.stamp(i)
            robot.publish("/camera/depth/camera_info", ros2.camera_info(now, "camera_optical", world.INTRINSICS))
            robot.publish("/camera/color/camera_info", ros2.camera_info(now, "camera_optical", world.INTRINSICS))
            grey = np.full((world.INTRINSICS.height_px, world.INTRINSICS.width_px, 3), 90, np.uint8)
            colour = ros2.image(now + 5_000_000, "camera_optical", grey, "rgb8")
            robot.publish("/camera/color/image_raw", colour)
            robot.publish("/camera/depth/image_raw", ros2.image(now, "camera_optical", world.depth_image(at), "16UC1"))

        with Client(server.grpc) as client:
            i, end = 0, time.monotonic() + 4
            while time.monotonic() < end or not is_placed(client):
                assert time.monotonic() < end + PATIENCE_S, server.tail()
                show(i, truth[0])
                time.sleep(0.1)
                i += 1
            for at in truth:
                show(i, at)
                time.sleep(0.15)
                i += 1
            session = client.session("robot")
            assert eventually(lambda: session.pose() and session.pose().stamp_ns == world.stamp(i - 1)), server.tail()
            (sensor,) = session.sensors.list()
            assert (sensor.spec.kind, sensor.spec.sensor_id) == ("rgbd", "camera_depth_image_raw")
            assert sensor.spec.intrinsics.fx_px == world.INTRINSICS.fx_px
            assert world.position_error_m(session.pose().t_map_base, world.truth_in_map(truth)[-1]) < 0.05
        assert server.stop() == 0


def test_clouds_by_transforms_alone_and_a_namespace(tmp_path, router):
    """A lidar, no odometry but the transforms', behind a namespace; a second robot's topics are not taken."""
    with Robot(router.endpoint) as robot:
        server = serve(tmp_path, "", f'connect = "{router.endpoint}"\nnamespace = "a"\npublishes = false')
        static = ros2.transform(world.stamp(0), "base_link", "lidar_link", world.LIDAR.t_base_sensor)
        robot.publish("/a/tf_static", ros2.transforms(static), latched=True)
        with Client(server.grpc) as client:
            truth = world.lidar_drive()
            i, end = 0, time.monotonic() + 4.5
            at = truth[0]
            while time.monotonic() < end or i < 20 or not is_placed(client):
                assert time.monotonic() < end + PATIENCE_S, server.tail()
                now = world.stamp(i)
                robot.publish("/a/tf", ros2.transforms(ros2.transform(now, "odom", "base_link", at)))
                robot.publish("/a/points", ros2.cloud(now, "lidar_link", world.cloud(at)))
                robot.publish("/b/scan", ros2.scan(now, "laser_link", world.scan(at)))
                time.sleep(0.2)
                i += 1
            session = client.session("robot")
            last = world.stamp(i - 1)
            assert eventually(lambda: session.pose() and session.pose().stamp_ns == last), server.tail()
            kinds = {s.spec.sensor_id: s.spec.kind for s in session.sensors.list()}
            assert kinds == {"a_points": "lidar3d", "tf": "odometry"}
            assert session.pose().state == "tracking"
            assert not [t for t in robot.tokens() if "percept" in t]
        assert server.stop() == 0


def test_what_is_no_message_is_counted_and_harms_nobody(tmp_path, router):
    with Robot(router.endpoint) as robot:
        describe(robot)
        server = serve(tmp_path, router.endpoint)
        with Client(server.grpc) as client:
            start = world.drive(1)[0]
            first = stand(client, robot, start)
            session = client.session("robot")
            good = ros2.scan(world.stamp(first), "laser_link", world.scan(start))
            cdr = bytes(ros2.STORE.serialize_cdr(good, good.__msgtype__))
            kind = "sensor_msgs/msg/LaserScan"
            rubbish = [b"", b"\x00\x01\x00\x00", b"\xff" * 200, cdr[: len(cdr) // 2], cdr[:40] + b"\xff" * 16]
            for payload in rubbish:
                robot.publish_raw("/scan", kind, payload)
            # Of another layout, as another type would be.
            odometry = ros2.odometry(world.stamp(first), start)
            robot.publish_raw("/scan", kind, bytes(ros2.STORE.serialize_cdr(odometry, odometry.__msgtype__)))
            of = lambda: {s.spec.sensor_id: s for s in session.sensors.list()}["scan"]  # noqa: E731
            assert eventually(lambda: of().rejected == len(rubbish) + 1), of()
            # A sensor does not move to another frame.
            robot.publish("/scan", ros2.scan(world.stamp(first), "elsewhere", world.scan(start)))
            assert eventually(lambda: of().rejected == len(rubbish) + 2), of()
            robot.publish_raw("/points", "sensor_msgs/msg/PointCloud2", b"\x00\x01\x00\x00" + b"\xff" * 60)
            robot.publish_raw("/tf", "tf2_msgs/msg/TFMessage", b"\x00\x01\x00\x00" + b"\xff" * 60)
            # Numbers of two publishers of one topic are no gaps.
            step(robot, first + 1, start)
            assert eventually(lambda: session.pose().stamp_ns == world.stamp(first + 1))
            gaps = of().gaps
            with Robot(router.endpoint) as second:
                for k in range(10):
                    second.publish("/scan", ros2.scan(world.stamp(first), "laser_link", world.scan(start)))
                    step(robot, first + 2 + k, start)
                    time.sleep(0.05)
            drive(client, robot, first + 12, 5)
            assert session.pose().state == "tracking"
            assert of().gaps == gaps
            assert "LaserScan" in server.tail()
        assert server.stop() == 0


def test_the_router_goes_and_comes_back(tmp_path, router):
    with Robot(router.endpoint) as robot:
        describe(robot)
        server = serve(tmp_path, router.endpoint)
        with Client(server.grpc) as client:
            start = world.drive(1)[0]
            first = stand(client, robot, start)
            session = client.session("robot")
            assert session.pose().state == "tracking"
            router.close()
            time.sleep(1.0)
            router.start()
            accepted = session.sensors.list()[0].accepted

            def goes_on() -> bool:
                nonlocal first
                step(robot, first, start)
                first += 1
                time.sleep(0.1)
                return session.sensors.list()[0].accepted > accepted + 5

            assert eventually(goes_on, seconds=30), server.tail()
        assert server.stop() == 0


def test_a_session_that_is_deleted_begins_anew(tmp_path, router):
    with Robot(router.endpoint) as robot:
        describe(robot)
        server = serve(tmp_path, router.endpoint)
        with Client(server.grpc) as client:
            start = world.drive(1)[0]
            first = stand(client, robot, start)
            client.session("robot").delete()
            first = stand(client, robot, start, first=first, seconds=3.0)
            session = client.session("robot")
            assert {s.spec.sensor_id for s in session.sensors.list()} == {"scan", "odom"}
            assert session.pose().state in ("tracking", "initialising")
        assert server.stop() == 0


def test_a_goal_is_answered_by_a_path_and_the_map_of_others_is_left_to_them(tmp_path, router):
    with Robot(router.endpoint) as robot:
        describe(robot)
        other = ros2.T["nav_msgs/msg/OccupancyGrid"](
            header=ros2.header(world.stamp(0), "map"),
            info=ros2.T["nav_msgs/msg/MapMetaData"](
                map_load_time=ros2.stamp(0), resolution=0.1, width=1, height=1, origin=ros2.pose(Pose())
            ),
            data=np.zeros(1, np.int8),
        )
        robot.publish("/map", other, latched=True)
        server = serve(tmp_path, router.endpoint)
        plans = robot.subscribe("/percept/plan", "nav_msgs/msg/Path", latched=True)
        clouds = robot.subscribe("/percept/cloud", "sensor_msgs/msg/PointCloud2")
        paths = robot.subscribe("/percept/path", "nav_msgs/msg/Path")
        boxes = robot.subscribe("/percept/objects", "visualization_msgs/msg/MarkerArray")
        with Client(server.grpc) as client:
            first = stand(client, robot, world.drive(1)[0])
            drive(client, robot, first, 25)
            session = client.session("robot")
            goal = ros2.T["geometry_msgs/msg/PoseStamped"](
                header=ros2.header(0, "map"), pose=ros2.pose(Pose.from_xyz(0.5, 0.0, 0.0))
            )
            # RViz declares its publisher and sends some time later.
            robot.publish("/goal_pose", goal)
            time.sleep(1.0)
            robot.publish("/goal_pose", goal)
            plan = plans.newest()
            at = plan.poses[-1].pose.position
            assert (at.x, at.y) == pytest.approx((0.5, 0.0))
            start, here = plan.poses[0].pose.position, session.pose().t_map_base.translation
            assert np.hypot(start.x - here[0], start.y - here[1]) < 0.1
            here = session.pose().t_map_base
            turned = Pose.from_matrix(here.matrix @ Pose.from_xy_yaw(0.0, 0.0, 1.6).matrix)
            number = first + 25
            # The first one may be sent before it is listened to.
            for _ in range(2):
                robot.publish("/initialpose", ros2.pose_estimate("map", turned))
                number = stand(client, robot, world.drive(25)[-1], first=number, seconds=1.0)
            assert "POSE_REFUTED" in server.tail()
            assert not session.pose().tentative
            near = Pose.from_matrix(here.matrix @ Pose.from_xy_yaw(0.2, 0.1, 0.1).matrix)
            robot.publish("/initialpose", ros2.pose_estimate("map", near))
            stand(client, robot, world.drive(25)[-1], first=number, seconds=1.0)
            assert session.pose().tentative
            assert np.linalg.norm(session.pose().t_map_base.translation - here.translation) < 0.1
            assert paths.newest().poses
            assert boxes.newest() is not None
            assert "somebody else publishes the map" in server.tail()
            assert not [t for t in robot.tokens() if "percept" in t and "%map/" in t and "MP" in t]
            del clouds
        assert server.stop() == 0


def test_a_robot_connects_to_percept(tmp_path):
    """The robot's router reaches percept, not the other way round; its nodes are behind it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    server = serve(tmp_path, "", f'listen = "{endpoint}"')
    with Link(endpoint) as link, Robot(link.endpoint, listens=True) as robot, Client(server.grpc) as client:
        describe(robot)
        first, told = 0, 0

        def is_tracking() -> bool:
            nonlocal first
            # Routers look for each other every few seconds.
            first = stand(client, robot, world.drive(1)[0], first=first, seconds=0.5)
            pose = client.session("robot").pose()
            return pose.state == "tracking" and pose.stamp_ns > told

        # The link breaks and is there again at once, as wireless ones do.
        for _ in range(4):
            assert eventually(is_tracking, seconds=30), server.tail()
            told = client.session("robot").pose().stamp_ns
            link.cut()
    assert server.stop() == 0


def links(heard) -> set[tuple[str, str]]:
    """Parents and children in what was heard of transforms."""
    return {(t.header.frame_id, t.child_frame_id) for m in heard.messages for t in m.transforms}


def test_odometry_may_count_in_a_frame_of_any_name_and_base_has_one_parent(tmp_path, router):
    """Frames of a fleet have prefixes; another node that places odometry in the map is left to do so."""
    with Robot(router.endpoint) as robot:
        server = serve(tmp_path, router.endpoint)
        static = ros2.transform(world.stamp(0), "r1/base_link", "r1/laser", world.LASER.t_base_sensor)
        robot.publish("/tf_static", ros2.transforms(static), latched=True)
        tf = robot.subscribe("/tf", "tf2_msgs/msg/TFMessage")

        def send(i: int, *beside) -> None:
            now = world.stamp(i)
            here = ros2.transform(now, "r1/odom", "r1/base_link", world.drive(1)[0])
            robot.publish("/tf", ros2.transforms(here, *beside))
            robot.publish("/scan", ros2.scan(now, "r1/laser", world.scan(world.drive(1)[0])))
            time.sleep(0.066)

        with Client(server.grpc) as client:
            i, end = 0, time.monotonic() + PATIENCE_S
            while ("map", "r1/odom") not in links(tf):
                assert time.monotonic() < end, server.tail()
                send(i)
                i += 1
            (laser,) = [s for s in client.session("robot").sensors.list() if s.spec.sensor_id == "scan"]
            np.testing.assert_allclose(laser.spec.t_base_sensor.translation, [0, 0, world.LASER_HEIGHT_M])
            assert ("map", "r1/base_link") not in links(tf)
            # A localiser of the robot's own.
            theirs = ros2.transform(world.stamp(i), "map", "r1/odom", Pose.from_xyz(9.0, 0.0, 0.0))
            for k in range(20):
                send(i + k, theirs)
            heard = len(tf.messages)
            for k in range(20, 40):
                send(i + k, theirs)
            ours = [t for m in tf.messages[heard:] for t in m.transforms if t.header.frame_id == "map"]
            assert all(t.transform.translation.x == 9.0 for t in ours), server.tail()
        assert server.stop() == 0


def test_a_camera_may_be_calibrated_late_and_its_colour_be_too_late(tmp_path, router):
    """A calibration long after the images; colour that is never made when depth is: that is taken alone."""
    with Robot(router.endpoint) as robot:
        server = serve(tmp_path, router.endpoint)
        static = ros2.transform(world.stamp(0), "base_link", "optical", world.CAMERA.t_base_sensor)
        robot.publish("/tf_static", ros2.transforms(static), latched=True)
        grey = np.full((world.INTRINSICS.height_px, world.INTRINSICS.width_px, 3), 90, np.uint8)
        depth = world.depth_image(world.drive(1)[0])
        i = 0

        def show(*, calibrated: bool) -> None:
            nonlocal i
            now = world.stamp(i)
            if calibrated:
                for camera in ("depth", "color"):
                    info = ros2.camera_info(now, "optical", world.INTRINSICS)
                    robot.publish(f"/camera/{camera}/camera_info", info)
            robot.publish("/camera/color/image_raw", ros2.image(now + 30_000_000, "optical", grey, "rgb8"))
            robot.publish("/camera/depth/image_raw", ros2.image(now, "optical", depth, "16UC1"))
            i += 1
            time.sleep(0.066)

        with Client(server.grpc) as client:
            notes = lambda: {n.stream: n.message for n in client.session("robot").info().stream_notes}  # noqa: E731
            end = time.monotonic() + PATIENCE_S
            while not (i > 20 and is_known(client) and "/camera/depth/image_raw" in notes()):
                assert time.monotonic() < end, server.tail()
                show(calibrated=False)
            assert "camera_info" in notes()["/camera/depth/image_raw"]
            end = time.monotonic() + PATIENCE_S
            while not is_placed(client):
                assert time.monotonic() < end, server.tail()
                show(calibrated=True)
            assert "without colour" in notes()["/camera/depth/image_raw"]
        assert server.stop() == 0


def is_known(client: Client) -> bool:
    """Whether the robot's session is there."""
    try:
        return client.session("robot").info() is not None
    except NotFound:
        return False


def test_clocks_limits_and_mounts_that_are_not_as_they_should(tmp_path, router):
    """Stamps of 0 before a simulation's clock begins; a scan without a limit; a mount put right too late."""
    with Robot(router.endpoint) as robot:
        server = serve(tmp_path, router.endpoint)
        describe(robot)
        at = world.drive(1)[0]

        def send(ns: int) -> None:
            scan = ros2.scan(ns, "laser_link", world.scan(at))
            scan.range_max = float("inf")
            robot.publish("/scan", scan)
            robot.publish("/odom", ros2.odometry(ns, at))
            time.sleep(0.066)

        def laser():
            found = [s for s in client.session("robot").sensors.list() if s.spec.sensor_id == "scan"]
            return found[0] if found else None

        with Client(server.grpc) as client:
            end = time.monotonic() + PATIENCE_S
            while not (is_known(client) and laser() and laser().rejected > 3):
                assert time.monotonic() < end, server.tail()
                send(0)
            assert {r.reason for r in laser().refusals} == {"STAMP_ZERO"}
            assert client.session("robot").pose() is None
            i = 0
            while not is_placed(client):
                assert i < 300, server.tail()
                send(world.stamp(i) % 10**12)
                i += 1
            assert laser().accepted > 0
            assert {r.reason for r in laser().refusals} == {"STAMP_ZERO"}
            # The lidar hangs half a metre ahead after all.
            moved = Pose.from_xyz(0.5, 0.0, world.LASER_HEIGHT_M)
            static = ros2.transform(world.stamp(0), "base_link", "laser_link", moved)
            robot.publish("/tf_static", ros2.transforms(static), latched=True)
            told = lambda: [n.message for n in client.session("robot").info().stream_notes if n.stream == "/scan"]  # noqa: E731
            assert eventually(lambda: any("0.50 m" in words for words in told())), server.tail()
        assert server.stop() == 0


def test_settings_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(AssertionError, match=r"ros2\.robots\[0\]\.connect is .*robot:7447.*write tcp/ or udp/"):
        serve(tmp_path, "", 'connect = "robot:7447"')

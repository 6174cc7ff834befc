"""Servers, clients, doors and sessions for all tests."""

from __future__ import annotations

import uuid

import pytest
from percept import Client

from support import world
from support.doors import DOORS
from support.server import Server, binary, recorded


def pytest_collection_modifyitems(items):
    if not binary().exists():
        reason = f"no server at {binary()}; run: cargo build --release -p percept"
        pytest.exit(reason, returncode=2)


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """One server that tests share; each has sessions of its own. What several share does not fall asleep, however slow
    they are: of a session that was woken nobody knows where its robot is before its next frame.
    """
    folder = tmp_path_factory.mktemp("percept")
    (folder / "shared.toml").write_text("[limits]\nsleep_after_s = 86400\n")
    server = Server(folder / "data", "--config", str(folder / "shared.toml"))
    yield server
    assert server.stop() == 0, server.tail()


@pytest.fixture
def own_server(tmp_path):
    """A server of the test's own, to be killed."""
    server = Server(tmp_path / "data")
    yield server
    server.kill()


@pytest.fixture(scope="session")
def client(server):
    with Client(server.grpc) as client:
        yield client


@pytest.fixture
def name():
    """A name that no other test has."""
    return f"t-{uuid.uuid4().hex[:12]}"


@pytest.fixture
def door(request, server, client):
    """A door, by the parameter of @pytest.mark.parametrize(..., indirect=True)."""
    door = DOORS[request.param](server, client)
    yield door
    door.close()


@pytest.fixture(scope="session")
def laser_session(client):
    """A session that has seen the room with a planar laser. Read only."""
    session = client.sessions.create(sensors=[world.LASER])
    with session.stream() as stream:
        for i, pose in enumerate(world.drive(30)):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    assert stream.summary.rejected == 0, stream.summary.rejections
    return session


@pytest.fixture(scope="session")
def lidar_session(client):
    """A session that has seen the room with a 3D lidar. Read only."""
    layers = {name: {"enabled": True} for name in ("voxels", "height", "surface")}
    # Its rings are 0.12 m apart on the walls.
    layers["surface"]["voxel_size_m"] = 0.1
    session = client.sessions.create(sensors=[world.LIDAR], params={"map": layers})
    with session.stream() as stream:
        for i, pose in enumerate(world.lidar_drive()):
            stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=world.cloud(pose))
    assert stream.summary.rejected == 0, stream.summary.rejections
    return session


@pytest.fixture(scope="session")
def seven_scenes():
    folder = recorded("rgbd-7scenes-a")
    if folder is None:
        pytest.skip("recorded data is not there")
    return folder

"""A depth camera that knows places by SIFT is carried off and found again, before and after a crash."""

from __future__ import annotations

import numpy as np
import pytest
from percept import CameraIntrinsics, Client, EncodedImage, Pose, SensorSpec

from support.world import OPTICAL

#: Keyframes closer than by default: the way is short.
SIFT = {"slam": {"odometry": {"keyframe": {"features": "sift", "angle_rad": 0.2}}}}
SIZE = {"width_px": 640, "height_px": 480}
#: Frames of the way, and those that see nothing.
WAY, BLIND = 100, 10
BLANK = np.zeros((480, 640), np.uint16), np.zeros((480, 640, 3), np.uint8)


class Recording:
    """Sends the first frames of 7-Scenes, again and again."""

    def __init__(self, folder):
        k = np.loadtxt(folder / "camera-intrinsics.txt")
        intrinsics = CameraIntrinsics(**SIZE, fx_px=k[0, 0], fy_px=k[1, 1], cx_px=k[0, 2], cy_px=k[1, 2])
        base = Pose(rotation=OPTICAL)
        self.sensor = SensorSpec(
            "camera", kind="rgbd", t_base_sensor=base, intrinsics=intrinsics, overload_policy="block"
        )
        self.paths = sorted(folder.glob("frame-*.depth.png"))[:WAY]
        self.sent = 0

    def _send(self, session, depth, colour):
        self.sent += 1
        stamp = self.sent * 66_666_667
        return session.send_rgbd("camera", stamp_ns=stamp, depth=depth, colour=colour, metres_per_unit=0.001).pose

    def way(self, session):
        """What is said at each frame of the way."""
        for path in self.paths:
            colour = path.with_name(path.name.replace("depth.png", "color.jpg"))
            yield self._send(session, *(EncodedImage(data=p.read_bytes(), **SIZE) for p in (path, colour)))

    def blind(self, session):
        for _ in range(BLIND):
            assert self._send(session, *BLANK).state != "tracking"


def found(recording, session, first):
    """Whether the camera, put down at the beginning, finds itself on the way, and nowhere but there."""
    recording.blind(session)
    placed = 0
    for pose, before in zip(recording.way(session), first, strict=True):
        if pose.state == "tracking":
            off = np.linalg.norm(pose.t_map_base.translation - before.t_map_base.translation)
            assert off < 0.05, f"said to be where it was not, {off:.2f} m off"
            placed += 1
    return placed > 0


@pytest.mark.timeout(600)
def test_a_depth_camera_knows_places_by_sift_and_still_does_after_a_crash(own_server, seven_scenes):
    recording = Recording(seven_scenes)
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[recording.sensor], params=SIFT)
        first = list(recording.way(session))
        assert {pose.state for pose in first[1:]} == {"tracking"}
        assert found(recording, session, first)
        loops = list(session.map.loops())
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.session("robot")
        assert session.info().params["slam"]["odometry"]["keyframe"]["features"] == "sift"
        assert len(list(session.map.loops())) == len(loops)
        assert found(recording, session, first)

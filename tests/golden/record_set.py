#!/usr/bin/env python3
"""Writes a recorded data set as a robot with ROS would have recorded it, so that both can be replayed and compared.

    pip install rosbags numpy
    tests/golden/record_set.py SET OUT [--storage mcap|sqlite3] [--frames N]

SET is a folder like 7-Scenes (colour as compressed images, depth as 16UC1), a KITTI folder with `velodyne/*.bin`, or a
CARMEN log (.clf; scans and odometry). OUT is the folder of the rosbag2. `percept replay SET --out a` and
`percept replay OUT --out b` should write the same trajectory, but for what the stamps of the log are worth.
"""

from __future__ import annotations

import argparse
import pathlib

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_NS = 1_700_000_000_000_000_000


def header(stamp_ns: int, frame: str) -> object:
    """Make a header."""
    time = T["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


class Recorder:
    """A rosbag2 on its way to disk."""

    def __init__(self, path: pathlib.Path, storage: str) -> None:
        """Begin it."""
        self.writer = Writer(path, version=8, storage_plugin=StoragePlugin[storage.upper()])
        self.writer.open()
        self.topics: dict[str, object] = {}

    def write(self, topic: str, stamp_ns: int, message: object) -> None:
        """Write a message at a time."""
        name = message.__msgtype__
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, name, typestore=STORE)
        self.writer.write(self.topics[topic], stamp_ns, STORE.serialize_cdr(message, name))


def seven_scenes(path: pathlib.Path, recorder: Recorder, num: int) -> None:
    """Write depth and colour of a folder like 7-Scenes."""
    words = (path / "camera-intrinsics.txt").read_text().split()
    k = np.array([float(w) for w in words[:9]])
    p = np.array([k[0], 0, k[2], 0, 0, k[4], k[5], 0, 0, 0, 1, 0])
    roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    for depth_path in sorted(path.glob("frame-*.depth.png"))[:num]:
        number = int(depth_path.name[6:12])
        stamp = START_NS + round(number * 1e9 / 30)
        head = header(stamp, "camera_optical_frame")
        info = T["sensor_msgs/msg/CameraInfo"](
            header=head,
            height=480,
            width=640,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=k,
            r=np.eye(3).ravel(),
            p=p,
            binning_x=0,
            binning_y=0,
            roi=roi,
        )
        packed = np.frombuffer(depth_path.read_bytes(), np.uint8)
        config = np.zeros(12, np.uint8)
        depth = T["sensor_msgs/msg/CompressedImage"](
            header=head, format="16UC1; compressedDepth png", data=np.concatenate([config, packed])
        )
        color_path = next(path.glob(f"frame-{number:06}.color.*"))
        color = T["sensor_msgs/msg/CompressedImage"](
            header=head, format=color_path.suffix[1:], data=np.frombuffer(color_path.read_bytes(), np.uint8)
        )
        recorder.write("/camera/depth/camera_info", stamp, info)
        recorder.write("/camera/color/camera_info", stamp, info)
        recorder.write("/camera/depth/image_raw/compressedDepth", stamp, depth)
        recorder.write("/camera/color/image_raw/compressed", stamp, color)


def kitti(path: pathlib.Path, recorder: Recorder, num: int) -> None:
    """Write scans with padding between the points, as drivers do."""
    field = T["sensor_msgs/msg/PointField"]
    fields = [
        field(name=n, offset=o, datatype=7, count=1) for n, o in [("x", 0), ("y", 4), ("z", 8), ("intensity", 16)]
    ]
    for i, scan_path in enumerate(sorted((path / "velodyne").glob("*.bin"))[:num]):
        points = np.fromfile(scan_path, np.float32).reshape(-1, 4)
        rows = np.zeros((len(points), 8), np.float32)
        rows[:, :3], rows[:, 4] = points[:, :3], points[:, 3]
        stamp = START_NS + i * 10**8
        cloud = T["sensor_msgs/msg/PointCloud2"](
            header=header(stamp, "velodyne"),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=32,
            row_step=32 * len(points),
            data=rows.view(np.uint8).ravel(),
            is_dense=True,
        )
        recorder.write("/velodyne_points", stamp, cloud)


def carmen(path: pathlib.Path, recorder: Recorder, num: int) -> None:
    """Write scans and odometry of a log."""
    t, scans, lines = T, 0, path.read_text().splitlines()
    readings = [line.split() for line in lines if line.startswith("FLASER ")]
    # What every beam without a return has.
    longest = max(float(w) for words in readings for w in words[2 : 2 + int(words[1])])
    for line in lines:
        words = line.split()
        if not words or words[0] not in {"FLASER", "ODOM"} or scans >= num:
            continue
        n = int(words[1]) if words[0] == "FLASER" else 0
        first = n + 5 if n else 1
        x, y, yaw = (float(w) for w in words[first : first + 3])
        stamp = round(float(words[first + 3 if n else first + 6]) * 1e9)
        turned = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
        pose = t["geometry_msgs/msg/Pose"](position=t["geometry_msgs/msg/Point"](x=x, y=y, z=0.0), orientation=turned)
        zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        twist = t["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
        odometry = t["nav_msgs/msg/Odometry"](
            header=header(stamp, "odom"),
            child_frame_id="base_link",
            pose=t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
        )
        recorder.write("/odom", stamp, odometry)
        if n:
            scans += 1
            ranges = np.array([float(w) for w in words[2 : 2 + n]], np.float32)
            scan = t["sensor_msgs/msg/LaserScan"](
                header=header(stamp, "base_link"),
                angle_min=-np.pi / 2,
                angle_max=np.pi / 2,
                angle_increment=np.pi / (n - n % 2),
                time_increment=0.0,
                scan_time=0.0,
                range_min=0.05,
                range_max=longest,
                ranges=np.where(ranges >= longest, np.inf, ranges).astype(np.float32),
                intensities=np.zeros(0, np.float32),
            )
            recorder.write("/scan", stamp, scan)


def main() -> None:
    """Write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--storage", choices=["mcap", "sqlite3"], default="mcap")
    parser.add_argument("--frames", type=int, default=10**9)
    args = parser.parse_args()
    recorder = Recorder(args.out, args.storage)
    if args.set.is_file():
        carmen(args.set, recorder, args.frames)
    elif (args.set / "velodyne").is_dir():
        kitti(args.set, recorder, args.frames)
    else:
        seven_scenes(args.set, recorder, args.frames)
    recorder.writer.close()


if __name__ == "__main__":
    main()

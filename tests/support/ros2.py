"""A robot on ROS 2 as its nodes and bridges appear on zenoh, made of eclipse-zenoh and rosbags: no code of percept."""

from __future__ import annotations

import itertools
import threading
import time
from typing import Any

import numpy as np
import zenoh
import zenoh.ext
from percept import Pose
from rosbags.typesys import Stores, get_typestore

from support.server import eventually, free_port

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
NO_HASH = "TypeHashNotSupported"


def _config(mode: str, *, connect: str = "", listen: str = "") -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": f'"{mode}"',
        "connect/endpoints": f'["{connect}"]' if connect else "[]",
        "listen/endpoints": f'["{listen}"]' if listen else "[]",
        "scouting/multicast/enabled": "false",
        "timestamping/enabled": "true",
    }.items():
        config.insert_json5(key, value)
    return config


class Router:
    """A zenoh router, as `rmw_zenohd` is one."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.start()

    def start(self) -> None:
        self._session = zenoh.open(_config("router", listen=self.endpoint))

    def close(self) -> None:
        self._session.close()

    def __enter__(self) -> Router:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def stamp(ns: int) -> Any:
    return T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str) -> Any:
    return T["std_msgs/msg/Header"](stamp=stamp(ns), frame_id=frame)


def point(xyz: np.ndarray, kind: str = "Point") -> Any:
    return T[f"geometry_msgs/msg/{kind}"](*(float(v) for v in xyz))


def quaternion(xyzw: np.ndarray) -> Any:
    return T["geometry_msgs/msg/Quaternion"](*(float(v) for v in xyzw))


def pose(of: Pose) -> Any:
    return T["geometry_msgs/msg/Pose"](position=point(of.translation), orientation=quaternion(of.rotation))


def transform(ns: int, parent: str, child: str, t_parent_child: Pose) -> Any:
    moved = T["geometry_msgs/msg/Transform"](
        translation=point(t_parent_child.translation, "Vector3"), rotation=quaternion(t_parent_child.rotation)
    )
    return T["geometry_msgs/msg/TransformStamped"](header=header(ns, parent), child_frame_id=child, transform=moved)


def transforms(*each: Any) -> Any:
    return T["tf2_msgs/msg/TFMessage"](transforms=list(each))


def scan(ns: int, frame: str, values: dict) -> Any:
    """A scan of what `send_scan` takes."""
    ranges = np.asarray(values["ranges_m"], np.float32)
    return T["sensor_msgs/msg/LaserScan"](
        header=header(ns, frame),
        angle_min=values["angle_min_rad"],
        angle_max=values["angle_min_rad"] + values["angle_increment_rad"] * (len(ranges) - 1),
        angle_increment=values["angle_increment_rad"],
        time_increment=0.0,
        scan_time=0.0,
        range_min=values["range_min_m"],
        range_max=values["range_max_m"],
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )


def odometry(ns: int, t_odom_base: Pose) -> Any:
    twist = T["geometry_msgs/msg/Twist"](linear=point(np.zeros(3), "Vector3"), angular=point(np.zeros(3), "Vector3"))
    return T["nav_msgs/msg/Odometry"](
        header=header(ns, "odom"),
        child_frame_id="base_link",
        pose=T["geometry_msgs/msg/PoseWithCovariance"](pose=pose(t_odom_base), covariance=np.zeros(36)),
        twist=T["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def pose_stamped(ns: int, frame: str, of: Pose) -> bytes:
    """Encoded, as a goal is published."""
    message = T["geometry_msgs/msg/PoseStamped"](header=header(ns, frame), pose=pose(of))
    return bytes(STORE.serialize_cdr(message, "geometry_msgs/msg/PoseStamped"))


def pose_estimate(frame: str, of: Pose) -> Any:
    """As RViz' "2D Pose Estimate" publishes it."""
    with_covariance = T["geometry_msgs/msg/PoseWithCovariance"](pose=pose(of), covariance=np.zeros(36))
    return T["geometry_msgs/msg/PoseWithCovarianceStamped"](header=header(0, frame), pose=with_covariance)


def image(ns: int, frame: str, pixels: np.ndarray, encoding: str) -> Any:
    return T["sensor_msgs/msg/Image"](
        header=header(ns, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=np.frombuffer(pixels.tobytes(), np.uint8),
    )


def camera_info(ns: int, frame: str, camera: Any) -> Any:
    k = np.array([camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1], float)
    roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return T["sensor_msgs/msg/CameraInfo"](
        header=header(ns, frame),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=np.insert(k.reshape(3, 3), 3, 0, axis=1).ravel(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def cloud(ns: int, frame: str, points: np.ndarray) -> Any:
    """A cloud whose points are padded to 32 bytes, as drivers do."""
    fields = [
        T["sensor_msgs/msg/PointField"](name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyz")
    ]
    data = np.zeros((len(points), 8), np.float32)
    data[:, :3] = points
    return T["sensor_msgs/msg/PointCloud2"](
        header=header(ns, frame),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=32,
        row_step=32 * len(points),
        data=np.frombuffer(data.tobytes(), np.uint8),
        is_dense=True,
    )


class Heard:
    """What came on a topic, decoded."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.messages: list[Any] = []
        self.attachments: list[bytes] = []
        self._lock = threading.Lock()

    def __call__(self, sample: zenoh.Sample) -> None:
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), self.kind)
        with self._lock:
            self.messages.append(message)
            self.attachments.append(sample.attachment.to_bytes() if sample.attachment else b"")

    def newest(self, *, seconds: float = 30.0) -> Any:
        assert eventually(lambda: self.messages, seconds=seconds), f"no {self.kind} came"
        return self.messages[-1]


class Robot:
    """A robot's nodes: publishers with keys, tokens and attachments, and subscriptions.

    `dds`: behind the bridge of zenoh and DDS. `labels`: attachments as before jazzy 0.2.4. `humble`: types have no
    hashes.
    """

    def __init__(
        self, endpoint: str, *, dds: bool = False, labels: bool = False, humble: bool = False, listens: bool = False
    ) -> None:
        # The robot's own nodes are peers of their router.
        self._zenoh = zenoh.open(_config("router" if listens else "peer", connect=endpoint))
        self._dds, self._labels, self._humble = dds, labels, humble
        self._ids = itertools.count(1)
        self._publishers: dict[str, tuple] = {}
        self._declared: list = []
        self.zid = str(self._zenoh.zid())
        if not dds:
            self._token(f"@ros2_lv/0/{self.zid}/0/0/NN/%/%/robot")

    def close(self) -> None:
        self._zenoh.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _token(self, key: str) -> None:
        self._declared.append(self._zenoh.liveliness().declare_token(key))

    def _hash(self, kind: str) -> str:
        return NO_HASH if self._humble else STORE.hash_rihs01(kind)

    @staticmethod
    def _dds_name(kind: str) -> str:
        package, _, name = kind.split("/")
        return f"{package}::msg::dds_::{name}_"

    def publish(self, topic: str, message: Any, *, latched: bool = False) -> None:
        """Publishes a message; declares the publisher first."""
        kind = message.__msgtype__
        self.publish_raw(topic, kind, bytes(STORE.serialize_cdr(message, kind)), latched=latched)

    def publish_raw(self, topic: str, kind: str, payload: bytes, *, latched: bool = False) -> None:
        """Publishes any bytes."""
        if topic not in self._publishers:
            self._publishers[topic] = (*self._declare(topic, kind, latched=latched), itertools.count(1))
        publisher, gid, numbers = self._publishers[topic]
        publisher.put(payload, attachment=None if self._dds else self._attachment(next(numbers), gid))

    def _declare(self, topic: str, kind: str, *, latched: bool) -> tuple:
        bare, number = topic.strip("/"), next(self._ids)
        if self._dds:
            key = bare
            qos = f":1:{1 if latched else 0}:0,{1 if latched else 10}"
            name, route = kind.replace("/", "§"), bare.replace("/", "§")
            token = f"@/{self.zid}/@ros2_lv/MP/{route}/{name}/{qos}"
        else:
            key = f"0/{bare}/{self._dds_name(kind)}/{self._hash(kind)}"
            qos = f":{1 if latched else ''}:,{1 if latched else 10}:,:,:,,"
            mangled = "%" + bare.replace("/", "%")
            entity = f"@ros2_lv/0/{self.zid}/0/{number}/MP/%/%/robot"
            token = f"{entity}/{mangled}/{self._dds_name(kind)}/{self._hash(kind)}/{qos}"
        if latched:
            publisher = zenoh.ext.declare_advanced_publisher(
                self._zenoh, key, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
            )
        else:
            publisher = self._zenoh.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        self._token(token)
        return publisher, number.to_bytes(16, "little")

    def _attachment(self, number: int, gid: bytes) -> bytes:
        values = {
            b"sequence_number": number.to_bytes(8, "little"),
            b"source_timestamp": time.time_ns().to_bytes(8, "little"),
            b"source_gid": b"\x10" + gid,
        }
        if self._labels:
            return b"".join(bytes([len(label)]) + label + value for label, value in values.items())
        return b"".join(values.values())

    def subscribe(self, topic: str, kind: str, *, latched: bool = False) -> Heard:
        """Listens as a node does: by the exact hash."""
        bare = topic.strip("/")
        key = bare if self._dds else f"0/{bare}/{self._dds_name(kind)}/{self._hash(kind)}"
        heard = Heard(kind)
        if latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            self._declared.append(zenoh.ext.declare_advanced_subscriber(self._zenoh, key, heard, history=history))
        else:
            self._declared.append(self._zenoh.declare_subscriber(key, heard))
        return heard

    def tokens(self) -> list[str]:
        """All tokens of the network."""
        pattern = "@/*/@ros2_lv/**" if self._dds else "@ros2_lv/0/**"
        replies = self._zenoh.liveliness().get(pattern, timeout=2.0)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

#!/usr/bin/env python3
"""Writes what server/bags is tested against: small recordings as other implementations write them.

    pip install rosbags mcap lz4 zstandard
    tests/golden/bags.py [FOLDER]        # default: server/bags/tests/golden

Each has twelve std_msgs/Header on /a, and as many on /b, logged 10 ns apart in turn, with the number as their frame.
"""

from __future__ import annotations

import pathlib
import sys
import tempfile

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

ROOT = pathlib.Path(__file__).resolve().parents[2]
HEADER = "std_msgs/msg/Header"
START = 1_763_692_800_000_000_000


def messages(store: object, *, ros1: bool) -> list[tuple[str, int, bytes]]:
    """Make the messages: topic, log time, bytes."""
    made = []
    for i in range(24):
        fields = {"stamp": store.types["builtin_interfaces/msg/Time"](sec=i, nanosec=0), "frame_id": str(i)}
        header = store.types[HEADER](**({"seq": i} | fields if ros1 else fields))
        serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        made.append(("/a" if i % 2 == 0 else "/b", START + i * 10, bytes(serialize(header, HEADER))))
    return made


def write_mcap(path: pathlib.Path, compression: CompressionType, *, chunked: bool = True) -> None:
    """Write by Foxglove's own library."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, chunk_size=200, use_chunking=chunked)
        writer.start(profile="ros2")
        text, _ = store.generate_msgdef(HEADER, ros_version=2)
        schema = writer.register_schema(HEADER, "ros2msg", text.encode())
        channels = {name: writer.register_channel(name, "cdr", schema) for name in ("/a", "/b")}
        for topic, time, data in messages(store, ros1=False):
            writer.add_message(channels[topic], time, data, time)
        writer.finish()


def write_ros1(path: pathlib.Path, compression: Ros1Writer.CompressionFormat | None) -> None:
    """Write a bag of ROS 1 by rosbags."""
    store = get_typestore(Stores.ROS1_NOETIC)
    path.unlink(missing_ok=True)
    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {name: writer.add_connection(name, HEADER, typestore=store) for name in ("/a", "/b")}
        for topic, time, data in messages(store, ros1=True):
            writer.write(connections[topic], time, data)


def write_packed(path: pathlib.Path, storage: StoragePlugin) -> None:
    """Write one of rosbag2's storages, each message packed by zstd, by rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory() as folder:
        recording = pathlib.Path(folder) / "recording"
        writer = Ros2Writer(recording, version=9, storage_plugin=storage)
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {name: writer.add_connection(name, HEADER, typestore=store) for name in ("/a", "/b")}
            for topic, time, data in messages(store, ros1=False):
                writer.write(connections[topic], time, data)
        path.write_bytes(next(recording.glob(f"*{path.suffix}*")).read_bytes())


def main() -> None:
    """Write the files."""
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "server/bags/tests/golden"
    folder.mkdir(parents=True, exist_ok=True)
    write_mcap(folder / "zstd.mcap", CompressionType.ZSTD)
    write_mcap(folder / "lz4.mcap", CompressionType.LZ4)
    write_mcap(folder / "none.mcap", CompressionType.NONE)
    write_mcap(folder / "unchunked.mcap", CompressionType.NONE, chunked=False)
    write_packed(folder / "zstd_messages.db3", StoragePlugin.SQLITE3)
    write_packed(folder / "zstd_messages.mcap", StoragePlugin.MCAP)
    write_ros1(folder / "none.bag", None)
    write_ros1(folder / "bz2.bag", Ros1Writer.CompressionFormat.BZ2)
    write_ros1(folder / "lz4.bag", Ros1Writer.CompressionFormat.LZ4)


if __name__ == "__main__":
    main()

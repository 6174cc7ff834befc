"""Robots of the closed-form room: what they see, rendered once, and the sessions that they fill."""

from __future__ import annotations

import functools
import math

from percept import Client, Pose, Session
from percept.v1 import sensor_pb2

from . import world

#: Sweeps, three places apart, of a map that takes far longer to build again than a call that answers at once.
HEAVY_SWEEPS, HEAVY_STRIDE = 150, 3


@functools.cache
def laps() -> tuple[Pose, ...]:
    """A round through the room in steps of 4 cm and 2 degrees, so that no frame of a lap is like another."""
    out, fine = [], world.circle()
    for a, b in zip(fine, [*fine[1:], fine[0]], strict=True):
        for k in range(4):
            share = k / 4
            x, y = ((1 - share) * a.translation + share * b.translation)[:2]
            out.append(Pose.from_xy_yaw(float(x), float(y), a.yaw_rad + share * math.radians(8.0)))
    return tuple(out)


@functools.cache
def scan(index: int, phase: int = 0) -> dict[str, object]:
    """What the laser sees at a place of the round; robots of other phases see other things."""
    return world.scan(laps()[(index + phase) % len(laps())])


def scan_message(session_id: str, index: int) -> sensor_pb2.SensorMessage:
    """The scan of that place as the contract has it."""
    seen = scan(index)
    body = {**seen, "ranges_m": seen["ranges_m"].tobytes()}
    return sensor_pb2.SensorMessage(
        session_id=session_id, sensor_id="laser", stamp_ns=world.stamp(index), scan=sensor_pb2.LaserScan(**body)
    )


@functools.cache
def sweep(index: int, phase: int = 0):
    """What the 3D lidar sees there."""
    return world.cloud(laps()[(index + phase) % len(laps())])


def send_scans(session: Session, first: int, last: int, *, phase: int = 0) -> int:
    """Streams scans; returns how many are durable, all of them unless it raises."""
    with session.stream() as stream:
        for i in range(first, last):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **scan(i, phase))
    assert stream.summary.rejected == 0, stream.summary.rejections
    return stream.summary.durable


def send_sweeps(session: Session, first: int, last: int, *, phase: int = 0, stride: int = 1) -> int:
    """Streams clouds of the 3D lidar, which leave large scans and a map that takes a while to build again."""
    with session.stream() as stream:
        for i in range(first, last):
            stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=sweep(stride * i, phase))
    assert stream.summary.rejected == 0, stream.summary.rejections
    return stream.summary.durable


def mapped(client: Client, session_id: str, *, frames: int = 10, phase: int = 0) -> Session:
    """A session that has seen the room by laser."""
    session = client.sessions.create(session_id, sensors=[world.LASER])
    assert send_scans(session, 0, frames, phase=phase) == frames
    assert session.info().num_keyframes > 0
    return session

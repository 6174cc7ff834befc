"""Maps a recording, and finds a robot in that map again.

    python examples/map_and_find.py [LOG]

LOG is a CARMEN log of a planar lidar (FLASER lines), as the Intel Research Lab's; without one the scans are of
a room that is computed.
"""

from __future__ import annotations

import pathlib
import sys
import uuid

import numpy as np
from percept import Client, Pose, SensorSpec

import room


def carmen(path, most):
    """Scans of a CARMEN log, as send_scan takes them: FLASER n ranges x y yaw odom_x odom_y odom_yaw time."""
    for line in pathlib.Path(path).read_text(encoding="ascii").splitlines():
        if line.startswith("FLASER") and most > 0:
            words = line.split()
            count = int(words[1])
            ranges = np.array(words[2 : 2 + count], np.float32)
            turn = np.pi / count
            yield {
                # What is farther than the sensor sees hit nothing.
                "ranges_m": np.where(ranges < 50, ranges, np.inf).astype(np.float32),
                "angle_min_rad": -np.pi / 2 + turn / 2,
                "angle_increment_rad": turn,
                "range_min_m": 0.05,
                "range_max_m": 50.0,
            }
            most -= 1


def send(session, scans):
    """Streams scans; the poses that came of them."""
    with session.stream() as stream:
        for i, scan in enumerate(scans):
            stream.send_scan("laser", stamp_ns=room.stamp(i), **scan)
        acks = list(stream.acks())
    assert stream.summary.rejected == 0, stream.summary.rejections
    return [ack.result.pose for ack in acks]


def main():
    if len(sys.argv) > 1:
        # It is found again on a stretch from the middle of the recording.
        scans = list(carmen(sys.argv[1], 2000))
        mapped, later = scans, scans[1000:1300]
        laser = SensorSpec("laser", kind="lidar2d", t_base_sensor=Pose.from_xyz(0.0, 0.0, 0.3))
    else:
        mapped = [room.scan(pose) for pose in room.lap()]
        later = mapped[30:]
        laser = room.LASER
    with Client(room.SERVER) as client:
        name = uuid.uuid4().hex[:8]
        fine = {"map": {"occupancy": {"resolution_m": 0.05}}}
        first = client.sessions.create(f"mapped-{name}", sensors=[laser], params=fine)
        send(first, mapped)
        trajectory, summary = first.trajectory(), first.map.summary()
        print(f"mapped {trajectory.length_m:.1f} m of way in {summary.num_keyframes} keyframes")

        # Another robot gets the map, and wakes up somewhere in it.
        second = client.sessions.create(f"found-{name}", sensors=[laser], params=fine)
        imported = second.map.import_map(first.map.occupancy())
        print(f"imported as {imported.num_keyframes} views, {imported.occupied_share:.0%} of what is occupied")
        found = send(second, later)
        at = next((i for i, pose in enumerate(found) if pose.state == "tracking"), None)
        if at is None:
            print("not found:", found[-1].lost_message or found[-1].waiting_message)
            return
        offset = 1000 if len(sys.argv) > 1 else 30
        there = trajectory.positions[offset + at]
        error = np.linalg.norm(found[at].t_map_base.translation[:2] - there[:2])
        print(f"found by scan {at + 1} of {len(later)}, {error:.2f} m from where the first robot had been")
        lost = sum(pose.lost for pose in found[at:])
        print(f"then {len(found) - at - lost} of {len(found) - at} scans tracked")


if __name__ == "__main__":
    main()

"""Watches what becomes of things while a robot drives rounds, and somebody brings a crate.

python examples/watch_things.py
"""

from __future__ import annotations

from percept import Client

import room


def main():
    lap = room.lap()
    without = [box for box in room.FURNITURE if box is not room.CRATE]
    seen = [(pose, boxes) for boxes in (without, room.FURNITURE) for pose in lap]
    with Client(room.SERVER) as client:
        session = client.sessions.create(sensors=[room.LIDAR])
        with session.watch(kinds=["object", "pose"]) as events:
            with session.stream() as stream:
                for i, (pose, boxes) in enumerate(seen):
                    stream.send_cloud("lidar", stamp_ns=room.stamp(i), points=room.sweep(pose, boxes))
            for event in events:
                change = event.event
                seconds = (event.stamp_ns - room.stamp(0)) / 1e9
                if hasattr(change, "object_id"):
                    name = change.object.label if change.object else "thing"
                    if change.kind != "updated":
                        print(f"{seconds:4.1f} s: {name} {change.object_id} {change.kind}")
                # The pose of the last frame: nothing more will come.
                elif event.stamp_ns >= room.stamp(len(seen) - 1):
                    break
        print("the crate came at", f"{(room.stamp(len(lap)) - room.stamp(0)) / 1e9:.1f} s")
        print("there:", ", ".join(f"{thing.label} {thing.object_id}" for thing in session.scene.objects()))


if __name__ == "__main__":
    main()

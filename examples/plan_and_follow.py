"""Plans a path, and follows it step by step: each scan in gives pose, obstacles and the rest of the path.

python examples/plan_and_follow.py
"""

from __future__ import annotations

import numpy as np
from percept import Client, Pose, ScanFrame

import room

STEP_M, TURN_RAD = 0.05, 0.1
GOAL = (2.8, -0.2)  # x, y in metres of the map, which begins where the robot begins


def ahead(pose, path):
    """One step along a path: the robot turns towards where it leads, and drives once it looks there."""
    way = np.vstack([pose.translation[:2], path.waypoints[1:]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    x, y = (float(np.interp(STEP_M, along, way[:, axis])) for axis in (0, 1))
    here_x, here_y = pose.translation[:2].tolist()
    turn = np.angle(np.exp(1j * (np.arctan2(y - here_y, x - here_x) - pose.yaw_rad)))
    yaw = pose.yaw_rad + float(np.clip(turn, -TURN_RAD, TURN_RAD))
    return Pose.from_xy_yaw(x, y, yaw) if abs(turn) < TURN_RAD else Pose.from_xy_yaw(here_x, here_y, yaw)


def main():
    with Client(room.SERVER) as client:
        session = client.sessions.create(sensors=[room.LASER])
        # A look around first: what was not seen cannot be planned through.
        poses = room.drive(30)
        for i, pose in enumerate(poses):
            session.send_scan("laser", stamp_ns=room.stamp(i), **room.scan(pose))
        path = session.plan(GOAL)
        if not path:
            print("no path:", path.reason, path.detail)
            return
        print(f"a path of {path.length_m:.2f} m, {path.min_clearance_m:.2f} m from the nearest obstacle")

        # The world's own truth moves the robot; what it knows of itself comes from percept alone.
        t_world_map, true = poses[0], poses[-1]
        for i in range(len(poses), len(poses) + 200):
            known = session.pose().t_map_base
            true = true @ known.inverse() @ ahead(known, path)
            frame = ScanFrame("laser", stamp_ns=room.stamp(i), **room.scan(true))
            step = session.navigate(frame, goal=GOAL)
            path = step.outcome
            if not path or path.length_m < STEP_M:
                break
        if not path:
            print("the path ended:", path.reason, path.detail)
        error = np.linalg.norm((t_world_map.inverse() @ true).translation[:2] - GOAL)
        print(f"after {i - len(poses) + 1} steps the robot stands {error:.2f} m from the goal")


if __name__ == "__main__":
    main()

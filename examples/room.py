"""A furnished room whose scans are computed, so that the examples need no robot. Metres, z up, floor at 0."""

from __future__ import annotations

import os

import numpy as np
from percept import Pose, SensorSpec

#: Where the server is.
SERVER = os.environ.get("PERCEPT_SERVER", "127.0.0.1:50051")

WALLS = (np.array([-3.0, -2.0, 0.0]), np.array([3.0, 2.0, 2.5]))
#: Opposite corners of the boxes that stand in it.
TABLE = (np.array([1.2, 0.6, 0.0]), np.array([2.0, 1.4, 0.75]))
SHELF = (np.array([2.0, -1.6, 0.0]), np.array([2.5, -0.7, 1.6]))
CRATE = (np.array([-2.4, -1.5, 0.0]), np.array([-1.6, -1.0, 0.5]))
CHAIR = (np.array([0.6, -1.7, 0.0]), np.array([1.0, -1.2, 1.0]))
FURNITURE = [TABLE, SHELF, CRATE, CHAIR]

LIDAR = SensorSpec("lidar", kind="lidar3d", t_base_sensor=Pose.from_xyz(0.0, 0.0, 1.2))
LASER = SensorSpec("laser", kind="lidar2d", t_base_sensor=Pose.from_xyz(0.0, 0.0, 0.3))


def cast(origin, directions, furniture=FURNITURE):
    """Distances along (..., 3) unit directions from inside the room to what is hit, metres."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = ((bound - origin) / directions for bound in WALLS)
        hit = np.fmax(to_low, to_high).min(-1)
        for low, high in furniture:
            a, b = (low - origin) / directions, (high - origin) / directions
            near, far = np.fmin(a, b).max(-1), np.fmax(a, b).min(-1)
            hit = np.where((near < far) & (near > 0) & (near < hit), near, hit)
    return hit


def sweep(t_world_base, furniture=FURNITURE, rings=24, columns=720):
    """(N, 3) float32 points of a spinning lidar, sensor frame."""
    t_world_lidar = t_world_base @ LIDAR.t_base_sensor
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, columns, endpoint=False), np.linspace(-0.6, 0.35, rings)
    )
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    hit = cast(t_world_lidar.translation, rays @ t_world_lidar.matrix[:3, :3].T, furniture)
    return (rays * hit[..., None]).reshape(-1, 3).astype(np.float32)


def scan(t_world_base, beams=360):
    """What send_scan takes of a planar lidar, all around."""
    t_world_laser = t_world_base @ LASER.t_base_sensor
    angles = -np.pi + np.arange(beams) * 2 * np.pi / beams
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(beams)], axis=-1)
    ranges = cast(t_world_laser.translation, rays @ t_world_laser.matrix[:3, :3].T)
    return {
        "ranges_m": ranges.astype(np.float32),
        "angle_min_rad": -np.pi,
        "angle_increment_rad": 2 * np.pi / beams,
        "range_min_m": 0.05,
        "range_max_m": 20.0,
    }


def drive(steps):
    """World poses of a robot on an arc from the middle of the room, 2 cm and 1 degree a step. Its map begins at
    the first of them."""
    poses, x, y, yaw = [], -0.8, 0.0, 0.0
    for _ in range(steps):
        poses.append(Pose.from_xy_yaw(x, y, yaw))
        x, y, yaw = x + 0.02 * np.cos(yaw), y + 0.02 * np.sin(yaw), yaw + np.radians(1.0)
    return poses


def lap(steps=90):
    """World poses of a round through the room, 1.15 m from its middle."""
    poses, x, y, yaw, turn = [], -0.8, -1.1, 0.0, 2 * np.pi / steps
    for _ in range(steps):
        poses.append(Pose.from_xy_yaw(x, y, yaw))
        yaw += turn / 2
        x, y = x + 7.2 / steps * np.cos(yaw), y + 7.2 / steps * np.sin(yaw)
        yaw += turn / 2
    return poses


def stamp(index):
    """Nanoseconds of a frame, at 15 Hz."""
    return 1_000_000_000 + index * 66_666_667

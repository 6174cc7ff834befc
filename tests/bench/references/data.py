"""Recorded data, read without the server: by numpy, OpenCV and Open3D."""

from __future__ import annotations

import functools

import numpy as np

from support.server import recorded


class Absent(Exception):
    """A folder of recorded data is not there."""


def folder(name):
    path = recorded(name)
    if path is None:
        raise Absent(name)
    return path


@functools.cache
def pcd(path):
    """Finite points of a PCD or PLY, (N, 3) float32, by Open3D."""
    import open3d as o3d

    points = o3d.t.io.read_point_cloud(str(path)).point.positions.numpy().astype(np.float32)
    return np.ascontiguousarray(points[np.isfinite(points).all(1)])


@functools.cache
def depth(index=0):
    """A frame of Redwood, (480, 640) uint16 millimetres."""
    import cv2

    return cv2.imread(str(folder("rgbd-open3d-redwood") / f"depth/{index:05}.png"), cv2.IMREAD_UNCHANGED)


@functools.cache
def color(index=0):
    """A frame of Redwood, (480, 640, 3) uint8 RGB."""
    import cv2

    path = folder("rgbd-open3d-redwood") / f"color/{index:05}.jpg"
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])


@functools.cache
def indoor():
    """The depth image as points, (274 k, 3) float32, optical frame."""
    z = depth() / 1000.0
    v, u = np.nonzero(z)
    z = z[v, u]
    return np.stack([(u - 319.5) * z / 525, (v - 239.5) * z / 525, z], 1).astype(np.float32)


def table():
    """A table with a mug, from stereo."""
    return pcd(folder("cloud-pcl") / "table_scene_mug_stereo_textured.pcd")


@functools.cache
def kitti(number=0):
    """A lidar scan, (N, 4) float32: x, y, z, intensity."""
    path = folder("lidar-kitti-odometry-00") / f"velodyne/{number:06}.bin"
    return np.fromfile(path, np.float32).reshape(-1, 4)


@functools.cache
def lidar_pair():
    """Source, target, t_target_source."""
    root = folder("registration-small-gicp")
    truth = np.loadtxt(root / "T_target_source.txt")
    return pcd(root / "source.ply"), pcd(root / "target.ply"), truth


@functools.cache
def kitti_pair():
    """Scans 95 and 94 (the first ones' poses are unsound), and t_94_95 in the frame of the lidar."""
    root = folder("lidar-kitti-odometry-00")
    rows = np.loadtxt(root / "poses_00.txt")

    def square(row):
        return np.vstack([row.reshape(3, 4), [0, 0, 0, 1]])

    text = (root / "calib_Tr.txt").read_text().split()
    t_cam_lidar = square(np.array([float(x) for x in text if x[0] in "-.0123456789"][-12:]))
    a, b = (square(rows[i]) @ t_cam_lidar for i in (94, 95))
    source, target = (np.ascontiguousarray(kitti(i)[:, :3]) for i in (95, 94))
    return source, target, np.linalg.inv(a) @ b


def clouds():
    """Names and clouds of an indoor frame, a table and a street."""
    _, target, _ = lidar_pair()
    return {"redwood": indoor(), "table": table(), "lidar": target}

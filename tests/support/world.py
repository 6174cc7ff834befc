"""A furnished room whose depth images and scans are known in closed form.

The room is a box, furniture are boxes on its floor. World coordinates: metres, z up, floor at 0. Maps
begin where the robot begins, so that `truth_in_map` turns world poses into what a map should say.
"""

from __future__ import annotations

import numpy as np
from percept import CameraIntrinsics, Pose, SensorSpec

ROOM = (np.array([-3.0, -2.0, 0.0]), np.array([3.0, 2.0, 2.5]))
FURNITURE = [
    (np.array([1.2, 0.6, 0.0]), np.array([2.0, 1.4, 0.75])),
    (np.array([2.0, -1.6, 0.0]), np.array([2.5, -0.7, 1.6])),
    (np.array([-2.4, -1.5, 0.0]), np.array([-1.6, -1.0, 0.5])),
    (np.array([0.6, -1.7, 0.0]), np.array([1.0, -1.2, 1.0])),
]
CAMERA_HEIGHT_M = 1.2
LASER_HEIGHT_M = 0.3
#: Optical to body: z forward becomes x forward (REP-103).
OPTICAL = np.array([-0.5, 0.5, -0.5, 0.5])
FRAME_NS = 66_666_667

INTRINSICS = CameraIntrinsics(width_px=320, height_px=240, fx_px=290.0, fy_px=290.0, cx_px=159.5, cy_px=119.5)
CAMERA = SensorSpec(
    "camera",
    kind="depth",
    t_base_sensor=Pose(translation=np.array([0.0, 0.0, CAMERA_HEIGHT_M]), rotation=OPTICAL),
    intrinsics=INTRINSICS,
    overload_policy="block",
)
#: The same without depth.
EYE = SensorSpec(
    "eye",
    kind="camera",
    t_base_sensor=CAMERA.t_base_sensor,
    intrinsics=INTRINSICS,
    overload_policy="block",
)
WHEELS = SensorSpec("wheels", kind="odometry", overload_policy="block")
LASER = SensorSpec(
    "laser",
    kind="lidar2d",
    t_base_sensor=Pose.from_xyz(0.0, 0.0, LASER_HEIGHT_M),
    overload_policy="block",
)
LIDAR = SensorSpec(
    "lidar",
    kind="lidar3d",
    t_base_sensor=Pose.from_xyz(0.0, 0.0, CAMERA_HEIGHT_M),
    overload_policy="block",
)


#: What may be taken away: what a camera sees from across the room, and what a lidar sees.
CHEST, CRATE = 0, 2


def cast(origin: np.ndarray, directions: np.ndarray, furniture: list = FURNITURE) -> np.ndarray:
    """Distances along (..., 3) directions, in units of their lengths, from inside the room to what is hit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = ((bound - origin) / directions for bound in ROOM)
        hit = np.fmax(to_low, to_high).min(-1)
        for low, high in furniture:
            a, b = (low - origin) / directions, (high - origin) / directions
            near, far = np.fmin(a, b).max(-1), np.fmax(a, b).min(-1)
            hit = np.where((near < far) & (near > 0) & (near < hit), near, hit)
    return hit


def depth_image(t_world_base: Pose, camera: CameraIntrinsics = INTRINSICS, furniture: list = FURNITURE) -> np.ndarray:
    """(H, W) uint16 millimetres along the optical axis."""
    t_world_camera = t_world_base.matrix @ CAMERA.t_base_sensor.matrix
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones(u.shape)], axis=-1)
    z = cast(t_world_camera[:3, 3], rays @ t_world_camera[:3, :3].T, furniture)
    return np.round(z * 1000).astype(np.uint16)


def colour_image(t_world_base: Pose, camera: CameraIntrinsics = INTRINSICS) -> np.ndarray:
    """(H, W) uint8: walls and furniture of grey blocks, each of its own shade; 2 x 2 rays a pixel."""
    t_world_camera = t_world_base.matrix @ CAMERA.t_base_sensor.matrix
    u, v = np.meshgrid(np.arange(2 * camera.width_px) / 2 - 0.25, np.arange(2 * camera.height_px) / 2 - 0.25)
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones(u.shape)], axis=-1)
    rays = rays @ t_world_camera[:3, :3].T
    points = t_world_camera[:3, 3] + rays * cast(t_world_camera[:3, 3], rays)[..., None]
    shade = (_shade(points, 0.15) + _shade(points, 0.04)) / 2
    return shade.reshape(camera.height_px, 2, camera.width_px, 2).mean((1, 3)).astype(np.uint8)


def _shade(points: np.ndarray, block_m: float) -> np.ndarray:
    """Grey of the block that a point lies in, 40 to 167."""
    # Off the surfaces' own coordinates, which would else lie on the border of two blocks.
    block = np.floor((points + 0.013) / block_m).astype(np.int64)
    mixed = (block * np.array([7_919, 104_729, 1_299_709])).sum(-1) * 2_654_435_761
    return 40 + ((mixed >> 9) & 0x7F)


def scan(t_world_base: Pose, beams: int = 360, mount: Pose = LASER.t_base_sensor) -> dict[str, object]:
    """What `send_scan` takes, all around from -pi."""
    t_world_laser = t_world_base.matrix @ mount.matrix
    angles = -np.pi + np.arange(beams) * 2 * np.pi / beams
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(beams)], axis=-1)
    ranges = cast(t_world_laser[:3, 3], rays @ t_world_laser[:3, :3].T)
    return {
        "ranges_m": ranges.astype(np.float32),
        "angle_min_rad": -np.pi,
        "angle_increment_rad": 2 * np.pi / beams,
        "range_min_m": 0.05,
        "range_max_m": 20.0,
    }


def cloud(t_world_base: Pose, rings: int = 24, columns: int = 720, furniture: list = FURNITURE) -> np.ndarray:
    """(N, 3) float32 of a spinning lidar, sensor frame."""
    t_world_lidar = t_world_base.matrix @ LIDAR.t_base_sensor.matrix
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, columns, endpoint=False), np.linspace(-0.6, 0.35, rings)
    )
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    hit = cast(t_world_lidar[:3, 3], rays @ t_world_lidar[:3, :3].T, furniture)
    return (rays * hit[..., None]).reshape(-1, 3).astype(np.float32)


def drive(steps: int) -> list[Pose]:
    """World poses of a robot on a gentle arc from the middle of the room: 2 cm and 1 degree a step."""
    poses, x, y, yaw = [], -0.8, 0.0, 0.0
    for _ in range(steps):
        poses.append(Pose.from_xy_yaw(x, y, yaw))
        x, y = x + 0.02 * np.cos(yaw), y + 0.02 * np.sin(yaw)
        yaw += np.radians(1.0)
    return poses


#: Steps of `circle` that close it.
ROUND = 45


def circle(num_steps: int = ROUND) -> list[Pose]:
    """World poses of one round within the room, 1.15 m from its middle: 16 cm and 8 degrees a step if there are 45."""
    poses, x, y, yaw = [], -0.8, -1.1, 0.0
    for _ in range(num_steps):
        poses.append(Pose.from_xy_yaw(x, y, yaw))
        yaw += np.pi / num_steps
        x, y = x + 7.2 / num_steps * np.cos(yaw), y + 7.2 / num_steps * np.sin(yaw)
        yaw += np.pi / num_steps
    return poses


def lidar_drive() -> list[Pose]:
    """The drive of the session with a 3D lidar: long enough to see all furniture in several keyframes."""
    return drive(3 * (LIDAR_LAST + 1))[::3]


#: Number of the last frame of `lidar_drive`.
LIDAR_LAST = 29


def truth_in_map(poses: list[Pose]) -> list[np.ndarray]:
    """t_map_base of world poses: the map begins at the first."""
    start = np.linalg.inv(poses[0].matrix)
    return [start @ pose.matrix for pose in poses]


def to_map(x_m: float, y_m: float) -> tuple[float, float]:
    """A point of the world as the map of `drive` has it."""
    first = drive(1)[0].translation
    return x_m - float(first[0]), y_m - float(first[1])


def stamp(index: int) -> int:
    """Nanoseconds of a frame."""
    return 1_000_000_000 + index * FRAME_NS


def position_error_m(estimate: Pose, truth: np.ndarray) -> float:
    """Distance between two positions."""
    return float(np.linalg.norm(estimate.translation - truth[:3, 3]))

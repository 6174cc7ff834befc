"""The ways to hand over a frame, said once: sessions, streams and zenoh publishers all send like this."""

from __future__ import annotations

import abc
from typing import Generic, TypeVar

import numpy as np

from ._arrays import Array
from .types.cloud import PointCloud
from .types.frames import (
    CameraFrame,
    CloudFrame,
    DepthFrame,
    EncodedImage,
    ImuFrame,
    OdometryFrame,
    RgbdFrame,
    ScanFrame,
    SensorFrame,
)
from .types.geometry import Pose

R = TypeVar("R")


class FrameSender(abc.ABC, Generic[R]):
    """Sends frames; `send` says what comes back. Stamps are nanoseconds by the sensor's clock."""

    @abc.abstractmethod
    def send(self, frame: SensorFrame) -> R:
        """Sends a frame of any kind."""

    def send_depth(
        self,
        sensor_id: str,
        *,
        stamp_ns: int,
        depth: Array | EncodedImage,
        metres_per_unit: float | None = None,
    ) -> R:
        """Sends depth: (H, W) uint16 with metres_per_unit, float32 metres, or a 16-bit PNG with its scale."""
        return self.send(
            DepthFrame(sensor_id, stamp_ns=stamp_ns, depth=depth, metres_per_unit=metres_per_unit)
        )

    def send_rgbd(
        self,
        sensor_id: str,
        *,
        stamp_ns: int,
        depth: Array | EncodedImage,
        colour: Array | EncodedImage,
        metres_per_unit: float | None = None,
    ) -> R:
        """Sends depth with its colour image: (H, W, 3) uint8 RGB, PNG or JPEG."""
        return self.send(
            RgbdFrame(
                sensor_id, stamp_ns=stamp_ns, depth=depth, colour=colour, metres_per_unit=metres_per_unit
            )
        )

    def send_colour(self, sensor_id: str, *, stamp_ns: int, colour: Array | EncodedImage) -> R:
        """Sends a camera's image: (H, W, 3) uint8 RGB, (H, W) uint8 grey, PNG or JPEG."""
        return self.send(CameraFrame(sensor_id, stamp_ns=stamp_ns, colour=colour))

    def send_cloud(
        self,
        sensor_id: str,
        *,
        stamp_ns: int,
        points: Array,
        colours: Array | None = None,
        intensities: Array | None = None,
        time_offsets_s: Array | None = None,
    ) -> R:
        """Sends a cloud in the sensor frame: points (N, 3) float32 metres, channels one entry a point."""
        cloud = PointCloud(points, colours=colours, intensities=intensities, time_offsets_s=time_offsets_s)
        return self.send(CloudFrame(sensor_id, stamp_ns=stamp_ns, cloud=cloud))

    def send_scan(
        self,
        sensor_id: str,
        *,
        stamp_ns: int,
        ranges_m: Array,
        angle_min_rad: float,
        angle_increment_rad: float,
        range_min_m: float,
        range_max_m: float,
        time_increment_s: float = 0.0,
        intensities: Array | None = None,
        later_echoes_m: Array | None = None,
    ) -> R:
        """Sends a planar scan: ranges (B,) float32 metres, +inf no return, NaN invalid; of a lidar with
        several echoes the later ones (E, B)."""
        return self.send(
            ScanFrame(
                sensor_id,
                stamp_ns=stamp_ns,
                ranges_m=ranges_m,
                angle_min_rad=angle_min_rad,
                angle_increment_rad=angle_increment_rad,
                range_min_m=range_min_m,
                range_max_m=range_max_m,
                time_increment_s=time_increment_s,
                intensities=intensities,
                later_echoes_m=later_echoes_m,
            )
        )

    def send_imu(
        self,
        sensor_id: str,
        *,
        stamp_ns: int,
        angular_velocity_radps: Array | tuple[float, float, float],
        linear_acceleration_mps2: Array | tuple[float, float, float],
    ) -> R:
        """Sends an inertial sample in the sensor frame: rad/s, m/s^2 (at rest up with 9.81)."""
        return self.send(
            ImuFrame(
                sensor_id,
                stamp_ns=stamp_ns,
                angular_velocity_radps=np.asarray(angular_velocity_radps),
                linear_acceleration_mps2=np.asarray(linear_acceleration_mps2),
            )
        )

    def send_odometry(
        self, sensor_id: str, *, stamp_ns: int, t_odom_base: Pose, covariance: Array | None = None
    ) -> R:
        """Sends odometry: base to its own drifting frame; covariance (6, 6) of the step, in base."""
        return self.send(
            OdometryFrame(sensor_id, stamp_ns=stamp_ns, t_odom_base=t_odom_base, covariance=covariance)
        )

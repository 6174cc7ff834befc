"""Sensors: declare them, see their health."""

from __future__ import annotations

from .._convert import sensors as convert
from ..types.geometry import CameraIntrinsics, Pose
from ..types.listing import Listing
from ..types.sensors import OverloadPolicy, SensorKind, SensorSpec, SensorStatus
from .bound import AsyncSessionBound


class AsyncSensors(AsyncSessionBound):
    """The sensors of a session."""

    async def declare(
        self,
        sensor: SensorSpec | str,
        *,
        kind: SensorKind | str = SensorKind.UNSPECIFIED,
        t_base_sensor: Pose | None = None,
        intrinsics: CameraIntrinsics | None = None,
        time_offset_s: float = 0.0,
        range_max_m: float | None = None,
        overload_policy: OverloadPolicy | str = OverloadPolicy.UNSPECIFIED,
    ) -> SensorStatus:
        """Declares a sensor, given whole or by its name and parts, which are those of SensorSpec."""
        if isinstance(sensor, SensorSpec):
            spec = sensor
        else:
            spec = SensorSpec(
                sensor,
                kind=kind,
                t_base_sensor=Pose() if t_base_sensor is None else t_base_sensor,
                intrinsics=intrinsics,
                time_offset_s=time_offset_s,
                range_max_m=range_max_m,
                overload_policy=overload_policy,
            )
        return await self._transport.call(convert.declare(self.session_id, spec))

    async def get(self, sensor_id: str) -> SensorStatus:
        """One sensor with what the server sees of its stream."""
        return await self._transport.call(convert.get(self.session_id, sensor_id))

    async def update(
        self,
        sensor_id: str,
        *,
        t_base_sensor: Pose | None = None,
        intrinsics: CameraIntrinsics | None = None,
        time_offset_s: float | None = None,
        overload_policy: OverloadPolicy | str | None = None,
        etag: str = "",
    ) -> SensorStatus:
        """Changes what is given of a declaration, in force from the next frame on. The overload policy may
        change at any time, clock and mount of wheels and IMUs, too; else they are fixed once the sensor has
        sent a frame. With an `etag`, raises Aborted if it was changed since."""
        call = convert.update(
            self.session_id, sensor_id, t_base_sensor, intrinsics, time_offset_s, overload_policy, etag
        )
        return await self._transport.call(call)

    async def list(self) -> Listing[SensorStatus]:
        """All sensors with what the server sees of their streams."""
        return await self._transport.call(convert.list_sensors(self.session_id))

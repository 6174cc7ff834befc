"""Depth and colour images."""

from __future__ import annotations

from ..._arrays import Array
from ..._convert.toolbox import depth as convert
from ...types.cloud import PointCloud
from ...types.frames import EncodedImage
from ...types.geometry import CameraIntrinsics
from ..bound import AsyncBound


class AsyncDepth(AsyncBound):
    """Depth is (H, W) float32 metres, or uint16 units of metres_per_unit; colour is (H, W, 3) uint8 RGB."""

    async def unproject_depth(
        self,
        depth: Array | EncodedImage,
        *,
        intrinsics: CameraIntrinsics,
        metres_per_unit: float | None = None,
        colour: Array | EncodedImage | None = None,
        stride: int | None = None,
        min_depth_m: float | None = None,
        max_depth_m: float | None = None,
    ) -> PointCloud:
        """Depth image to cloud in the optical frame; depth from min_depth_m (0) to max_depth_m (10)."""
        call = convert.unproject_depth(
            depth, intrinsics, metres_per_unit, colour, stride, min_depth_m, max_depth_m
        )
        return await self._transport.call(call)

    async def decode_depth(self, data: bytes, *, metres_per_unit: float) -> Array:
        """A 16-bit grey PNG to (H, W) float32 metres; 0 is no return."""
        return await self._transport.call(convert.decode_depth(data, metres_per_unit))

    async def encode_depth(
        self, depth: Array, *, metres_per_unit: float | None = None, png_metres_per_unit: float = 0.001
    ) -> bytes:
        """A depth image to a 16-bit grey PNG of units of png_metres_per_unit."""
        return await self._transport.call(convert.encode_depth(depth, metres_per_unit, png_metres_per_unit))

    async def convert_depth(self, depth: Array, *, metres_per_unit: float = 0.001) -> Array:
        """uint16 units (16UC1) to float32 metres (32FC1), or the other way round."""
        return await self._transport.call(convert.convert_depth(depth, metres_per_unit))

    async def decode_colour(self, data: bytes) -> Array:
        """A PNG or JPEG to (H, W, 3) uint8 RGB."""
        return await self._transport.call(convert.decode_colour(data))

    async def encode_colour(
        self, colour: Array, *, encoding: str = "png", quality: int | None = None
    ) -> bytes:
        """A colour image to a PNG, or a JPEG of quality 1 to 100 (90)."""
        return await self._transport.call(convert.encode_colour(colour, encoding, quality))

"""Kept clouds, files of clouds, pipelines."""

from __future__ import annotations

import os
from collections.abc import Sequence

from ..._convert.toolbox import kept as convert
from ..._convert.toolbox.request import Cloud
from ...types.cloud import PointCloud
from ...types.toolbox import CloudFormat, CloudHandle, DecodedCloud, KeptClouds, PipelineResult, Step
from ..bound import AsyncBound
from ..operations import AsyncOperation, started


class AsyncKept(AsyncBound):
    """Clouds that stay on the server, files of clouds, several operations in one call."""

    async def upload_cloud(
        self,
        source: Cloud,
        *,
        file_format: CloudFormat | str | None = None,
        keep_s: float | None = None,
    ) -> CloudHandle:
        """Keeps a cloud, a file's or a session's on the server; toolbox calls take its handle in place of a
        cloud. It is forgotten when unused for keep_s (the server's limit), and refused if the budget is full.
        A file whose coordinates float32 would spoil is kept relative to an origin that decode_cloud tells."""
        if convert.is_large(source):
            return await self._transport.parts(convert.upload_large_cloud(source, file_format, keep_s))
        return await self._transport.call(convert.upload_cloud(source, file_format, keep_s))

    async def list_clouds(self) -> KeptClouds:
        """The clouds that the server keeps, and its budget."""
        return await self._transport.call(convert.list_clouds())

    async def download_cloud(self, kept: CloudHandle) -> PointCloud:
        """The points of a kept cloud, with all channels."""
        return await self._transport.chunks(convert.download_points(kept))

    async def download_file(self, kept: CloudHandle, file_format: CloudFormat | str) -> bytes:
        """A kept cloud as a file; its checksum was compared."""
        return await self._transport.chunks(convert.download_file(kept, file_format))

    async def drop_cloud(self, kept: CloudHandle) -> None:
        """Forgets a kept cloud."""
        return await self._transport.call(convert.drop_cloud(kept))

    async def decode_cloud(
        self, data: bytes, *, file_format: CloudFormat | str | None = None
    ) -> DecodedCloud:
        """A cloud's file to points; the format is told by the content if it is not said."""
        return await self._transport.call(convert.decode_cloud(data, file_format))

    async def read_cloud(
        self, path: str | os.PathLike[str], *, file_format: CloudFormat | str | None = None
    ) -> PointCloud:
        """The cloud of a file on this machine: PLY, PCD, LAS, LAZ, text, KITTI's .bin. Warns if its positions
        are relative to an origin, which decode_cloud tells, since float32 would spoil them."""
        source = convert.file_of(path, file_format)
        if convert.is_large(source):
            kept = await self.upload_cloud(source)
            try:
                return await self.download_cloud(kept)
            finally:
                await self.drop_cloud(kept)
        decoded = await self.decode_cloud(source.data, file_format=source.file_format)
        return convert.told_of_origin(path, decoded)

    async def write_cloud(self, cloud: Cloud, path: str | os.PathLike[str]) -> None:
        """Writes a cloud to a file on this machine, in the format of the path's ending."""
        data = await self.encode_cloud(cloud, convert.format_of(path))
        convert.write_file(path, data)

    async def encode_cloud(
        self,
        cloud: Cloud,
        file_format: CloudFormat | str = CloudFormat.PLY,
        *,
        origin_m: Sequence[float] | None = None,
    ) -> bytes:
        """A cloud to a file's bytes; origin_m (xyz, las and laz only) is added to every position."""
        return await self._transport.call(convert.encode_cloud(cloud, file_format, origin_m))

    async def run_pipeline(
        self,
        cloud: Cloud,
        steps: Sequence[Step],
        *,
        send_cloud: bool = False,
        keep_result: bool = False,
    ) -> PipelineResult:
        """Operations in turn on one cloud, which does not travel in between; send_cloud asks for what the
        last one left, keep_result for its handle.

            toolbox.run_pipeline(cloud, [
                Step("remove_statistical_outliers", quiet=True),
                Step("downsample_voxels", voxel_size_m=0.05),
                Step("segment_planes", max_planes=4, remainder="rest"),
                Step("cluster_points", eps_m=0.08),
                Step("compute_shape_features"),
            ])
        """
        return await self._transport.call(convert.run_pipeline(cloud, steps, send_cloud, keep_result))

    async def start_pipeline(
        self,
        cloud: Cloud,
        steps: Sequence[Step],
        *,
        send_cloud: bool = False,
        keep_result: bool = False,
        request_id: str | None = None,
    ) -> AsyncOperation[PipelineResult]:
        """run_pipeline() as an operation, which goes on whoever hangs up: wait() for it, and read its
        result(). The same request_id gives the same operation."""
        call = convert.run_pipeline(cloud, steps, send_cloud, keep_result)
        return await started(self._transport, call, request_id)

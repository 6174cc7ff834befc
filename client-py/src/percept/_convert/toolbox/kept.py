"""Kept clouds, files of clouds, pipelines."""

from __future__ import annotations

import hashlib
import itertools
import os
import pathlib
import warnings
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias, TypeGuard

from ... import _rpc
from ..._arrays import Array
from ..._call import Call, ChunkedCall, StreamedCall
from ..._parts import joined
from ...errors import Internal, InvalidArgument
from ...types.cloud import PointCloud
from ...types.toolbox import (
    CloudFile,
    CloudFormat,
    CloudHandle,
    ClusterShape,
    DecodedCloud,
    KeptClouds,
    PipelineResult,
    SessionCloud,
    Step,
    StepAnswer,
    StepResult,
)
from ...v1 import toolbox_clouds_service_pb2 as clouds_pb
from ...v1 import toolbox_kept_clouds_service_pb2 as kept_clouds_pb
from ...v1 import toolbox_pb2 as shared
from ...v1 import toolbox_pipelines_service_pb2 as pipelines_pb
from .. import geometry, scene
from . import regions, segmentation
from .request import Cloud, fill, of, uint32s, with_cloud

#: What goes along with an upload.
Sent: TypeAlias = PointCloud | Array | CloudFile | bytes
#: What is larger is uploaded in parts.
_ONE_MESSAGE_BYTES = 16 << 20
_PART_BYTES = 2 << 20
_PART_POINTS = 1 << 16


def handle(message: shared.CloudHandle) -> CloudHandle:
    return CloudHandle(
        handle=message.handle,
        num_points=message.num_points,
        size_bytes=message.size_bytes,
        expires_ns=message.expires_ns,
    )


def is_large(source: Cloud) -> TypeGuard[Sent]:
    """Whether an upload carries more than one message should."""
    return not isinstance(source, (CloudHandle, SessionCloud)) and _size_bytes(source) > _ONE_MESSAGE_BYTES


def _size_bytes(source: Sent) -> int:
    if isinstance(source, CloudFile):
        source = source.data
    if isinstance(source, bytes):
        return len(source)
    return 31 * len(source) if isinstance(source, PointCloud) else 12 * len(source)


def upload_cloud(
    source: Cloud, file_format: CloudFormat | str | None, keep_s: float | None
) -> Call[kept_clouds_pb.UploadCloudRequest, kept_clouds_pb.UploadCloudResponse, CloudHandle]:
    if isinstance(source, bytes):
        source = CloudFile(source, file_format)
    request = with_cloud(kept_clouds_pb.UploadCloudRequest, source, keep_s=keep_s)
    return Call(_rpc.UPLOAD_CLOUD, request, lambda a: handle(a.kept))


def upload_large_cloud(
    source: Sent, file_format: CloudFormat | str | None, keep_s: float | None
) -> StreamedCall[
    kept_clouds_pb.UploadLargeCloudRequest, kept_clouds_pb.UploadLargeCloudResponse, CloudHandle
]:
    def parts() -> Iterator[kept_clouds_pb.UploadLargeCloudRequest]:
        file = CloudFile(source, file_format) if isinstance(source, bytes) else source
        if isinstance(file, CloudFile):
            head: dict[str, object] = {"format": file.file_format, "keep_s": keep_s}
            for start in range(0, max(len(file.data), 1), _PART_BYTES):
                data = file.data[start : start + _PART_BYTES]
                yield of(kept_clouds_pb.UploadLargeCloudRequest, data=data, **head)
            return
        cloud = file if isinstance(file, PointCloud) else PointCloud(file)
        for start in range(0, max(len(cloud), 1), _PART_POINTS):
            part = geometry.sliced(cloud, slice(start, start + _PART_POINTS))
            yield of(kept_clouds_pb.UploadLargeCloudRequest, points=geometry.cloud_to(part), keep_s=keep_s)

    return StreamedCall(_rpc.UPLOAD_LARGE_CLOUD, parts, lambda a: handle(a.kept))


def list_clouds() -> Call[kept_clouds_pb.ListCloudsRequest, kept_clouds_pb.ListCloudsResponse, KeptClouds]:
    def read(answer: kept_clouds_pb.ListCloudsResponse) -> KeptClouds:
        clouds = tuple(handle(c) for c in answer.clouds)
        return KeptClouds(clouds=clouds, used_bytes=answer.used_bytes, max_bytes=answer.max_bytes)

    return Call(_rpc.LIST_CLOUDS, kept_clouds_pb.ListCloudsRequest(), read)


def drop_cloud(
    kept: CloudHandle,
) -> Call[kept_clouds_pb.DropCloudRequest, kept_clouds_pb.DropCloudResponse, None]:
    return Call(_rpc.DROP_CLOUD, kept_clouds_pb.DropCloudRequest(handle=kept.handle), lambda _: None)


def download_points(
    kept: CloudHandle,
) -> ChunkedCall[kept_clouds_pb.DownloadCloudRequest, kept_clouds_pb.DownloadCloudResponse, PointCloud]:
    def read(parts: list[kept_clouds_pb.DownloadCloudResponse]) -> PointCloud:
        cloud = geometry.joined_cloud([p.points.cloud for p in parts])
        if not parts or cloud.num_points != parts[0].points.total_points:
            raise Internal("the cloud came incomplete; ask again", reason="ANSWER_INCOMPLETE")
        return cloud

    return ChunkedCall(_rpc.DOWNLOAD_CLOUD, kept_clouds_pb.DownloadCloudRequest(handle=kept.handle), read)


def download_file(
    kept: CloudHandle, file_format: CloudFormat | str
) -> ChunkedCall[kept_clouds_pb.DownloadCloudRequest, kept_clouds_pb.DownloadCloudResponse, bytes]:
    def read(parts: list[kept_clouds_pb.DownloadCloudResponse]) -> bytes:
        data = b"".join(p.chunk.data for p in parts)
        if not parts or hashlib.sha256(data).hexdigest() != parts[0].chunk.header.sha256:
            raise Internal("the file differs from its checksum; ask again", reason="CHECKSUM_MISMATCH")
        return data

    request = of(kept_clouds_pb.DownloadCloudRequest, handle=kept.handle, format=file_format)
    return ChunkedCall(_rpc.DOWNLOAD_CLOUD, request, read)


#: Formats by the endings of files.
_ENDINGS = {
    ".ply": CloudFormat.PLY,
    ".pcd": CloudFormat.PCD,
    ".las": CloudFormat.LAS,
    ".laz": CloudFormat.LAZ,
    ".bin": CloudFormat.KITTI_BIN,
    ".xyz": CloudFormat.XYZ,
    ".txt": CloudFormat.XYZ,
    ".csv": CloudFormat.XYZ,
}


def format_of(path: str | os.PathLike[str]) -> CloudFormat:
    """The format that a file's ending says."""
    ending = pathlib.Path(path).suffix.lower()
    if ending not in _ENDINGS:
        message = f"path ends in {ending!r}; end it in one of {', '.join(_ENDINGS)}"
        raise InvalidArgument(message, reason="FORMAT_UNKNOWN", field="path")
    return _ENDINGS[ending]


def file_of(path: str | os.PathLike[str], file_format: CloudFormat | str | None) -> CloudFile:
    """A file on this machine. KITTI's has no mark of its own: its ending tells."""
    is_kitti = file_format is None and pathlib.Path(path).suffix.lower() == ".bin"
    return CloudFile(pathlib.Path(path).read_bytes(), CloudFormat.KITTI_BIN if is_kitti else file_format)


def write_file(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes a file on this machine."""
    pathlib.Path(path).write_bytes(data)


def told_of_origin(path: str | os.PathLike[str], decoded: DecodedCloud) -> PointCloud:
    """The cloud; warns if its positions are relative to an origin."""
    if decoded.origin_m.any():
        x, y, z = decoded.origin_m
        words = f"positions of {os.fspath(path)} are relative to ({x:.0f}, {y:.0f}, {z:.0f}) m"
        warnings.warn(words, stacklevel=3)
    return decoded.cloud


def decode_cloud(
    data: bytes, file_format: CloudFormat | str | None
) -> Call[clouds_pb.DecodeCloudRequest, clouds_pb.DecodeCloudResponse, DecodedCloud]:
    def read(answer: clouds_pb.DecodeCloudResponse) -> DecodedCloud:
        return DecodedCloud(cloud=geometry.cloud(answer.cloud), origin_m=geometry.vector3(answer.origin_m))

    request = clouds_pb.DecodeCloudRequest(file=of(shared.CloudFile, data=data, format=file_format))
    return Call(_rpc.DECODE_CLOUD, request, read)


def encode_cloud(
    cloud: Cloud, file_format: CloudFormat | str, origin_m: Sequence[float] | None
) -> Call[clouds_pb.EncodeCloudRequest, clouds_pb.EncodeCloudResponse, bytes]:
    request = with_cloud(clouds_pb.EncodeCloudRequest, cloud, format=file_format, origin_m=origin_m)
    return Call(_rpc.ENCODE_CLOUD, request, lambda a: a.file.data)


def run_pipeline(
    cloud: Cloud, steps: Sequence[Step], send_cloud: bool, keep_result: bool
) -> Call[pipelines_pb.RunPipelineRequest, pipelines_pb.RunPipelineResponse, PipelineResult]:
    request = with_cloud(
        pipelines_pb.RunPipelineRequest, cloud, send_cloud=send_cloud, keep_result=keep_result
    )
    request.steps.extend(_step_to(step) for step in steps)
    return Call(_rpc.RUN_PIPELINE, request, pipeline_result)


def pipeline_result(answer: pipelines_pb.RunPipelineResponse) -> PipelineResult:
    """What the steps did."""
    return PipelineResult(
        steps=tuple(_result(r) for r in _whole(answer.results)),
        cloud=geometry.cloud(answer.cloud) if answer.HasField("cloud") else None,
        kept=handle(answer.kept) if answer.HasField("kept") else None,
    )


def _whole(results: Sequence[pipelines_pb.PipelineStepResult]) -> list[pipelines_pb.PipelineStepResult]:
    """What a step found may have come in several parts."""
    by_step = itertools.groupby(results, key=lambda r: r.step)
    return [joined(list(parts)) for _, parts in by_step]


def _step_to(step: Step) -> pipelines_pb.PipelineStep:
    out = of(pipelines_pb.PipelineStep, quiet=step.quiet, remainder=step.remainder)
    operations = [f.name for f in pipelines_pb.PipelineStep.DESCRIPTOR.oneofs_by_name["step"].fields]
    if step.operation not in operations:
        message = f"operation is {step.operation!r}; choose one of {', '.join(operations)}"
        raise InvalidArgument(message, reason="STEP_UNKNOWN", field="operation")
    request = getattr(out, step.operation)
    request.SetInParent()
    fill(request, step.params)
    return out


def _result(message: pipelines_pb.PipelineStepResult) -> StepResult:
    return StepResult(
        operation=message.operation,
        num_points_in=message.num_points_in,
        num_points_out=message.num_points_out,
        elapsed_ms=message.elapsed_ms,
        answer=_answer(message),
    )


def _answer(message: pipelines_pb.PipelineStepResult) -> StepAnswer | None:
    readers: dict[str, Any] = {
        "indices": uint32s,
        "planes": segmentation.planes,
        "clusters": segmentation.clusters,
        "shape": segmentation.shape,
        "shapes": _shapes,
        "detections": segmentation.detections,
        "ground": regions.ground,
        "regions": regions.regions,
        "objects": regions.objects,
    }
    which = message.WhichOneof("answer")
    answer: StepAnswer | None = readers[which](getattr(message, which)) if which in readers else None
    return answer


def _shapes(message: pipelines_pb.ClusterShapes) -> list[ClusterShape]:
    return [
        ClusterShape(
            label=c.label, features=scene.features(c.features), upright_box=geometry.box(c.upright_box)
        )
        for c in message.clusters
    ]

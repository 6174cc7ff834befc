"""Kept clouds, files of clouds, pipelines."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

from ... import _rpc
from ..._arrays import Array
from ..._call import Call, ChunkedCall, StreamedCall
from ...errors import Internal, InvalidArgument
from ...types.geometry import PointCloud
from ...types.toolbox import (
    CloudFormat,
    CloudHandle,
    ClusterShape,
    DecodedCloud,
    KeptClouds,
    PipelineResult,
    Step,
    StepAnswer,
    StepResult,
)
from ...v1 import toolbox_service_pb2 as service
from .. import geometry, scene
from . import regions, segmentation
from .request import Cloud, fill, of, uint32s, with_cloud

#: What is larger is uploaded in parts.
ONE_MESSAGE_BYTES = 16 << 20
_PART_BYTES = 2 << 20
_PART_POINTS = 1 << 16


def handle(message: service.CloudHandle) -> CloudHandle:
    return CloudHandle(
        handle=message.handle,
        num_points=message.num_points,
        size_bytes=message.size_bytes,
        expires_ns=message.expires_ns,
    )


def size_bytes(source: PointCloud | Array | bytes) -> int:
    """What an upload carries."""
    if isinstance(source, bytes):
        return len(source)
    return 31 * len(source) if isinstance(source, PointCloud) else 12 * len(source)


def upload_cloud(
    source: PointCloud | Array | bytes, file_format: CloudFormat | str | None, keep_s: float | None
) -> Call[service.UploadCloudRequest, service.UploadCloudResponse, CloudHandle]:
    request = of(service.UploadCloudRequest, keep_s=keep_s)
    if isinstance(source, bytes):
        request.file.CopyFrom(of(service.CloudFile, data=source, format=file_format))
    else:
        request.cloud.CopyFrom(geometry.cloud_to(source))
    return Call(_rpc.UPLOAD_CLOUD, request, lambda a: handle(a.kept))


def upload_large_cloud(
    source: PointCloud | Array | bytes, file_format: CloudFormat | str | None, keep_s: float | None
) -> StreamedCall[service.UploadLargeCloudRequest, service.UploadLargeCloudResponse, CloudHandle]:
    def parts() -> Iterator[service.UploadLargeCloudRequest]:
        head: dict[str, object] = {"format": file_format, "keep_s": keep_s}
        if isinstance(source, bytes):
            for start in range(0, max(len(source), 1), _PART_BYTES):
                yield of(service.UploadLargeCloudRequest, data=source[start : start + _PART_BYTES], **head)
            return
        cloud = source if isinstance(source, PointCloud) else PointCloud(source)
        for start in range(0, max(len(cloud), 1), _PART_POINTS):
            part = geometry.sliced(cloud, slice(start, start + _PART_POINTS))
            yield of(service.UploadLargeCloudRequest, points=geometry.cloud_to(part), **head)

    return StreamedCall(_rpc.UPLOAD_LARGE_CLOUD, parts, lambda a: handle(a.kept))


def list_clouds() -> Call[service.ListCloudsRequest, service.ListCloudsResponse, KeptClouds]:
    def read(answer: service.ListCloudsResponse) -> KeptClouds:
        clouds = tuple(handle(c) for c in answer.clouds)
        return KeptClouds(clouds=clouds, used_bytes=answer.used_bytes, max_bytes=answer.max_bytes)

    return Call(_rpc.LIST_CLOUDS, service.ListCloudsRequest(), read)


def drop_cloud(kept: CloudHandle) -> Call[service.DropCloudRequest, service.DropCloudResponse, None]:
    return Call(_rpc.DROP_CLOUD, service.DropCloudRequest(handle=kept.handle), lambda _: None)


def download_points(
    kept: CloudHandle,
) -> ChunkedCall[service.DownloadCloudRequest, service.DownloadCloudResponse, PointCloud]:
    def read(parts: list[service.DownloadCloudResponse]) -> PointCloud:
        cloud = geometry.joined_cloud([p.points.cloud for p in parts])
        if not parts or cloud.num_points != parts[0].points.total_points:
            raise Internal("the cloud came incomplete; ask again", reason="ANSWER_INCOMPLETE")
        return cloud

    return ChunkedCall(_rpc.DOWNLOAD_CLOUD, service.DownloadCloudRequest(handle=kept.handle), read)


def download_file(
    kept: CloudHandle, file_format: CloudFormat | str
) -> ChunkedCall[service.DownloadCloudRequest, service.DownloadCloudResponse, bytes]:
    def read(parts: list[service.DownloadCloudResponse]) -> bytes:
        data = b"".join(p.chunk.data for p in parts)
        if not parts or hashlib.sha256(data).hexdigest() != parts[0].chunk.header.sha256:
            raise Internal("the file differs from its checksum; ask again", reason="CHECKSUM_MISMATCH")
        return data

    request = of(service.DownloadCloudRequest, handle=kept.handle, format=file_format)
    return ChunkedCall(_rpc.DOWNLOAD_CLOUD, request, read)


def decode_cloud(
    data: bytes, file_format: CloudFormat | str | None
) -> Call[service.DecodeCloudRequest, service.DecodeCloudResponse, DecodedCloud]:
    def read(answer: service.DecodeCloudResponse) -> DecodedCloud:
        return DecodedCloud(cloud=geometry.cloud(answer.cloud), origin_m=geometry.vector3(answer.origin_m))

    request = service.DecodeCloudRequest(file=of(service.CloudFile, data=data, format=file_format))
    return Call(_rpc.DECODE_CLOUD, request, read)


def encode_cloud(
    cloud: Cloud, file_format: CloudFormat | str, origin_m: Sequence[float] | None
) -> Call[service.EncodeCloudRequest, service.EncodeCloudResponse, bytes]:
    request = with_cloud(service.EncodeCloudRequest, cloud, format=file_format, origin_m=origin_m)
    return Call(_rpc.ENCODE_CLOUD, request, lambda a: a.file.data)


def run_pipeline(
    cloud: Cloud, steps: Sequence[Step], send_cloud: bool, keep_result: bool
) -> Call[service.RunPipelineRequest, service.RunPipelineResponse, PipelineResult]:
    def read(answer: service.RunPipelineResponse) -> PipelineResult:
        return PipelineResult(
            steps=tuple(_result(s, r) for s, r in zip(steps, answer.results, strict=True)),
            cloud=geometry.cloud(answer.cloud) if answer.HasField("cloud") else None,
            kept=handle(answer.kept) if answer.HasField("kept") else None,
        )

    request = with_cloud(service.RunPipelineRequest, cloud, send_cloud=send_cloud, keep_result=keep_result)
    request.steps.extend(_step_to(step) for step in steps)
    return Call(_rpc.RUN_PIPELINE, request, read)


def _step_to(step: Step) -> service.PipelineStep:
    out = of(service.PipelineStep, quiet=step.quiet, remainder=step.remainder)
    operations = [f.name for f in service.PipelineStep.DESCRIPTOR.oneofs_by_name["step"].fields]
    if step.operation not in operations:
        message = f"operation is {step.operation!r}; choose one of {', '.join(operations)}"
        raise InvalidArgument(message, reason="STEP_UNKNOWN", field="operation")
    request = getattr(out, step.operation)
    request.SetInParent()
    fill(request, step.params)
    return out


def _result(step: Step, message: service.PipelineStepResult) -> StepResult:
    return StepResult(
        operation=step.operation,
        num_points_in=message.num_points_in,
        num_points_out=message.num_points_out,
        elapsed_ms=message.elapsed_ms,
        answer=_answer(message),
    )


def _answer(message: service.PipelineStepResult) -> StepAnswer | None:
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


def _shapes(message: service.ClusterShapes) -> list[ClusterShape]:
    return [
        ClusterShape(
            label=c.label, features=scene.features(c.features), upright_box=geometry.box(c.upright_box)
        )
        for c in message.clusters
    ]

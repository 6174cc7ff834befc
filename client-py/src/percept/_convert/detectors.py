"""Learned detectors."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence

from .. import _rpc
from .._call import Call
from ..types.detectors import (
    ChannelOrder,
    DetectorInfo,
    DetectorLayout,
    DetectorOrigin,
    ImageFit,
    ImageInput,
)
from ..v1 import detectors_service_pb2 as service
from . import words


def _image_input_to(given: ImageInput) -> service.ImageInput:
    return service.ImageInput(
        channel_order=words.number("channel_order", service.ChannelOrder, given.channel_order),
        fit=words.number("fit", service.ImageFit, given.fit),
        scale=given.scale,
        mean=given.mean,
        std=given.std,
    )


def _image_input(told: service.ImageInput) -> ImageInput:
    mean, std = tuple(told.mean), tuple(told.std)
    return ImageInput(
        channel_order=words.word(ChannelOrder, service.ChannelOrder, told.channel_order),
        fit=words.word(ImageFit, service.ImageFit, told.fit),
        scale=told.scale,
        mean=(mean[0], mean[1], mean[2]),
        std=(std[0], std[1], std[2]),
    )


def _detector(told: service.DetectorInfo) -> DetectorInfo:
    spec = told.spec
    return DetectorInfo(
        name=spec.name,
        layout=words.word(DetectorLayout, service.DetectorLayout, spec.layout),
        labels=tuple(spec.labels),
        score_threshold=spec.score_threshold,
        iou_threshold=spec.iou_threshold,
        image_input=_image_input(spec.image_input) if spec.HasField("image_input") else None,
        size_bytes=told.size_bytes,
        sha256=told.sha256,
        input_shape=tuple(told.input_shape),
        multiply_adds=told.multiply_adds,
        origin=words.word(DetectorOrigin, service.DetectorOrigin, told.origin),
        uploaded_by=told.uploaded_by,
        create_time_ns=told.create_time_ns,
    )


def upload_detector(
    model: str | os.PathLike[str] | bytes,
    name: str,
    layout: DetectorLayout | str,
    labels: Sequence[str] | str,
    score_threshold: float | None,
    iou_threshold: float | None,
    image_input: ImageInput | None,
) -> Call[service.UploadDetectorRequest, service.UploadDetectorResponse, DetectorInfo]:
    spec = service.DetectorSpec(
        name=name,
        layout=words.number("layout", service.DetectorLayout, layout),
        # A word is a sequence of letters, too.
        labels=[labels] if isinstance(labels, str) else labels,
        score_threshold=score_threshold,
        iou_threshold=iou_threshold,
        image_input=None if image_input is None else _image_input_to(image_input),
    )
    data = model if isinstance(model, bytes) else pathlib.Path(model).read_bytes()
    request = service.UploadDetectorRequest(spec=spec, model=data)
    return Call(_rpc.UPLOAD_DETECTOR, request, lambda a: _detector(a.detector))


def list_detectors() -> Call[
    service.ListDetectorsRequest, service.ListDetectorsResponse, tuple[DetectorInfo, ...]
]:
    request = service.ListDetectorsRequest()
    return Call(_rpc.LIST_DETECTORS, request, lambda a: tuple(_detector(d) for d in a.detectors))


def delete_detector(name: str) -> Call[service.DeleteDetectorRequest, service.DeleteDetectorResponse, None]:
    return Call(_rpc.DELETE_DETECTOR, service.DeleteDetectorRequest(name=name), lambda _: None)

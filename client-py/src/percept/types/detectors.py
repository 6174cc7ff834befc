"""Learned detectors: models that the server keeps by name."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value


class DetectorLayout(Name):
    """How a model's output is laid out."""

    UNSPECIFIED = "unspecified"
    #: Image: one output of 1 x (5 + C) x H x W, as FastestDet has it.
    FASTEST_DET = "fastest_det"
    #: Image: one output of 1 x (4 + C) x N, as YOLOv8 and later have it.
    YOLO_V8 = "yolo_v8"
    #: Image: boxes of 1 x N x 4 (left, top, right, bottom in pixels of the input), then scores of 1 x N x C.
    BOXES_SCORES = "boxes_scores"


class ChannelOrder(Name):
    """The order of an input's channels."""

    UNSPECIFIED = "unspecified"
    RGB = "rgb"
    BGR = "bgr"


class ImageFit(Name):
    """How an image of another shape is brought to the input's."""

    UNSPECIFIED = "unspecified"
    #: Columns and rows each by a scale of their own.
    STRETCH = "stretch"
    #: By one scale, in the middle of a grey ground.
    LETTERBOX = "letterbox"


class DetectorOrigin(Name):
    """Where a detector comes from."""

    UNSPECIFIED = "unspecified"
    #: The server's folder.
    FOLDER = "folder"
    #: A caller of this tenant uploaded it.
    UPLOAD = "upload"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageInput(Value):
    """How an image becomes a model's input: pixels (0 to 255) times scale, less mean, over std."""

    channel_order: ChannelOrder | str = ChannelOrder.RGB
    fit: ImageFit | str = ImageFit.STRETCH
    #: Above 0, at most 1000.
    scale: float = 1.0 / 255.0
    #: By channel of the input, -1000 to 1000.
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: By channel of the input, 0.000001 to 1000.
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DetectorInfo(Value):
    """A learned detector that may be used, with every value that is in force."""

    #: As sessions and requests name it.
    name: str
    layout: DetectorLayout
    #: The model's classes, in its order.
    labels: tuple[str, ...]
    #: What has a lower score is not reported.
    score_threshold: float
    #: Of boxes of one label that overlap by more than this the best one stays.
    iou_threshold: float
    #: How an image becomes the input; None for models that take no image.
    image_input: ImageInput | None
    #: Of the model's file.
    size_bytes: int
    #: SHA-256 of the model's file, lower-case hex.
    sha256: str
    #: Of the model's input, e.g. (1, 3, 352, 352).
    input_shape: tuple[int, ...]
    #: Multiplications and additions of a run, about.
    multiply_adds: int
    origin: DetectorOrigin
    #: Name of the caller who uploaded it; empty if it is of the folder.
    uploaded_by: str
    #: When it was uploaded, nanoseconds since 1970, server's clock; 0 if it is of the folder.
    create_time_ns: int

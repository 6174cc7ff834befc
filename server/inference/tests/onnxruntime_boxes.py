#!/usr/bin/env python3
"""Writes boxes.json: what ONNX Runtime, OpenCV and numpy find by FastestDet in recorded images.

    pip install onnxruntime opencv-python-headless numpy
    server/inference/tests/onnxruntime_boxes.py DATA > server/inference/tests/boxes.json

DATA is the folder of the recorded data. Source of the formulas: FastestDet, commit 50473cd, utils/tool.py.
"""

import json
import pathlib
import sys

import cv2
import numpy as np
import onnxruntime

IMAGES = [
    "objects-kitti/image_2/000000.png",
    "objects-kitti/image_2/000001.png",
    "objects-kitti/image_2/000002.png",
    "rgbd-7scenes-a/frame-000000.color.jpg",
    "rgbd-7scenes-a/frame-000100.color.jpg",
]
SCORE, IOU = 0.3, 0.45


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-x))


def detect(session: onnxruntime.InferenceSession, image: np.ndarray, labels: list[str]) -> list[dict]:
    """Boxes of a BGR image, best first."""
    height, width = image.shape[:2]
    resized = cv2.resize(image, (352, 352), interpolation=cv2.INTER_LINEAR)
    batch = np.ascontiguousarray(resized.transpose(2, 0, 1)[None], np.float32) / 255
    output = session.run(None, {session.get_inputs()[0].name: batch})[0][0].astype(np.float64)
    rows, columns = output.shape[1:]
    row, column = np.mgrid[:rows, :columns]
    score = output[0] ** 0.6 * output[5:].max(0) ** 0.4
    label = output[5:].argmax(0)
    x, y = (np.tanh(output[1]) + column) / columns * width, (np.tanh(output[2]) + row) / rows * height
    w, h = sigmoid(output[3]) * width, sigmoid(output[4]) * height
    boxes = np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], -1).reshape(-1, 4)
    kept: list[int] = []
    for i in np.argsort(-score.ravel(), kind="stable"):
        if score.flat[i] < SCORE:
            break
        if all(label.flat[k] != label.flat[i] or overlap(boxes[k], boxes[i]) <= IOU for k in kept):
            kept.append(i)
    limit = np.array([width, height, width, height])
    return [
        {
            "label": labels[label.flat[i]],
            "score": round(float(score.flat[i]), 6),
            "box_px": [round(float(v), 3) for v in boxes[i].clip(0, limit)],
        }
        for i in kept
    ]


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    shared = np.prod((np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])).clip(0))
    return shared / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared)


def main() -> None:
    data = pathlib.Path(sys.argv[1])
    session = onnxruntime.InferenceSession(data / "model-fastestdet/FastestDet.onnx")
    labels = (data / "model-fastestdet/coco.names").read_text().split("\n")
    images = {name: detect(session, cv2.imread(str(data / name)), labels) for name in IMAGES}
    json.dump({"score_threshold": SCORE, "iou_threshold": IOU, "images": images}, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()

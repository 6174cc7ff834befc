#!/usr/bin/env python3
"""Writes the small models that the tests and the fuzzer begin with, and prints what ONNX Runtime makes of one image.

    pip install onnx onnxruntime numpy
    server/inference/tests/small_models.py tests/fuzz/seeds/onnx

The figures stand in server/inference/src/network.rs: of each output the first two numbers, the middle one, the last two,
and the sum of all magnitudes.
"""

import pathlib
import sys

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

random = np.random.default_rng(0)


def weights(*shape: int) -> np.ndarray:
    return random.normal(0, 0.3, shape).astype(np.float32)


def longs(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def conv(inputs: list[str], output: str, side: int, stride: int, pad: int) -> onnx.NodeProto:
    sides = {"kernel_shape": [side] * 2, "strides": [stride] * 2, "pads": [pad] * 4, "dilations": [1, 1], "group": 1}
    return helper.make_node("Conv", inputs, [output], **sides)


def grid() -> tuple[list[onnx.NodeProto], dict[str, np.ndarray]]:
    """An output in the manner of FastestDet: 1 x 7 x 4 x 4."""
    return [conv(["image", "w", "b"], "out", 4, 4, 0)], {"w": weights(7, 3, 4, 4), "b": weights(7)}


def yolo() -> tuple[list[onnx.NodeProto], dict[str, np.ndarray]]:
    """An output in the manner of YOLOv8, from the operators that it is made of: 1 x 6 x 16."""
    node = helper.make_node
    shape = numpy_helper.from_array(longs(1, 6, 16))
    nodes = [
        conv(["image", "w1"], "a", 3, 2, 1),
        node("Sigmoid", ["a"], ["s"]),
        node("Mul", ["a", "s"], ["m"]),
        node("MaxPool", ["m"], ["p"], kernel_shape=[3, 3], strides=[1, 1], pads=[1, 1, 1, 1]),
        node("Concat", ["m", "p"], ["c"], axis=1),
        node("Resize", ["c", "", "scales"], ["r"], mode="nearest"),
        conv(["r", "w2"], "d", 1, 4, 0),
        node("Constant", [], ["shape"], value=shape),
        node("Reshape", ["d", "shape"], ["e"]),
        node("Split", ["e", "parts"], ["x", "y"], axis=1),
        node("Sigmoid", ["y"], ["z"]),
        node("Concat", ["x", "z"], ["out"], axis=1),
    ]
    scales = np.array([1, 1, 2, 2], np.float32)
    return nodes, {"w1": weights(2, 3, 3, 3), "w2": weights(6, 4, 1, 1), "scales": scales, "parts": longs(4, 2)}


def attention() -> tuple[list[onnx.NodeProto], dict[str, np.ndarray]]:
    """What transformers are made of, with shapes that are computed: 1 x 6 x 4."""
    node = helper.make_node
    nodes = [
        conv(["image", "w1"], "a", 8, 8, 0),
        node("BatchNormalization", ["a", "scale", "bias", "mean", "variance"], ["n"]),
        node("Relu", ["n"], ["r"]),
        node("Reshape", ["r", "flat"], ["f"]),
        node("Transpose", ["f"], ["t"], perm=[0, 2, 1]),
        node("MatMul", ["f", "t"], ["q"]),
        node("Softmax", ["q"], ["s"], axis=-1),
        node("MatMul", ["s", "f"], ["v"]),
        node("Pad", ["v", "pads"], ["w"]),
        node("Slice", ["w", "start", "end", "axis"], ["y"]),
        node("Shape", ["y"], ["shape"]),
        node("Gather", ["shape", "zero"], ["one"], axis=0),
        node("Concat", ["one", "rest"], ["full"], axis=0),
        node("Reshape", ["y", "full"], ["z"]),
        node("ReduceMean", ["z"], ["average"], axes=[2], keepdims=1),
        node("Sub", ["z", "average"], ["out"]),
    ]
    norm = {"scale": weights(6), "bias": weights(6), "mean": weights(6), "variance": abs(weights(6))}
    cut = {"start": longs(0), "end": longs(4), "axis": longs(2), "zero": longs(0), "rest": longs(6, -1)}
    return nodes, {"w1": weights(6, 3, 8, 8), **norm, "flat": longs(1, 6, 4), "pads": longs(0, 0, 0, 0, 0, 1), **cut}


def main() -> None:
    folder = pathlib.Path(sys.argv[1])
    image = ((np.arange(768) * 37 % 101) / 101).astype(np.float32).reshape(1, 3, 16, 16)
    for make in (grid, yolo, attention):
        nodes, tensors = make()
        inputs = [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, 16, 16])]
        outputs = [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)]
        initializers = [numpy_helper.from_array(array, name) for name, array in tensors.items()]
        graph = helper.make_graph(nodes, make.__name__, inputs, outputs, initializers)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        path = folder / f"{make.__name__}.onnx"
        path.write_bytes(model.SerializeToString())
        out = onnxruntime.InferenceSession(path).run(None, {"image": image})[0]
        some = [round(float(out.flat[i]), 6) for i in (0, 1, out.size // 2, -2, -1)]
        print(make.__name__, out.shape, some, round(float(np.abs(out).sum()), 4))


if __name__ == "__main__":
    main()

"""Learned detectors: a folder of models, their answers beside ONNX Runtime's, what they see in a session."""

from __future__ import annotations

import json
import pathlib
import shutil

import numpy as np
import pytest
from percept import Client, InvalidArgument, NotFound

from recorded.test_seven_scenes import camera_of, frames
from support.server import REPO, Server, recorded

TRUTH = REPO / "server" / "inference" / "tests" / "boxes.json"


@pytest.fixture(scope="module")
def model() -> pathlib.Path:
    folder = recorded("model-fastestdet")
    if folder is None:
        pytest.skip("recorded data is not there")
    return folder


@pytest.fixture(scope="module")
def served(model, tmp_path_factory):
    """A server with FastestDet, and with models that cannot be used."""
    folder = tmp_path_factory.mktemp("models")
    shutil.copy(model / "FastestDet.onnx", folder / "fastest.onnx")
    shutil.copy(model / "coco.names", folder / "fastest.names")
    (folder / "fastest.toml").write_text('layout = "fastest_det"\nscore_threshold = 0.3\n')
    whole = (model / "FastestDet.onnx").read_bytes()
    (folder / "cut.onnx").write_bytes(whole[: len(whole) // 2])
    (folder / "few.onnx").write_bytes(whole)
    (folder / "silent.onnx").write_bytes(whole)
    shutil.copy(model / "coco.names", folder / "cut.names")
    (folder / "cut.toml").write_text('layout = "fastest_det"\n')
    (folder / "few.toml").write_text('layout = "fastest_det"\nlabels = ["cat", "dog"]\n')
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PERCEPT_DETECTORS_DIR", str(folder))
        server = Server(tmp_path_factory.mktemp("data") / "data")
    yield server
    server.kill()


def test_models_that_cannot_be_used_are_told_and_stop_nothing(served):
    with Client(served.grpc) as client:
        (only,) = client.toolbox.image_detectors()
        assert (only.name, len(only.labels), only.labels[0]) == ("fastest", 80, "person")
    log = served.log.read_text()
    for name, why in [
        ("cut", "not a whole ONNX file"),
        ("few", "2 given, the model tells 80"),
        ("silent", "silent.toml"),
    ]:
        assert any(f"{name}.onnx" in line and why in line for line in log.splitlines()), (name, log)


def test_boxes_are_those_of_onnx_runtime(served):
    truth = json.loads(TRUTH.read_text())
    # JPEGs are decoded in many ways, a grey value apart: enough to move a score over the threshold.
    lossless = {name: found for name, found in truth["images"].items() if name.endswith(".png")}
    images = {name: found for name, found in lossless.items() if recorded(name.split("/")[0])}
    if not images:
        pytest.skip("recorded data is not there")
    with Client(served.grpc) as client:
        for name, expected in images.items():
            image = (recorded(name.split("/")[0]) / name.split("/", 1)[1]).read_bytes()
            found = client.toolbox.detect_in_image("fastest", image)
            assert [f.label for f in found] == [e["label"] for e in expected], name
            for f, e in zip(found, expected, strict=True):
                assert f.score == pytest.approx(e["score"], abs=1e-3)
                assert np.abs(f.edges_px - e["box_px"]).max() < 1, (name, f, e)


def test_a_session_tells_things_by_the_names_of_the_detector(served, seven_scenes):
    with Client(served.grpc) as client:
        learned = {"detection": {"learned": "fastest"}}
        session = client.sessions.create(sensors=[camera_of(seven_scenes)], params=learned)
        with session.stream() as stream:
            for stamp_ns, depth, colour in frames(seven_scenes, count=200):
                stream.send_rgbd("camera", stamp_ns=stamp_ns, depth=depth, colour=colour, metres_per_unit=0.001)
        assert stream.summary.rejected == 0
        objects = list(session.scene.objects())
        names = {o.label for o in objects}
        # A desk with a cup, keyboards, books and chairs: looked at in the pictures.
        assert {"cup", "chair"} <= names, names
        assert names & {"keyboard", "book", "laptop"}, names
        lifted = [o for o in objects if o.object_class == "unknown" and o.label != "unknown"]
        assert all((o.box.size_m < 3).all() for o in lifted)


def test_a_detector_that_is_not_there_is_refused(served, client):
    with Client(served.grpc) as with_models:
        with pytest.raises(InvalidArgument) as error:
            with_models.sessions.create(params={"detection": {"learned": "yolo"}})
        assert error.value.reason == "PARAMETER_OUT_OF_RANGE"
        assert "fastest" in str(error.value)
    for some in (client,):
        with pytest.raises(NotFound) as error:
            some.toolbox.detect_in_image("fastest", np.zeros((8, 8, 3), np.uint8))
        assert error.value.reason == "DETECTOR_NOT_FOUND"

"""Learned detectors that callers upload: checked, stored, used by name, deleted, each tenant's its own."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess

import httpx
import numpy as np
import pytest
from percept import (
    AlreadyExists,
    Client,
    FailedPrecondition,
    ImageInput,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
)

from support.server import REPO, Server, binary

SEEDS = REPO / "tests" / "fuzz" / "seeds" / "onnx"
#: 1 x 3 x 16 x 16 in, 1 x 6 x 16 out: two classes.
YOLO = SEEDS / "yolo.onnx"
#: One output of 1 x 7 x 4 x 4: two classes of FastestDet's layout.
GRID = SEEDS / "grid.onnx"
LABELS = ["cat", "dog"]


def upload(client, name="pets", model=YOLO, layout="yolo_v8", labels=LABELS, **more):
    return client.upload_detector(model, name=name, layout=layout, labels=labels, **more)


def params(name: str) -> dict:
    return {"detection": {"learned": name}}


@pytest.fixture
def server(tmp_path):
    server = Server(tmp_path / "data")
    yield server
    server.kill()


def test_an_uploaded_model_is_used_by_name_and_outlives_a_crash(server):
    image = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    with Client(server.grpc) as client:
        assert client.detectors() == ()
        given = ImageInput(channel_order="bgr", fit="letterbox", scale=0.01, mean=(1, 2, 3), std=(4, 5, 6))
        info = upload(client, score_threshold=0.0, iou_threshold=1.0, image_input=given)
        data = YOLO.read_bytes()
        assert (info.name, info.layout, info.labels) == ("pets", "yolo_v8", ("cat", "dog"))
        assert (info.size_bytes, info.sha256) == (len(data), hashlib.sha256(data).hexdigest())
        assert info.input_shape == (1, 3, 16, 16)
        assert (info.origin, info.uploaded_by != "", info.create_time_ns > 1.7e18) == ("upload", True, True)
        assert info.image_input == given
        assert client.detectors() == (info,)
        assert [d.name for d in client.toolbox.image_detectors()] == ["pets"]
        before = client.toolbox.detect_in_image("pets", image)
        client.sessions.create("robot", params=params("pets"))
    server.kill()
    server.start()
    with Client(server.grpc) as client:
        assert client.detectors() == (info,)
        assert client.toolbox.detect_in_image("pets", image) == before
        # It was durable that the session names it, which never was awake.
        with pytest.raises(FailedPrecondition) as error:
            client.delete_detector("pets")
        assert (error.value.reason, error.value.field) == ("DETECTOR_IN_USE", "name")
        assert "robot" in str(error.value)


def test_a_model_is_deleted_once_no_session_names_it(server):
    with Client(server.grpc) as client:
        upload(client)
        other = client.sessions.create("other")
        robot = client.sessions.create("robot", params=params("pets"))
        with pytest.raises(FailedPrecondition):
            client.delete_detector("pets")
        robot.update(params=params(""))
        other.update(params=params("pets"))
        with pytest.raises(FailedPrecondition) as error:
            client.delete_detector("pets")
        assert "other" in str(error.value)
        other.delete()
        client.delete_detector("pets")
        assert client.detectors() == ()
        with pytest.raises(NotFound) as missing:
            client.delete_detector("pets")
        assert (missing.value.reason, missing.value.field) == ("DETECTOR_NOT_FOUND", "name")
        with pytest.raises(InvalidArgument) as unknown:
            robot.update(params=params("pets"))
        assert unknown.value.field == "params.detection.learned"
        # The name is free.
        assert upload(client, model=GRID, layout="fastest_det").layout == "fastest_det"
    server.kill()
    server.start()
    with Client(server.grpc) as client:
        assert [d.layout for d in client.detectors()] == ["fastest_det"]


def test_the_same_upload_again_is_no_error_and_another_is_refused(server):
    with Client(server.grpc) as client:
        first = upload(client)
        assert upload(client, model=YOLO.read_bytes()) == first
        for other in [{"labels": ["a", "b"]}, {"score_threshold": 0.1}, {"model": GRID, "layout": "fastest_det"}]:
            with pytest.raises(AlreadyExists) as error:
                upload(client, **other)
            assert (error.value.reason, error.value.field) == ("DETECTOR_EXISTS", "spec.name")
        assert client.detectors() == (first,)


def test_what_is_wrong_with_a_model_is_said_and_stops_nothing(server):
    data = YOLO.read_bytes()
    with Client(server.grpc) as client:
        for wrong, reason, field, words in [
            ({"model": b""}, "MODEL_INVALID", "model", "ONNX"),
            ({"model": data[: len(data) // 2]}, "MODEL_INVALID", "model", "ONNX"),
            ({"model": b"\xff" * 5000}, "MODEL_INVALID", "model", "ONNX"),
            ({"layout": "fastest_det"}, "MODEL_INVALID", "spec.layout", "1 x 6 x 16"),
            ({"labels": ["cat"]}, "MODEL_INVALID", "spec.labels", "2 classes"),
            ({"labels": []}, "OUT_OF_RANGE", "spec.labels", "1 to 1000"),
            ({"labels": ["cat", "a\nb"]}, "OUT_OF_RANGE", "spec.labels[1]", "control"),
            ({"name": "a/b"}, "ID_INVALID", "spec.name", "a-z"),
            ({"score_threshold": float("nan")}, "OUT_OF_RANGE", "spec.score_threshold", "0 to 1"),
            ({"iou_threshold": 1.5}, "OUT_OF_RANGE", "spec.iou_threshold", "0 to 1"),
            ({"image_input": ImageInput(scale=0.0)}, "OUT_OF_RANGE", "spec.input.scale", "above 0"),
            ({"layout": "unspecified"}, "ENUM_UNKNOWN", "spec.layout", "choose"),
        ]:
            with pytest.raises(InvalidArgument) as error:
                upload(client, **wrong)
            assert (error.value.reason, error.value.field) == (reason, field), wrong
            assert words in str(error.value), (wrong, str(error.value))
        assert client.detectors() == ()
        assert upload(client).name == "pets"


def test_models_are_bounded_in_bytes_and_number(tmp_path):
    size = YOLO.stat().st_size
    config = tmp_path / "percept.toml"
    limits = f"max_detectors_per_tenant = 2\nmax_detectors_bytes = {2 * size}\nmax_detector_bytes = {size}\n"
    config.write_text(f"[limits]\n{limits}")
    server = Server(tmp_path / "data", "--config", str(config))
    try:
        with Client(server.grpc) as client:
            with pytest.raises(ResourceExhausted) as error:
                upload(client, model=YOLO.read_bytes() + b"\0")
            assert (error.value.reason, error.value.field) == ("MODEL_TOO_LARGE", "model")
            upload(client, "a")
            upload(client, "b")
            with pytest.raises(ResourceExhausted) as error:
                upload(client, "c")
            assert error.value.reason == "TOO_MANY_DETECTORS"
            client.delete_detector("a")
            upload(client, "c")
            assert [d.name for d in client.detectors()] == ["b", "c"]
    finally:
        server.kill()


def keys(file, *arguments) -> dict:
    command = [binary(), "keys", "create", "--file", file, *arguments, "--json"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout)


def test_a_tenant_neither_sees_nor_uses_nor_deletes_anothers_models(tmp_path):
    file = tmp_path / "keys.json"

    def key(name, tenant, scope):
        return keys(file, "--name", name, "--tenant", tenant, "--scope", scope, "--sessions", f"{tenant}-*")["key"]

    ours, theirs = key("ana", "ours", "admin"), key("eve", "theirs", "admin")
    writer, reader = key("wim", "ours", "write"), key("rob", "ours", "read")
    config = tmp_path / "percept.toml"
    config.write_text(f'[auth]\nmode = "required"\nkeys_file = "{file}"\n')
    server = Server(tmp_path / "data", "--config", str(config), zenoh="")
    try:
        with Client(server.grpc, token=ours) as a, Client(server.grpc, token=theirs) as b:
            own = upload(a)
            assert own.uploaded_by == "ana"
            assert b.detectors() == ()
            with pytest.raises(NotFound):
                b.delete_detector("pets")
            with pytest.raises(NotFound):
                b.toolbox.detect_in_image("pets", np.zeros((8, 8, 3), np.uint8))
            with pytest.raises(InvalidArgument):
                b.sessions.create("theirs-1", params=params("pets"))
            # The same name is another model there.
            upload(b, model=GRID, layout="fastest_det")
            b.delete_detector("pets")
            assert a.detectors() == (own,)
            with Client(server.grpc, token=reader) as r, Client(server.grpc, token=writer) as w:
                assert r.detectors() == (own,)
                with pytest.raises(PermissionDenied):
                    upload(r, "more")
                assert upload(w, "more").uploaded_by == "wim"
                with pytest.raises(PermissionDenied):
                    w.delete_detector("more")
    finally:
        server.kill()


def test_over_rest(server):
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        spec = {"name": "pets", "layout": "DETECTOR_LAYOUT_YOLO_V8", "labels": LABELS}
        body = {"spec": spec, "model": base64.b64encode(YOLO.read_bytes()).decode()}
        sent = http.post("/v1/detectors", json=body)
        assert sent.status_code == 200, sent.text
        listed = http.get("/v1/detectors").json()["detectors"]
        assert listed == [sent.json()["detector"]]
        assert listed[0]["origin"] == "DETECTOR_ORIGIN_UPLOAD"
        refused = http.post("/v1/detectors", json=body | {"model": "AAAA"})
        assert (refused.status_code, refused.json()["reason"]) == (409, "DETECTOR_EXISTS")
        assert http.delete("/v1/detectors/pets").status_code == 200
        assert http.delete("/v1/detectors/pets").status_code == 404

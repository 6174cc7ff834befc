"""The client against the protos: nothing forgotten, nothing stale."""

import importlib.util
import pathlib
import subprocess
import sys

import pytest

from percept import _rpc, v1

SERVICES = ["sessions", "sensors", "maps", "scene", "navigation", "toolbox", "evaluation"]
GENERATE = pathlib.Path(__file__).resolve().parents[1] / "generate"


def test_every_call_of_the_contract_is_in_the_client():
    contract = {}
    for noun in SERVICES:
        module = importlib.import_module(f"percept.v1.{noun}_service_pb2")
        for service in module.DESCRIPTOR.services_by_name.values():
            for method in service.methods:
                path = f"/{service.full_name}/{method.name}"
                contract[path] = (method.input_type.full_name, method.output_type.full_name)
    ours = {
        call.path: (call.request.DESCRIPTOR.full_name, call.answer.DESCRIPTOR.full_name)
        for call in vars(_rpc).values()
        if isinstance(call, _rpc.Rpc)
    }
    assert ours == contract


def tools_installed():
    wanted = ("grpc_tools", "mypy_protobuf")
    return all(importlib.util.find_spec(name) is not None for name in wanted)


@pytest.mark.skipif(not tools_installed(), reason="the generator's tools are not installed")
def test_the_generated_code_is_that_of_the_protos(tmp_path):
    if not (GENERATE.parent.parent / "proto").is_dir():
        pytest.skip("no protos beside the client")
    subprocess.run([sys.executable, GENERATE, "--out", tmp_path], check=True)
    committed = pathlib.Path(v1.__file__).parent
    fresh = {p.name: p.read_text() for p in (tmp_path / "percept/v1").iterdir()}
    ours = {p.name: p.read_text() for p in committed.glob("*_pb2.py*") if p.suffix in (".py", ".pyi")}
    assert sorted(fresh) == sorted(ours)
    stale = [name for name in fresh if fresh[name] != ours[name]]
    assert not stale, "run client-py/generate"

"""The client against the protos: nothing forgotten. That nothing is stale, `generate --check` tells."""

import importlib

from percept import _rpc

SERVICES = ["sessions", "sensors", "maps", "scene", "navigation", "toolbox", "evaluation"]


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

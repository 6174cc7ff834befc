"""The client against the protos: nothing forgotten. That nothing is stale, `generate --check` tells."""

import importlib
import pkgutil

import percept.v1
from percept import _rpc

#: All that the contract has, but for what only operators ask.
MODULES = [m.name for m in pkgutil.iter_modules(percept.v1.__path__) if m.name.endswith("_service_pb2")]
MODULES.remove("server_service_pb2")


def test_every_call_of_the_contract_is_in_the_client():
    contract = {}
    for name in MODULES:
        module = importlib.import_module(f"percept.v1.{name}")
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

"""Registration."""

from __future__ import annotations

from ... import _rpc
from ..._call import Call
from ...types.toolbox import Registration, RegistrationOutcome
from ...v1 import toolbox_service_pb2 as service
from .. import geometry, words
from .request import Cloud, of, put_cloud


def register_clouds(
    source: Cloud, target: Cloud, **fields: object
) -> Call[service.RegisterCloudsRequest, service.RegisterCloudsResponse, Registration]:
    request = of(service.RegisterCloudsRequest, **fields)
    put_cloud(request, "source", source)
    put_cloud(request, "target", target)
    return Call(_rpc.REGISTER_CLOUDS, request, _registration)


def _registration(answer: service.RegisterCloudsResponse) -> Registration:
    return Registration(
        t_target_source=geometry.pose(answer.t_target_source),
        fitness=answer.fitness,
        rmse_m=answer.rmse_m,
        covariance=geometry.covariance(answer.covariance),
        iterations=answer.iterations,
        converged=answer.converged,
        outcome=words.word(RegistrationOutcome, service.RegistrationOutcome, answer.outcome),
        degenerate_axes=tuple(answer.degenerate_axes),
    )

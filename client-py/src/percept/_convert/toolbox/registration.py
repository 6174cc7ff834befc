"""Registration."""

from __future__ import annotations

from ... import _rpc
from ..._arrays import Array
from ..._call import Call
from ...types.geometry import Pose
from ...types.toolbox import Registration, RegistrationMethod
from ...v1 import toolbox_service_pb2 as service
from .. import geometry
from .request import Cloud, of, put_cloud


def register_clouds(
    source: Cloud,
    target: Cloud,
    initial_guess: Pose | Array | None,
    method: RegistrationMethod | str,
    max_distance_m: float | None,
    max_iterations: int | None,
) -> Call[service.RegisterCloudsRequest, service.RegisterCloudsResponse, Registration]:
    request = of(
        service.RegisterCloudsRequest,
        initial_guess=initial_guess,
        method=method,
        max_distance_m=max_distance_m,
        max_iterations=max_iterations,
    )
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
        degenerate_axes=tuple(answer.degenerate_axes),
    )

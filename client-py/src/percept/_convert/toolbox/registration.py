"""Registration."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._arrays import Array
from ..._call import Call
from ...types.toolbox import (
    GlobalRegistration,
    GlobalRegistrationOutcome,
    Registration,
    RegistrationOutcome,
)
from ...v1 import toolbox_registration_service_pb2 as registration_pb
from .. import geometry, words
from .request import Cloud, of, put_cloud, with_cloud


def register_clouds(
    source: Cloud, target: Cloud, **fields: object
) -> Call[registration_pb.RegisterCloudsRequest, registration_pb.RegisterCloudsResponse, Registration]:
    request = of(registration_pb.RegisterCloudsRequest, **fields)
    put_cloud(request, "source", source)
    put_cloud(request, "target", target)
    return Call(_rpc.REGISTER_CLOUDS, request, _registration)


def _registration(answer: registration_pb.RegisterCloudsResponse) -> Registration:
    return Registration(
        t_target_source=geometry.pose(answer.t_target_source),
        fitness=answer.fitness,
        rmse_m=answer.rmse_m,
        covariance=geometry.covariance(answer.covariance),
        iterations=answer.iterations,
        converged=answer.converged,
        outcome=words.word(RegistrationOutcome, registration_pb.RegistrationOutcome, answer.outcome),
        degenerate_axes=tuple(answer.degenerate_axes),
    )


def register_clouds_globally(
    source: Cloud, target: Cloud, **fields: object
) -> Call[
    registration_pb.RegisterCloudsGloballyRequest,
    registration_pb.RegisterCloudsGloballyResponse,
    GlobalRegistration,
]:
    request = of(registration_pb.RegisterCloudsGloballyRequest, **fields)
    put_cloud(request, "source", source)
    put_cloud(request, "target", target)
    return Call(_rpc.REGISTER_CLOUDS_GLOBALLY, request, global_registration)


def global_registration(answer: registration_pb.RegisterCloudsGloballyResponse) -> GlobalRegistration:
    """A registration with no first guess."""
    outcome = words.word(GlobalRegistrationOutcome, registration_pb.GlobalRegistrationOutcome, answer.outcome)
    return GlobalRegistration(
        outcome=outcome,
        t_target_source=geometry.pose(answer.t_target_source),
        covariance=geometry.covariance(answer.covariance),
        overlap=answer.overlap,
        rival_overlap=answer.rival_overlap,
        rmse_m=answer.rmse_m,
        num_pairs=answer.num_pairs,
        num_agreeing=answer.num_agreeing,
        degenerate_axes=tuple(answer.degenerate_axes),
        evidence=answer.evidence,
        rival_evidence=answer.rival_evidence,
    )


def compute_point_features(
    cloud: Cloud, **fields: object
) -> Call[registration_pb.ComputePointFeaturesRequest, registration_pb.ComputePointFeaturesResponse, Array]:
    def read(answer: registration_pb.ComputePointFeaturesResponse) -> Array:
        return np.frombuffer(answer.features, "<f4").reshape(-1, 33)

    return Call(
        _rpc.COMPUTE_POINT_FEATURES,
        with_cloud(registration_pb.ComputePointFeaturesRequest, cloud, **fields),
        read,
    )

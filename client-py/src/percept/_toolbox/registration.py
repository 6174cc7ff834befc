"""Two clouds to a transform."""

from __future__ import annotations

from .._arrays import Array
from .._convert.toolbox import registration as convert
from .._convert.toolbox.request import Cloud
from ..types.geometry import Pose
from ..types.toolbox import Registration, RegistrationMethod
from ._base import Async, Sync


class RegistrationCalls(Sync):
    """How one cloud lies over another."""

    def register_clouds(
        self,
        source: Cloud,
        *,
        target: Cloud,
        initial_guess: Pose | Array | None = None,
        method: RegistrationMethod | str = RegistrationMethod.POINT_TO_PLANE,
        max_distance_m: float | None = None,
        max_iterations: int | None = None,
    ) -> Registration:
        """Lays source over target (ICP), starting from t_target_source = initial_guess; pairs further apart
        than max_distance_m do not count."""
        call = convert.register_clouds(source, target, initial_guess, method, max_distance_m, max_iterations)
        return self._transport.call(call)


class AsyncRegistrationCalls(Async):
    """How one cloud lies over another."""

    async def register_clouds(
        self,
        source: Cloud,
        *,
        target: Cloud,
        initial_guess: Pose | Array | None = None,
        method: RegistrationMethod | str = RegistrationMethod.POINT_TO_PLANE,
        max_distance_m: float | None = None,
        max_iterations: int | None = None,
    ) -> Registration:
        """Lays source over target (ICP), starting from t_target_source = initial_guess; pairs further apart
        than max_distance_m do not count."""
        call = convert.register_clouds(source, target, initial_guess, method, max_distance_m, max_iterations)
        return await self._transport.call(call)

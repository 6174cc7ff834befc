# Written by client-py/generate from _async/toolbox/registration.py; change that.
"""Two clouds to a transform."""

from __future__ import annotations

from collections.abc import Sequence

from ..._arrays import Array
from ..._convert.toolbox import registration as convert
from ..._convert.toolbox.request import Cloud
from ...types.geometry import Pose
from ...types.toolbox import (
    GlobalRegistration,
    GlobalRegistrationMethod,
    Registration,
    RegistrationMethod,
    RobustKernel,
)
from ..bound import Bound
from ..operations import Operation, started


class RegistrationCalls(Bound):
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
        voxel_sizes_m: Sequence[float] = (),
        kernel: RobustKernel | str = RobustKernel.NONE,
        kernel_scale_m: float | None = None,
        translation_tolerance_m: float | None = None,
        rotation_tolerance_rad: float | None = None,
        num_neighbours: int | None = None,
        target_voxel_size_m: float | None = None,
        colour_share: float | None = None,
        tangent_weight: float | None = None,
        degeneracy_threshold: float | None = None,
    ) -> Registration:
        """Lays source over target, starting from t_target_source = initial_guess (identity).

        Pairs further apart than max_distance_m (0.02) do not count. voxel_sizes_m thins both clouds, coarse
        to fine. kernel_scale_m is where the kernel begins to bend. Normals come from num_neighbours (20)
        points; target_voxel_size_m (1) is for vgicp, colour_share (0.032) for coloured, tangent_weight (0)
        for point_to_plane.
        """
        call = convert.register_clouds(
            source,
            target,
            initial_guess=initial_guess,
            method=method,
            max_distance_m=max_distance_m,
            max_iterations=max_iterations,
            voxel_sizes_m=voxel_sizes_m,
            kernel=kernel,
            kernel_scale_m=kernel_scale_m,
            translation_tolerance_m=translation_tolerance_m,
            rotation_tolerance_rad=rotation_tolerance_rad,
            num_neighbours=num_neighbours,
            target_voxel_size_m=target_voxel_size_m,
            colour_share=colour_share,
            tangent_weight=tangent_weight,
            degeneracy_threshold=degeneracy_threshold,
        )
        return self._transport.call(call)

    def register_clouds_globally(
        self,
        source: Cloud,
        *,
        target: Cloud,
        voxel_size_m: float | None = None,
        method: GlobalRegistrationMethod | str = GlobalRegistrationMethod.CONSISTENCY,
        refine: bool | None = None,
        max_iterations: int | None = None,
        seed: int = 0,
    ) -> GlobalRegistration:
        """Lays source over target from anywhere, with no guess; believe it only if its outcome is FOUND.

        Both clouds are thinned to voxel_size_m (0.05; 0.5 for outdoor lidars), with which all else scales.
        max_iterations (100000) is for ransac.
        """
        call = convert.register_clouds_globally(
            source,
            target,
            voxel_size_m=voxel_size_m,
            method=method,
            refine=refine,
            max_iterations=max_iterations,
            seed=seed,
        )
        return self._transport.call(call)

    def start_register_clouds_globally(
        self,
        source: Cloud,
        *,
        target: Cloud,
        voxel_size_m: float | None = None,
        method: GlobalRegistrationMethod | str = GlobalRegistrationMethod.CONSISTENCY,
        refine: bool | None = None,
        max_iterations: int | None = None,
        seed: int = 0,
        request_id: str | None = None,
    ) -> Operation[GlobalRegistration]:
        """register_clouds_globally() as an operation, which goes on whoever hangs up: wait() for it, and
        read its result(). The same request_id gives the same operation."""
        call = convert.register_clouds_globally(
            source,
            target,
            voxel_size_m=voxel_size_m,
            method=method,
            refine=refine,
            max_iterations=max_iterations,
            seed=seed,
        )
        return started(self._transport, call, request_id)

    def compute_point_features(
        self, cloud: Cloud, *, radius_m: float | None = None, max_neighbours: int | None = None
    ) -> Array:
        """FPFH of every point, (N, 33) float32, from neighbours within radius_m (0.25), at most
        max_neighbours (100; 0: all); zeros for points without neighbours."""
        call = convert.compute_point_features(cloud, radius_m=radius_m, max_neighbours=max_neighbours)
        return self._transport.call(call)

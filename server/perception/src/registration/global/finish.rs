//! The last refinement of an answer that is already near.

use super::super::{IcpMethod, IcpParams, RegisterParams, RobustKernel, register};
use super::{GlobalOutcome, GlobalResult};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

/// Voxels of the refinement, and how far apart its pairs may be, voxels of the search.
const FINER: f64 = 0.5;
const REACH: f64 = 2.0;
/// A kernel much narrower than the reach: with plain squares there is a second minimum about a degree off, where the
/// rings of one scan come to lie on those of the other.
const KERNEL: f64 = 0.2;
/// The refinement may move the answer by so many voxels and radians, or it went elsewhere; more for one that is believed,
/// where more has to speak for it then.
const MOST: (f64, f64) = (1.0, 0.05);
const MOST_BELIEVED: (f64, f64) = (4.0, 0.1);

/// The answer aligned by planes on voxels half as large, unless that leads away from it.
pub(super) fn finish(answer: GlobalResult, source: &PointCloud, target: &PointCloud, size: f64) -> GlobalResult {
    let finite = |cloud: &PointCloud| -> Vec<_> {
        cloud.positions.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())).collect()
    };
    if answer.outcome == GlobalOutcome::NotFound {
        return answer;
    }
    let icp = IcpParams {
        max_distance_m: REACH * size,
        max_iterations: 50,
        translation_tolerance_m: 1e-3 * size,
        rotation_tolerance_rad: 1e-4,
        num_neighbours: 20,
        tangent_weight: 0.0,
        kernel: RobustKernel::Cauchy(KERNEL * size),
        ..IcpParams::lidar(IcpMethod::PointToPlane)
    };
    let fine = RegisterParams { voxel_sizes_m: vec![FINER * size], icp };
    let (source, target) = (PointCloud::from_positions(finite(source)), PointCloud::from_positions(finite(target)));
    let Ok(found) = register(&source, &target, &answer.t_target_source, &fine) else { return answer };
    let sum: Vector3<f64> = source.positions.iter().map(|p| p.coords.cast::<f64>()).sum();
    let center = Point3::from(sum / source.len().max(1) as f64);
    let moved = (found.t_target_source * center - answer.t_target_source * center).norm();
    let turned = found.t_target_source.rotation.angle_to(&answer.t_target_source.rotation);
    let most = if answer.outcome == GlobalOutcome::Found { MOST_BELIEVED } else { MOST };
    if moved > most.0 * size || turned > most.1 {
        return answer;
    }
    GlobalResult {
        t_target_source: found.t_target_source,
        covariance: found.covariance,
        degenerate_axes: found.degenerate_axes,
        ..answer
    }
}

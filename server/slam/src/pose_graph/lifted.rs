//! Planar graphs lifted into space, where local minima of the plane open.

use super::{Edge, Equations, Manifold, OptimiseParams, PoseGraph, PoseGraphError, Structure};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Tilts at the start are up to this, radians: enough to leave a minimum of the plane, which is a saddle in space. Ten
/// degrees. Halved and doubled, the same minima are found (`evaluate graph MIT.g2o noise=0.2 seeds=4` and `intel.g2o
/// noise=0.1 seeds=2`).
const TILT: f64 = 0.17;
/// Steps of one try at most. Halved and doubled, the same minima are found (`evaluate graph MIT.g2o noise=0.2 seeds=4`
/// and `intel.g2o noise=0.1 seeds=2`).
const STEPS: usize = 100;
/// Planes that it is laid into, the first the one that fits best. Halved and doubled, the same minima are found, in
/// half and twice the steps (`evaluate graph MIT.g2o noise=0.2 seeds=4` and `intel.g2o noise=0.1 seeds=2`).
const VIEWS: usize = 8;
/// The minimum in space need not be known better to be laid back into the plane. As two minima are told apart (`SAME`).
const TOLERANCE: f64 = 1e-5;

/// Starts from the minimum that the graph's poses lead to in space, laid into the plane that has most of it, and into those
/// in which nodes drawn at random lie. None if the graph is in space already, or holds several nodes.
///
/// A heading becomes any rotation, of which the first two columns count. This is the second step of the staircase by
/// which SE-Sync climbs to its convex relaxation: minima of the plane that are not the least seldom are minima there.
///
/// Source: Rosen et al., "SE-Sync: a certifiably correct algorithm for synchronization over the special Euclidean
/// group", 2019 (Riemannian staircase, rounding); Boumal, "A Riemannian low-rank method for optimization over semidefinite
/// matrices with block-diagonal constraints", 2015. There, squares of distances between columns are weighed; they are
/// those of a quaternion's vector part, of which x and y count half as much as z, so that it is a pose graph again. Planes
/// at random: after Goemans and Williamson, "Improved approximation algorithms for maximum cut and satisfiability
/// problems using semidefinite programming", 1995. Of 16 made graphs of 800 and 1,500 poses with 0.3 rad of noise, 9 end
/// within 0.1 % of where the true poses lead without space, 11 by the plane that has most of it, 12 by 8 planes; the worst
/// are 33, 33 and 8 % above. 16 planes, and twice as many lifts, lead to no more than one further.
///
/// # Errors
/// `NotSolvable`.
pub(super) fn from_space<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    structure: &Structure,
    seed: u64,
) -> Result<Vec<Vec<P>>, PoseGraphError> {
    let [fixed] = graph.fixed[..] else { return Ok(vec![]) };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut tilted = |p: &P| {
        let mut tilt = || TILT * rng.random_range(-1.0..1.0);
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(tilt(), tilt(), 0.0));
        lift(p) * Pose::from_parts(Vector3::zeros().into(), tilt)
    };
    let poses = graph.poses.iter().map(&mut tilted).collect();
    let lifted = |e: &Edge<P, D>| {
        let information = P::lifted_information(&e.information)?;
        Some(Edge { from: e.from, to: e.to, t_from_to: lift(&e.t_from_to), information })
    };
    let Some(edges) = graph.edges.iter().map(lifted).collect() else { return Ok(vec![]) };
    let mut lifted = PoseGraph::<Pose, 6> { poses, edges, fixed: graph.fixed.clone() };
    let params = OptimiseParams { max_iterations: STEPS, tolerance: TOLERANCE };
    Equations::of(&lifted, structure)?.optimise(&mut lifted, &params)?;
    let mut views = vec![normal_of(&lifted.poses)];
    views.extend((1..VIEWS).map(|_| column(&lifted.poses[rng.random_range(0..lifted.poses.len())], Vector3::z())));
    let laid_flat = |normal: &Vector3<f64>| {
        let flat = UnitQuaternion::rotation_between(normal, &Vector3::z());
        // Upside down is half a turn about any axis of the plane.
        let flat = flat.unwrap_or(UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI));
        let lower =
            |p: &Pose| lower::<P, D>(&Pose::from_parts((flat * p.translation.vector).into(), flat * p.rotation));
        let to_fixed = graph.poses[fixed as usize].compose(&lower(&lifted.poses[fixed as usize]).inverse());
        lifted.poses.iter().map(|p| to_fixed.compose(&lower(p))).collect()
    };
    Ok(views.iter().map(laid_flat).collect())
}

fn column(p: &Pose, axis: Vector3<f64>) -> Vector3<f64> {
    p.rotation * axis
}

/// Normal of the plane that has most of the first two columns, to the side from where most poses turn as in the plane.
fn normal_of(poses: &[Pose]) -> Vector3<f64> {
    let mut spread = Matrix3::zeros();
    for (p, axis) in poses.iter().flat_map(|p| [(p, Vector3::x()), (p, Vector3::y())]) {
        spread += column(p, axis) * column(p, axis).transpose();
    }
    let eigen = spread.symmetric_eigen();
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let up: f64 = poses.iter().map(|p| column(p, Vector3::z()).dot(&normal)).sum();
    normal * up.signum()
}

fn lift<P: Manifold<D>, const D: usize>(p: &P) -> Pose {
    Manifold::from_parts(&p.rotation(), &p.position())
}

/// The planar rotation nearest to the rotation's part in the plane.
fn lower<P: Manifold<D>, const D: usize>(p: &Pose) -> P {
    let r = Manifold::rotation(p);
    let yaw = (r[(1, 0)] - r[(0, 1)]).atan2(r[(0, 0)] + r[(1, 1)]);
    let position = p.translation.vector;
    P::from_parts(
        &Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).into_inner(),
        &Vector3::new(position.x, position.y, 0.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_graph::{PlanarPose, optimise};

    fn starts<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>) -> Vec<Vec<P>> {
        from_space(graph, &Structure::of(graph).unwrap(), 0).unwrap()
    }

    /// Poses in one place, each measured to look where the one before does, all around: the last is the first's neighbour.
    /// They look once around, which no small turn makes better.
    fn wound(n: u32) -> PoseGraph<PlanarPose, 3> {
        let poses = (0..n)
            .map(|k| PlanarPose { yaw: std::f64::consts::TAU * f64::from(k) / f64::from(n), ..PlanarPose::identity() });
        let edge =
            |k| Edge { from: k, to: (k + 1) % n, t_from_to: PlanarPose::identity(), information: Matrix3::identity() };
        let poses = poses.map(|p| PlanarPose::identity().compose(&p)).collect();
        PoseGraph { poses, edges: (0..n).map(edge).collect(), fixed: vec![0] }
    }

    #[test]
    fn what_is_wound_up_in_the_plane_unwinds_in_space() {
        let mut graph = wound(20);
        let stuck = optimise(&mut graph, &OptimiseParams::default()).unwrap();
        assert!(stuck.converged && stuck.chi2 > 1.9, "{stuck:?}");
        graph.poses = starts(&graph).swap_remove(0);
        let free = optimise(&mut graph, &OptimiseParams::default()).unwrap();
        assert!(free.chi2 < 1e-9, "{free:?}");
    }

    #[test]
    fn a_graph_in_space_is_not_lifted() {
        let edge = Edge { from: 0, to: 1, t_from_to: Pose::identity(), information: nalgebra::Matrix6::identity() };
        let graph = PoseGraph { poses: vec![Pose::identity(); 2], edges: vec![edge], fixed: vec![0] };
        assert!(starts(&graph).is_empty());
    }
}

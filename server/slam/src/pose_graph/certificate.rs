//! A proof that no other poses explain the measurements better.

use super::sparse::Solver;
use super::{Edge, Manifold, PoseGraph, Structure};
use nalgebra::{Matrix3, Matrix4};

/// Whether it is proven that no poses have a lower chi2 than the graph's, which have to be a minimum. False says
/// nothing: where measurements err a lot there may be no proof.
///
/// The sum of the edges' minorants at these poses is a problem whose dual is known from them in closed form. They are its
/// best poses, and so the graph's, if the dual's matrix is positive semi-definite, of which one Cholesky factorisation
/// decides.
///
/// Source: Carlone et al., "Lagrangian duality in 3D SLAM: verification techniques and optimal solutions", 2015; Rosen
/// et al., "SE-Sync: a certifiably correct algorithm for synchronization over the special Euclidean group", 2019. They
/// have one weight for turns and one for shifts, and the sine's square for planar headings; minorants are ours.
pub(super) fn is_certified<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>, structure: &Structure) -> bool {
    let Structure { unknowns, pattern } = structure;
    // With several held nodes the whole may not be turned, which the proof needs.
    if graph.fixed.len() != 1 {
        return false;
    }
    let mut blocks = vec![Matrix4::zeros(); pattern.num_blocks()];
    let mut pulls = vec![Matrix3::<f64>::zeros(); graph.poses.len()];
    let rotations: Vec<Matrix3<f64>> = graph.poses.iter().map(P::rotation).collect();
    let whole = |node: u32| {
        let (r, t) = (&rotations[node as usize], graph.poses[node as usize].position());
        nalgebra::Matrix3x4::from_columns(&[r.column(0).into(), r.column(1).into(), r.column(2).into(), t])
    };
    for e in &graph.edges {
        let Edge { from, to, .. } = *e;
        let Some(m) = P::minorant(e, &graph.poses[from as usize], &graph.poses[to as usize]) else { return false };
        let (a, b) = (whole(from), whole(to));
        pulls[from as usize] += (a * m.from + b * m.between.transpose()).fixed_columns::<3>(0);
        pulls[to as usize] += (b * m.to + a * m.between).fixed_columns::<3>(0);
        let (place_from, place_to) = unknowns.ends(e);
        if let Some(place) = place_from {
            blocks[pattern.diagonal(place)] += m.from;
        }
        if let Some(place) = place_to {
            blocks[pattern.diagonal(place)] += m.to;
        }
        if let Some((block, from_is_row)) = place_from.zip(place_to).and_then(|(a, b)| pattern.block(a, b)) {
            blocks[block] += if from_is_row { m.between } else { m.between.transpose() };
        }
    }
    for (place, &node) in (0..).zip(&unknowns.nodes) {
        let multiplier = rotations[node as usize].transpose() * pulls[node as usize];
        let mut own = blocks[pattern.diagonal(place)].fixed_view_mut::<3, 3>(0, 0);
        own -= (multiplier + multiplier.transpose()) * 0.5;
        if P::IS_PLANAR {
            // The third axis takes no part.
            own[(2, 2)] = 1.0;
        }
    }
    Solver::<4>::new(pattern).is_ok_and(|mut solver| solver.factorise(&blocks, 0.0).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_graph::{OptimiseParams, PlanarPose, optimise};
    use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
    use percept_geometry::Pose;
    use proptest::prelude::*;

    /// By how much chi2 lies above the minorant of an edge that touches it at `touched`, at other poses.
    fn above<P: Manifold<D>, const D: usize>(edge: &Edge<P, D>, touched: &[P; 2], other: &[P; 2]) -> f64 {
        let m = P::minorant(edge, &touched[0], &touched[1]).unwrap();
        let columns = |p: &P| {
            let (r, t) = (p.rotation(), p.position());
            nalgebra::Matrix3x4::from_fn(|i, j| if j < 3 { r[(i, j)] } else { t[i] })
        };
        let form = |poses: &[P; 2]| {
            let (a, b) = (columns(&poses[0]), columns(&poses[1]));
            let own = (a * m.from * a.transpose() + b * m.to * b.transpose()).trace();
            own + 2.0 * (a * m.between * b.transpose()).trace()
        };
        let chi2 = |poses: &[P; 2]| {
            let e = P::error(&edge.t_from_to, &poses[0], &poses[1]);
            e.dot(&(edge.information * e))
        };
        (chi2(other) - form(other)) - (chi2(touched) - form(touched))
    }

    fn planar() -> impl Strategy<Value = PlanarPose> {
        (-3.0..3.0f64, -3.0..3.0f64, -3.1..3.1f64).prop_map(|(x, y, yaw)| PlanarPose { x, y, yaw })
    }

    fn spatial() -> impl Strategy<Value = Pose> {
        let three = || prop::array::uniform3(-2.0..2.0f64);
        (three(), three()).prop_map(|(t, w)| {
            Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(w)))
        })
    }

    proptest! {
        #[test]
        fn a_planar_minorant_is_nowhere_above_chi2(
            poses in prop::array::uniform5(planar()),
            root in prop::array::uniform9(-1.0..1.0f64),
        ) {
            let root = Matrix3::from_column_slice(&root) + Matrix3::identity() * 3.0;
            let edge = Edge { from: 0, to: 1, t_from_to: poses[0], information: root * root.transpose() };
            // Far enough from the seam of the angle for its share that the rest of the information moves.
            let touched = [poses[1], poses[2]];
            prop_assume!(PlanarPose::error(&poses[0], &touched[0], &touched[1])[2].abs() < 1.0);
            prop_assume!(PlanarPose::minorant(&edge, &touched[0], &touched[1]).is_some());
            prop_assert!(above(&edge, &touched, &[poses[3], poses[4]]) > -1e-6);
        }

        #[test]
        fn a_spatial_minorant_is_nowhere_above_chi2(
            poses in prop::array::uniform5(spatial()),
            roots in prop::array::uniform2(prop::array::uniform9(-1.0..1.0f64)),
        ) {
            let mut information = Matrix6::zeros();
            for (k, root) in roots.iter().enumerate() {
                let root = Matrix3::from_column_slice(root);
                information.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(&(root * root.transpose()));
            }
            let edge = Edge { from: 0, to: 1, t_from_to: poses[0], information };
            prop_assert!(above(&edge, &[poses[1], poses[2]], &[poses[3], poses[4]]) > -1e-9);
        }
    }

    /// Poses around a square with a measurement back to the first, turned by `noise` radians each.
    fn square(noise: f64, information: Matrix6<f64>) -> PoseGraph<Pose, 6> {
        let turn = |k: u32| Vector3::new(noise * f64::from(k).sin(), noise * f64::from(k * k).cos(), 1.57);
        let step = |k: u32| {
            let t = Vector3::new(1.0, 0.1 * noise * f64::from(k), 0.0);
            Pose::from_parts(t.into(), UnitQuaternion::from_scaled_axis(turn(k)))
        };
        let edge = |k: u32| Edge { from: k, to: (k + 1) % 4, t_from_to: step(k), information };
        let mut poses = vec![Pose::identity()];
        (0..3).for_each(|k| poses.push(poses[k as usize] * step(k)));
        PoseGraph { poses, edges: (0..4).map(edge).collect(), fixed: vec![0] }
    }

    fn proven<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>) -> bool {
        is_certified(graph, &Structure::of(graph).unwrap())
    }

    #[test]
    fn small_errors_in_space_are_proven_to_be_the_least() {
        let information = Matrix6::from_diagonal(&Vector6::new(10.0, 20.0, 30.0, 400.0, 300.0, 200.0));
        let mut graph = square(0.1, information);
        optimise(&mut graph, &OptimiseParams::default()).unwrap();
        assert!(graph.chi2() > 1e-3 && proven(&graph));
    }

    #[test]
    fn a_minimum_that_is_not_the_least_is_not_proven() {
        let n = 20u32;
        let poses =
            (0..n).map(|k| PlanarPose { x: 0.0, y: 0.0, yaw: std::f64::consts::TAU * f64::from(k) / f64::from(n) });
        let edge = |k: u32| Edge {
            from: k,
            to: (k + 1) % n,
            t_from_to: PlanarPose::identity(),
            information: Matrix3::identity(),
        };
        let mut graph = PoseGraph { poses: poses.collect(), edges: (0..n).map(edge).collect(), fixed: vec![0] };
        assert!(!proven(&graph));
        graph.poses = vec![PlanarPose::identity(); n as usize];
        assert!(proven(&graph));
    }

    #[test]
    fn with_two_held_nodes_nothing_is_certified() {
        let mut graph = square(0.0, Matrix6::identity());
        assert!(proven(&graph));
        graph.fixed.push(2);
        assert!(!proven(&graph));
    }
}

//! Poses to start from, found from the measurements alone.

use super::pattern::NotSolvable;
use super::pattern::Pattern;
use super::sparse::Solver;
use super::{Manifold, PoseGraph, PoseGraphError, Structure, Unknowns};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Newton's steps to a polar factor; from a matrix that is nearly a rotation it takes four or five. It converges
/// quadratically: twice what it takes is enough.
const MOST_POLAR_STEPS: usize = 12;

/// Rotations by relaxing them to any matrices, then positions by least squares; no guess is needed. Fixed nodes stay.
///
/// Source: Carlone et al., "Initialization techniques for 3D SLAM: a survey on rotation estimation and its use in pose
/// graph optimization", 2015 (chordal relaxation, after Martinec and Pajdla 2007).
///
/// # Errors
/// As [`PoseGraph::validate`]; `NotSolvable` if measurements without information are all that holds a node.
pub fn chordal<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>) -> Result<Vec<P>, PoseGraphError> {
    let structure = Structure::of(graph)?;
    Ok(chordal_of(graph, &structure)?)
}

/// [`chordal`] of a graph of this structure.
pub(super) fn chordal_of<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    structure: &Structure,
) -> Result<Vec<P>, NotSolvable> {
    let Structure { unknowns, pattern } = structure;
    let mut poses = graph.poses.clone();
    if unknowns.nodes.is_empty() {
        return Ok(poses);
    }
    let rotations = rotations(graph, unknowns, pattern)?;
    let positions = positions(graph, unknowns, pattern, &rotations)?;
    for &node in &unknowns.nodes {
        poses[node as usize] = P::from_parts(&rotations[node as usize], &positions[node as usize]);
    }
    Ok(poses)
}

fn rotations<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    unknowns: &Unknowns,
    pattern: &Pattern,
) -> Result<Vec<Matrix3<f64>>, NotSolvable> {
    let mut rotations: Vec<Matrix3<f64>> = graph.poses.iter().map(P::rotation).collect();
    let mut solver = Solver::<3>::new(pattern)?;
    let mut blocks = vec![Matrix3::zeros(); pattern.num_blocks()];
    // The rotations' transposes: their columns do not depend on each other.
    let mut x = vec![Matrix3::zeros(); unknowns.nodes.len()];
    for e in &graph.edges {
        let z = e.t_from_to.rotation();
        let weight = P::turn_information(&e.information);
        let ends = unknowns.ends(e);
        for place in [ends.0, ends.1].into_iter().flatten() {
            blocks[pattern.diagonal(place)] += Matrix3::identity() * weight;
        }
        match ends {
            (None, Some(to)) => x[to as usize] += z.transpose() * rotations[e.from as usize].transpose() * weight,
            (Some(from), None) => x[from as usize] += z * rotations[e.to as usize].transpose() * weight,
            (Some(from), Some(to)) => {
                if let Some((block, from_is_row)) = pattern.block(from, to) {
                    blocks[block] -= if from_is_row { z } else { z.transpose() } * weight;
                }
            }
            (None, None) => {}
        }
    }
    solver.factorise(&blocks, 0.0)?;
    solver.solve(&mut x);
    unknowns.nodes.iter().zip(&x).for_each(|(&node, x)| rotations[node as usize] = nearest_rotation(&x.transpose()));
    Ok(rotations)
}

/// The rotation nearest to a matrix, by Newton's iteration for its polar factor (Higham 1986) or, if it turns space inside
/// out, by its singular vectors.
fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let mut x = m / m.determinant().abs().cbrt();
    for _ in 0..MOST_POLAR_STEPS {
        let (a, b, c) = (x.column(0), x.column(1), x.column(2));
        let cofactors = Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)]);
        let determinant = a.dot(&cofactors.column(0));
        if determinant.is_nan() || determinant <= 0.0 {
            break;
        }
        let next = (x + cofactors / determinant) * 0.5;
        // What a step this small leaves is its square.
        if (next - x).amax() < 1e-9 {
            return next;
        }
        x = next;
    }
    let svd = m.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else { return Matrix3::identity() };
    let sign = (u * vt).determinant().signum();
    u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * vt
}

fn positions<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    unknowns: &Unknowns,
    pattern: &Pattern,
    rotations: &[Matrix3<f64>],
) -> Result<Vec<Vector3<f64>>, NotSolvable> {
    let mut positions: Vec<Vector3<f64>> = graph.poses.iter().map(P::position).collect();
    let mut solver = Solver::<1>::new(pattern)?;
    let mut blocks = vec![SMatrix::<f64, 1, 1>::zeros(); pattern.num_blocks()];
    let mut x = vec![SMatrix::<f64, 1, 3>::zeros(); unknowns.nodes.len()];
    for e in &graph.edges {
        let apart = rotations[e.from as usize] * e.t_from_to.position();
        let weight = P::shift_information(&e.information);
        let (from, to) = unknowns.ends(e);
        for (own, other, other_node, sign) in [(from, to, e.to, -1.0), (to, from, e.from, 1.0)] {
            let Some(own) = own else { continue };
            blocks[pattern.diagonal(own)][0] += weight;
            let known = if other.is_none() { positions[other_node as usize] } else { Vector3::zeros() };
            x[own as usize] += ((apart * sign + known) * weight).transpose();
        }
        if let Some((block, _)) = from.zip(to).and_then(|(a, b)| pattern.block(a, b)) {
            blocks[block][0] -= weight;
        }
    }
    solver.factorise(&blocks, 0.0)?;
    solver.solve(&mut x);
    unknowns.nodes.iter().zip(&x).for_each(|(&node, x)| positions[node as usize] = x.transpose());
    Ok(positions)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_rotation_is_nearer_than_the_nearest(m in prop::array::uniform9(-1.0..1.0f64), w in prop::array::uniform3(-0.1..0.1f64)) {
            let m = Matrix3::from_column_slice(&m);
            let found = nearest_rotation(&m);
            prop_assert!((found * found.transpose() - Matrix3::identity()).amax() < 1e-9);
            prop_assert!((found.determinant() - 1.0).abs() < 1e-9);
            let other = found * Rotation3::new(Vector3::from(w)).into_inner();
            prop_assert!((m - found).norm() < (m - other).norm() + 1e-9);
        }
    }
}

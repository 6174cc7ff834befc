//! How far off an answer may be.

use super::patches::Patches;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use percept_geometry::{Covariance6, Pose, se3};
use rustc_hash::FxHashMap;

/// Surface within a block of so many voxels that faces one way errs together.
const BLOCK: f64 = 16.0;
/// Residuals fade beyond this share of a voxel, as in the refinement.
const KERNEL: f64 = 0.2;
/// Where most residuals are beyond the kernel, their mean slope says no more.
const LEAST_SLOPE: f64 = 0.2;
/// Fewer blocks say nothing of their scatter: twice the unknowns.
const FEWEST_BLOCKS: usize = 12;

/// Sums over a block: of weighted rows, of weighted residuals, of weights.
#[derive(Clone, Copy, Default)]
struct Block {
    /// Of the target's, the one that it faces most.
    axis: usize,
    rows: Vector6<f64>,
    residuals: f64,
    weights: f64,
}

/// Variance of the offsets of blocks that face one axis, square metres: a level floor says nothing of how far walls are off. Zero
/// where they are too few to tell.
fn scatter_along(blocks: &[Block], axis: usize) -> f64 {
    let facing = || blocks.iter().filter(|b| b.axis == axis);
    let (num, weights) = (facing().count() as f64, facing().map(|b| b.weights).sum::<f64>());
    let squares: f64 = facing().map(|b| b.residuals * b.residuals / b.weights).sum();
    // Of the six unknowns it holds two.
    if facing().count() < FEWEST_BLOCKS / 2 { 0.0 } else { squares / weights * num / (num - 2.0) }
}

/// 6x6 of an answer, right perturbation in the source frame; none where too little coincides.
///
/// A wall that bends, a side that only one cloud saw, what grew, how a map drifted while it was gathered: points of one
/// surface err together, and counted as independent they promise millimetres where centimetres are true. So each block of
/// surface is given an offset along its normal. Their variance is one for all blocks, or more for those that face one way: a
/// direction that a single one holds is no more certain than that one is, although nothing there contradicts it.
///
/// Source: the variance-component model of Laird and Ware, "Random-effects models for longitudinal data", 1982, with the
/// covariance of the ordinary estimate under it, `H^-1 (sum of s s') H^-1 tau^2`.
pub(super) fn covariance(source: &Patches, target: &Patches, t_target_source: &Pose, size: f64) -> Option<Covariance6> {
    let points = source.points();
    let center = points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let (mut slope, mut all) = (0.0, 0.0);
    let mut hessian = Matrix6::zeros();
    let mut ids: FxHashMap<([i64; 3], usize), usize> = FxHashMap::default();
    let mut blocks: Vec<Block> = Vec::new();
    for (p, n) in (0..source.len()).flat_map(|patch| source.of(patch)) {
        let p = p.cast::<f64>();
        let at = t_target_source * p;
        let faces = (t_target_source.rotation * n.cast::<f64>()).cast();
        let Some(j) = target.partner(&at.cast(), &faces) else { continue };
        let (q, normal): (Point3<f64>, Vector3<f64>) = (target.points()[j].cast(), target.normal(j).cast());
        let residual = normal.dot(&(at - q));
        let weight = 1.0 / (1.0 + (residual / (KERNEL * size)).powi(2));
        // A residual beyond the kernel pulls less the farther it is: moved, it gives way.
        slope += weight * (2.0 * weight - 1.0);
        all += weight;
        let place = [q.x, q.y, q.z].map(|v| (v / (BLOCK * size)).floor() as i64);
        // The side of a normal is arbitrary; an offset needs one.
        let axis = normal.abs().imax();
        let side = normal[axis].signum();
        let n = t_target_source.rotation.inverse() * normal * side;
        let turn = (p.coords - center).cross(&n);
        let row = Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z);
        hessian += row * row.transpose() * weight;
        let id = *ids.entry((place, axis)).or_insert(blocks.len());
        if id == blocks.len() {
            blocks.push(Block { axis, ..Block::default() });
        }
        let block = &mut blocks[id];
        block.rows += row * weight;
        block.residuals += side * residual * weight;
        block.weights += weight;
    }
    let num_blocks = blocks.len() as f64;
    if blocks.len() < FEWEST_BLOCKS {
        return None;
    }
    // Blocks by what they weigh: one of a few points says little of offsets. Six of them went into the answer.
    let weights: f64 = blocks.iter().map(|b| b.weights).sum();
    let squares: f64 = blocks.iter().map(|b| b.residuals * b.residuals / b.weights).sum();
    let of_all = squares / weights * num_blocks / (num_blocks - 6.0);
    let variance = [0, 1, 2].map(|axis| of_all.max(scatter_along(&blocks, axis)));
    let scatter: Matrix6<f64> = blocks.iter().map(|b| b.rows * b.rows.transpose() * variance[b.axis]).sum();
    // Huber and Ronchetti, "Robust Statistics", 2009, section 7.6: what a step of the pulls moves is by their mean slope.
    let inverse = hessian.cholesky()?.inverse() / (slope / all).clamp(LEAST_SLOPE, 1.0);
    let centered = inverse * scatter * inverse;
    // Turning about the centroid is turning about the origin and a shift.
    let mut shift = Matrix6::identity();
    shift.fixed_view_mut::<3, 3>(0, 3).copy_from(&se3::skew(&center));
    let out = shift * centered * shift.transpose();
    out.iter().all(|v| v.is_finite()).then_some(out)
}

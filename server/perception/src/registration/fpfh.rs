//! Fast point feature histograms.

use crate::search::{KdTree, Neighbors};
use nalgebra::{Point3, Vector3};
use percept_geometry::GeometryError;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// Bins of each of the three angles.
const BINS: usize = 11;
/// Numbers of a feature.
pub const FPFH_LEN: usize = 3 * BINS;
/// A feature: three histograms of eleven bins, each adding up to about 200.
pub type Fpfh = [f32; FPFH_LEN];

/// Points of one task.
const CHUNK: usize = 64;
/// Pairs of neighbours at most: beyond, the radius is too large for the cloud.
const MAX_PAIRS: usize = 200_000_000;

/// Parameters of [`compute_fpfh`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FpfhParams {
    /// Neighbourhood of a point, metres, above 0; about five voxels of a thinned cloud.
    pub radius_m: f64,
    /// Nearest neighbours used, at most, the point itself among them; 0: all.
    pub max_neighbors: usize,
}

impl Default for FpfhParams {
    fn default() -> Self {
        Self { radius_m: 0.25, max_neighbors: 100 }
    }
}

/// A feature for every point from its neighbours and their normals; zeros for points without neighbours.
///
/// For each pair of neighbours, three angles between their normals and the line between them; a point's histograms are
/// added to its neighbours', weighted by the inverse squared distance. As Open3D computes it: the point whose normal is
/// nearer to the line is the first of the pair, and a point's own histogram is added in the end.
///
/// Source: Rusu, Blodow and Beetz, "Fast point feature histograms (FPFH) for 3D registration", 2009.
///
/// # Errors
/// `OutOfRange` for the radius, also if neighbourhoods hold more than 2e8 points in all; `ShapeMismatch` for normals.
pub fn compute_fpfh(
    positions: &[Point3<f32>],
    normals: &[Vector3<f32>],
    params: &FpfhParams,
) -> Result<Vec<Fpfh>, GeometryError> {
    if !(params.radius_m.is_finite() && params.radius_m > 0.0) {
        let requirement = "positive and finite";
        return Err(GeometryError::OutOfRange { field: "radius_m", value: params.radius_m, requirement });
    }
    if normals.len() != positions.len() {
        let (expected, actual) = (positions.len(), normals.len());
        return Err(GeometryError::ShapeMismatch { field: "normals", expected, actual });
    }
    let tree = KdTree::build(positions);
    let radius = params.radius_m as f32;
    let neighbors = match params.max_neighbors {
        0 => tree.radius_all(radius, MAX_PAIRS)?,
        n => tree.hybrid_all(radius, n),
    };
    Ok(fpfh_of(positions, normals, &neighbors))
}

/// Features from neighbours that are known already.
pub(super) fn fpfh_of(positions: &[Point3<f32>], normals: &[Vector3<f32>], neighbors: &Neighbors) -> Vec<Fpfh> {
    let n = positions.len();
    let in_chunks = |one: &(dyn Fn(usize) -> Fpfh + Sync)| -> Vec<Fpfh> {
        let mut out = vec![[0.0; FPFH_LEN]; n];
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            chunk.iter_mut().enumerate().for_each(|(k, f)| *f = one(c * CHUNK + k));
        });
        out
    };
    let simple = in_chunks(&|i| simple_histogram(i, positions, normals, neighbors.of(i).0));
    in_chunks(&|i| weighted(i, &simple, neighbors.of(i)))
}

/// Histograms of the pairs of a point with its neighbours, each adding up to 100.
fn simple_histogram(i: usize, positions: &[Point3<f32>], normals: &[Vector3<f32>], neighbors: &[u32]) -> Fpfh {
    let mut out = [0.0; FPFH_LEN];
    let others = neighbors.len().saturating_sub(1);
    if others == 0 {
        return out;
    }
    let share = 100.0 / others as f32;
    let (p, n) = (&positions[i], &normals[i]);
    for &j in neighbors.iter().filter(|&&j| j as usize != i) {
        let [theta, alpha, phi] = pair_features(p, n, &positions[j as usize], &normals[j as usize]);
        let bin = |x: f32| ((BINS as f32 * x) as usize).min(BINS - 1);
        out[bin((theta + PI) * (0.5 / PI))] += share;
        out[BINS + bin((alpha + 1.0) * 0.5)] += share;
        out[2 * BINS + bin((phi + 1.0) * 0.5)] += share;
    }
    out
}

/// Angle about the line, cosine of the second normal against the plane of line and first normal, cosine of the first
/// normal against the line.
#[inline]
fn pair_features(p1: &Point3<f32>, n1: &Vector3<f32>, p2: &Point3<f32>, n2: &Vector3<f32>) -> [f32; 3] {
    let mut line = p2 - p1;
    let length = line.norm();
    if length == 0.0 {
        return [0.0; 3];
    }
    let (along1, along2) = (n1.dot(&line) / length, n2.dot(&line) / length);
    // The normal nearer to the line comes first.
    let (first, second, phi) = if along1.abs() < along2.abs() {
        line = -line;
        (n2, n1, -along2)
    } else {
        (n1, n2, along1)
    };
    let v = line.cross(first);
    let across = v.norm();
    if across == 0.0 {
        return [0.0; 3];
    }
    let v = v / across;
    let w = first.cross(&v);
    [w.dot(second).atan2(first.dot(second)), v.dot(second), phi]
}

fn weighted(i: usize, simple: &[Fpfh], (neighbors, distances2): (&[u32], &[f32])) -> Fpfh {
    let mut out = [0.0f32; FPFH_LEN];
    for (&j, &d2) in neighbors.iter().zip(distances2).filter(|(_, d2)| **d2 > 0.0) {
        let weight = 1.0 / d2;
        out.iter_mut().zip(&simple[j as usize]).for_each(|(o, s)| *o += weight * s);
    }
    for (histogram, own) in out.chunks_mut(BINS).zip(simple[i].chunks(BINS)) {
        let sum: f32 = histogram.iter().sum();
        let scale = if sum > 0.0 { 100.0 / sum } else { 0.0 };
        histogram.iter_mut().zip(own).for_each(|(o, s)| *o = *o * scale + s);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn wavy() -> (Vec<Point3<f32>>, Vec<Vector3<f32>>) {
        let height = |x: f32, y: f32| 0.3 * (2.0 * x).sin() * (1.5 * y).cos();
        let at = |i: usize| ((i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1);
        let positions = (0..400).map(|i| Point3::new(at(i).0, at(i).1, height(at(i).0, at(i).1))).collect();
        let slope = |(x, y): (f32, f32)| {
            Vector3::new(-0.6 * (2.0 * x).cos() * (1.5 * y).cos(), 0.45 * (2.0 * x).sin() * (1.5 * y).sin(), 1.0)
        };
        (positions, (0..400).map(|i| slope(at(i)).normalize()).collect())
    }

    #[test]
    fn features_stay_when_the_cloud_is_moved_and_add_up() {
        let (positions, normals) = wavy();
        let params = FpfhParams { radius_m: 0.35, max_neighbors: 0 };
        let before = compute_fpfh(&positions, &normals, &params).unwrap();
        let turn = UnitQuaternion::from_euler_angles(0.3f32, -1.1, 2.0);
        let moved: Vec<_> = positions.iter().map(|p| turn * p + Vector3::new(3.0, -2.0, 1.0)).collect();
        let turned: Vec<_> = normals.iter().map(|n| turn * n).collect();
        let after = compute_fpfh(&moved, &turned, &params).unwrap();
        // Rounding moves few pairs over the border of a bin.
        let off = before.iter().zip(&after).map(|(a, b)| a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f32>());
        let worst = off.fold(0.0f32, f32::max);
        assert!(worst < 30.0, "{worst}");
        for f in &before {
            for histogram in f.chunks(BINS) {
                assert!((histogram.iter().sum::<f32>() - 200.0).abs() < 0.1);
            }
        }
    }

    #[test]
    fn lonely_and_equal_points_have_zeros_and_bad_input_is_named() {
        let far = [Point3::origin(), Point3::new(10.0, 0.0, 0.0)];
        let up = [Vector3::z(); 2];
        let params = FpfhParams { radius_m: 1.0, max_neighbors: 100 };
        assert_eq!(compute_fpfh(&far, &up, &params).unwrap(), vec![[0.0; FPFH_LEN]; 2]);
        assert!(compute_fpfh(&[Point3::origin(); 5], &[Vector3::z(); 5], &params).is_ok());
        assert!(compute_fpfh(&[], &[], &params).unwrap().is_empty());
        assert!(matches!(
            compute_fpfh(&far, &up[..1], &params),
            Err(GeometryError::ShapeMismatch { field: "normals", .. })
        ));
        let bad = FpfhParams { radius_m: 0.0, ..params };
        assert!(matches!(compute_fpfh(&far, &up, &bad), Err(GeometryError::OutOfRange { field: "radius_m", .. })));
    }
}

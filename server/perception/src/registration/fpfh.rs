//! Fast point feature histograms.

use super::pair_bins::{BINS, LANES, PairBins};
use crate::search::{KdTree, Neighbors};
use nalgebra::{Point3, Vector3};
use percept_geometry::GeometryError;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
    pub max_neighbours: usize,
}

impl Default for FpfhParams {
    fn default() -> Self {
        Self { radius_m: 0.25, max_neighbours: 100 }
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
    let neighbors = match params.max_neighbours {
        0 => tree.radius_all(radius, MAX_PAIRS)?,
        n => tree.hybrid_all(radius, n),
    };
    Ok(fpfh_of(positions, normals, &neighbors))
}

/// Features of all points from neighbours that are known already.
pub(super) fn fpfh_of(positions: &[Point3<f32>], normals: &[Vector3<f32>], neighbors: &Neighbors) -> Vec<Fpfh> {
    let all: Vec<u32> = (0..positions.len() as u32).collect();
    fpfh_of_some(&all, positions, normals, neighbors)
}

/// Features of some points, in their order, from neighbours that are known already.
pub(super) fn fpfh_of_some(
    some: &[u32],
    positions: &[Point3<f32>],
    normals: &[Vector3<f32>],
    neighbors: &Neighbors,
) -> Vec<Fpfh> {
    let mut touched = vec![false; positions.len()];
    some.iter().for_each(|&i| neighbors.of(i as usize).0.iter().for_each(|&j| touched[j as usize] = true));
    let simple = in_chunks(positions.len(), |i, out| {
        if touched[i] {
            simple_histogram(i, positions, normals, neighbors.of(i).0, out);
        }
    });
    in_chunks(some.len(), |k, out| weighted(some[k] as usize, &simple, neighbors, out))
}

fn in_chunks(n: usize, one: impl Fn(usize, &mut Fpfh) + Sync) -> Vec<Fpfh> {
    let mut out = vec![[0.0; FPFH_LEN]; n];
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
        chunk.iter_mut().enumerate().for_each(|(k, f)| one(c * CHUNK + k, f));
    });
    out
}

percept_geometry::by_processor! {
    /// Histograms of the pairs of a point with its neighbours, each adding up to 100.
    fn simple_histogram(i: usize, positions: &[Point3<f32>], normals: &[Vector3<f32>], neighbors: &[u32], out: &mut Fpfh) {
        let mut counts = [0u32; FPFH_LEN];
        let mut pairs = PairBins::new(&positions[i], &normals[i]);
        for chunk in neighbors.chunks(LANES) {
            for (lane, &j) in chunk.iter().enumerate() {
                pairs.put(lane, &positions[j as usize], &normals[j as usize]);
            }
            let bins = pairs.bins();
            for (lane, _) in chunk.iter().enumerate().filter(|(_, j)| **j as usize != i) {
                (0..3).for_each(|angle| counts[angle * BINS + (bins[angle][lane] as usize).min(BINS - 1)] += 1);
            }
        }
        let share = 100.0 / (neighbors.len() as f32 - 1.0).max(1.0);
        out.iter_mut().zip(&counts).for_each(|(o, c)| *o = *c as f32 * share);
    }
}

percept_geometry::by_processor! {
    /// A point's own histograms and those of its neighbours.
    fn weighted(i: usize, simple: &[Fpfh], neighbors: &Neighbors, out: &mut Fpfh) {
        let (indices, distances2) = neighbors.of(i);
        let mut sums = [0.0f32; FPFH_LEN];
        for (&j, &d2) in indices.iter().zip(distances2).filter(|(_, d2)| **d2 > 0.0) {
            let weight = 1.0 / d2;
            sums.iter_mut().zip(&simple[j as usize]).for_each(|(o, s)| *o += weight * s);
        }
        for ((histogram, own), out) in sums.chunks(BINS).zip(simple[i].chunks(BINS)).zip(out.chunks_mut(BINS)) {
            let sum: f32 = histogram.iter().sum();
            let scale = if sum > 0.0 { 100.0 / sum } else { 0.0 };
            out.iter_mut().zip(histogram).zip(own).for_each(|((o, h), s)| *o = *h * scale + s);
        }
    }
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
        let params = FpfhParams { radius_m: 0.35, max_neighbours: 0 };
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
        let params = FpfhParams { radius_m: 1.0, max_neighbours: 100 };
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

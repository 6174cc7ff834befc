//! Neighbouring submaps of a recorded street, cut until little of them overlaps.

use super::{Failure, Pair, Submap, overlap_of_smaller};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Fewer points are left of no place.
const FEWEST_POINTS: usize = 1000;
/// How near to the wanted overlap a cut has to come.
const TOLERANCE: f64 = 0.01;
const TRIES: usize = 400;

/// What is kept of two clouds, in the map's frame; `scale` makes the common part larger or smaller.
enum Cut {
    /// Either side of a plane: the clouds reach `scale` over it.
    Halves { along: Vector3<f64>, at: f64 },
    /// What is within `radius` of two places that are `2 * scale` apart.
    Disks { along: Vector3<f64>, center: Vector3<f64>, radius: f64 },
}

impl Cut {
    fn random(rng: &mut ChaCha8Rng, points: &[Point3<f64>]) -> Self {
        let heading = rng.random_range(0.0..TAU);
        let along = Vector3::new(heading.cos(), heading.sin(), 0.0);
        let center = points[rng.random_range(0..points.len())].coords;
        if rng.random_range(0..2) == 0 {
            return Self::Halves { along, at: along.dot(&center) };
        }
        Self::Disks { along, center, radius: rng.random_range(10.0..25.0) }
    }

    fn keeps(&self, p: &Point3<f64>, first: bool, scale: f64) -> bool {
        let side = if first { 1.0 } else { -1.0 };
        match self {
            Self::Halves { along, at } => side * (along.dot(&p.coords) - at) < scale,
            Self::Disks { along, center, radius } => (p.coords - center - along * side * scale).xy().norm() < *radius,
        }
    }

    /// Bounds of the scale, metres, the one with the smaller overlap first.
    fn bounds(&self) -> (f64, f64) {
        match self {
            Self::Halves { .. } => (0.0, 60.0),
            Self::Disks { radius, .. } => (*radius, 0.0),
        }
    }
}

/// Pair number `index` of a seed: two submaps of which `wanted` of the smaller coincides with the other.
///
/// # Errors
/// If the submaps allow no such cut.
pub(super) fn pair(maps: &[Submap], seed: u64, index: usize) -> Result<Pair, Failure> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index as u64);
    let wanted = rng.random_range(0.1..0.5);
    for _ in 0..TRIES {
        let (a, b) = (&maps[rng.random_range(0..maps.len())], &maps[rng.random_range(0..maps.len())]);
        // Of one submap both get half the points, so that no point is in both.
        let one = a.number == b.number;
        let placed = |m: &Submap, half: usize| -> Vec<Point3<f64>> {
            let kept = m.cloud.positions.iter().enumerate().filter(|(i, _)| !one || i % 2 == half);
            kept.map(|(_, p)| m.t_map_submap * p.cast::<f64>()).collect()
        };
        let (target, source) = (placed(a, 0), placed(b, 1));
        let cut = Cut::random(&mut rng, &target);
        let at = |scale: f64| -> (Vec<Point3<f32>>, Vec<Point3<f32>>) {
            let kept = |points: &[Point3<f64>], first| -> Vec<Point3<f32>> {
                points.iter().filter(|p| cut.keeps(p, first, scale)).map(|p| p.cast()).collect()
            };
            (kept(&target, true), kept(&source, false))
        };
        let (mut less, mut more) = cut.bounds();
        for _ in 0..12 {
            let middle = 0.5 * (less + more);
            let (target, source) = at(middle);
            let share = overlap_of_smaller(&target, &source);
            if (share - wanted).abs() < TOLERANCE && target.len().min(source.len()) >= FEWEST_POINTS {
                let source = PointCloud::from_positions(source).transformed(&b.t_map_submap.inverse());
                let target = PointCloud::from_positions(target).transformed(&a.t_map_submap.inverse());
                return Ok(Pair {
                    name: format!("cut {index}: {}<-{}", a.number, b.number),
                    source,
                    target,
                    t_target_source: a.t_map_submap.inverse() * b.t_map_submap,
                    overlap: share,
                });
            }
            if share < wanted { less = middle } else { more = middle }
        }
    }
    Err(format!("no cut with an overlap of {wanted}").into())
}

//! Normals from the scatter of neighbours.

use super::{Scatter, at_least, positive, symmetric_eigen3};
use crate::search::{Group, KdTree, Neighbor, Wanted, What};
use nalgebra::{Point3, Vector3};
use percept_geometry::GeometryError;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Neighbours in all, at most, if all within the radius are used, a bound on time.
const MAX_PAIRS: usize = 1_000_000_000;
/// Points of one task.
const CHUNK: usize = 256;

/// Which neighbours make a normal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalParams {
    /// Neighbours lie within this distance, metres; about three times the spacing of points. Infinite: the nearest
    /// ones, however far.
    pub radius_m: f64,
    /// Of them the nearest so many are used, the point itself among them, at least `min_neighbours`; 0: all of them.
    pub max_neighbours: usize,
    /// With fewer the normal is undefined; at least 3.
    pub min_neighbours: usize,
}

impl Default for NormalParams {
    fn default() -> Self {
        Self { radius_m: 0.1, max_neighbours: 30, min_neighbours: 5 }
    }
}

impl NormalParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        if self.radius_m != f64::INFINITY {
            positive("radius_m", self.radius_m)?;
        }
        at_least("min_neighbours", self.min_neighbours, 3, "at least 3")?;
        match self.max_neighbours {
            0 if self.radius_m == f64::INFINITY => {
                let requirement = "at least min_neighbours if radius_m is infinite";
                Err(GeometryError::OutOfRange { field: "max_neighbours", value: 0.0, requirement })
            }
            0 => Ok(()),
            n => at_least("max_neighbours", n, self.min_neighbours, "at least min_neighbours"),
        }
    }
}

/// `N x 3` unit normals: of each point's neighbourhood the direction of least scatter, turned towards
/// `viewpoint` if given. Zero where undefined: too few neighbours, all on a line, or the point not finite.
///
/// Source: Hoppe et al., "Surface reconstruction from unorganized points", 1992, section 3.2.
///
/// # Errors
/// `OutOfRange` naming the parameter; for the radius also if all neighbours within it are more than 1e9.
pub fn estimate_normals(
    points: &[Point3<f32>],
    params: &NormalParams,
    viewpoint: Option<&Point3<f64>>,
) -> Result<Vec<Vector3<f32>>, GeometryError> {
    params.validate()?;
    let tree = KdTree::build(points);
    match params.max_neighbours {
        0 => normals_within(points, &tree, params, viewpoint),
        _ => Ok(normals_of(points, &tree, params, viewpoint)),
    }
}

/// Unit normals, signs arbitrary, from the `k` nearest of each point; zero where they lie on a line. `tree` is of
/// `points`.
pub(crate) fn nearest_normals(points: &[Point3<f32>], tree: &KdTree, k: usize) -> Vec<Vector3<f32>> {
    let params = NormalParams { radius_m: f64::INFINITY, max_neighbours: k, min_neighbours: 0 };
    normals_of(points, tree, &params, None)
}

fn normals_of(
    points: &[Point3<f32>],
    tree: &KdTree,
    params: &NormalParams,
    viewpoint: Option<&Point3<f64>>,
) -> Vec<Vector3<f32>> {
    let k = params.max_neighbours.min(tree.len());
    let wanted = Wanted { k, radius_m: params.radius_m as f32, what: What::Moments(points) };
    let by_task = tree.map_leaves(&wanted, |normals: &mut Vec<Vector3<f32>>, leaf, group| {
        normals.extend(tree.indices_of(leaf).iter().enumerate().map(|(i, &index)| {
            let enough = group.count(i) >= params.min_neighbours;
            let p = &points[index as usize];
            let normal = enough.then(|| least_scatter(&scatter(group, i), p, viewpoint)).flatten();
            normal.unwrap_or_default()
        }));
    });
    tree.in_cloud_order(&by_task, Vector3::zeros())
}

/// Of all neighbours within the radius.
fn normals_within(
    points: &[Point3<f32>],
    tree: &KdTree,
    params: &NormalParams,
    viewpoint: Option<&Point3<f64>>,
) -> Result<Vec<Vector3<f32>>, GeometryError> {
    let total = AtomicUsize::new(0);
    let too_many = || GeometryError::OutOfRange {
        field: "radius_m",
        value: params.radius_m,
        requirement: "small enough for at most 1e9 neighbours in all; or give max_neighbours",
    };
    let chunks = points.par_chunks(CHUNK).map_init(Vec::new, |found: &mut Vec<Neighbor>, chunk| {
        let mut normals = Vec::with_capacity(chunk.len());
        for p in chunk {
            tree.radius_into(p, params.radius_m as f32, found);
            if total.fetch_add(found.len(), Ordering::Relaxed).saturating_add(found.len()) > MAX_PAIRS {
                return Err(too_many());
            }
            let mut scatter = Scatter::new(p.cast());
            found.iter().for_each(|n| scatter.add(&points[n.index].cast()));
            let enough = found.len() >= params.min_neighbours;
            normals.push(enough.then(|| least_scatter(&scatter, p, viewpoint)).flatten().unwrap_or_default());
        }
        Ok(normals)
    });
    Ok(chunks.collect::<Result<Vec<_>, _>>()?.concat())
}

fn least_scatter(scatter: &Scatter, p: &Point3<f32>, viewpoint: Option<&Point3<f64>>) -> Option<Vector3<f32>> {
    let eigen = symmetric_eigen3(&scatter.covariance());
    // On a line the second value is rounding: any direction across would do, so none does.
    if eigen.values[1] <= 1e-10 * eigen.values[2] {
        return None;
    }
    let normal = eigen.vectors[0];
    let away = viewpoint.is_some_and(|v| normal.dot(&(v - p.cast::<f64>())) < 0.0);
    Some(if away { -normal } else { normal }.cast())
}

/// Moments of the neighbours of the `i`-th point of a group about it.
pub(super) fn scatter(group: &Group, i: usize) -> Scatter {
    Scatter::from_sums(Point3::origin(), &group.moments().each_ref().map(|sums| sums[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(center: Vector3<f32>, n: usize) -> Vec<Point3<f32>> {
        // Fibonacci lattice on the unit sphere.
        (0..n)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f32 / n as f32;
                let (s, c) = (i as f32 * 2.399_963).sin_cos();
                let r = (1.0 - z * z).sqrt();
                Point3::from(center + Vector3::new(r * c, r * s, z))
            })
            .collect()
    }

    #[test]
    fn normals_of_a_sphere_point_outward_or_to_the_viewpoint_in_it() {
        let points = sphere(Vector3::new(3.0, 0.0, 0.0), 5000);
        let params = NormalParams { radius_m: 0.2, ..NormalParams::default() };
        let normals = estimate_normals(&points, &params, Some(&Point3::new(3.0, 0.0, 0.0))).unwrap();
        for (p, n) in points.iter().zip(&normals) {
            let inward = Vector3::new(3.0, 0.0, 0.0) - p.coords;
            assert!(n.dot(&inward) > 0.999, "{p} {n}");
        }
    }

    #[test]
    fn neighbourhoods_without_a_plane_have_no_normal() {
        let params = NormalParams { radius_m: 1.0, max_neighbours: 30, min_neighbours: 3 };
        let zero = |points: &[Point3<f32>]| {
            estimate_normals(points, &params, None).unwrap().iter().all(|n| *n == Vector3::zeros())
        };
        assert!(zero(&[]));
        assert!(zero(&[Point3::origin(); 1]));
        assert!(zero(&[Point3::new(1e7, 0.0, 0.0); 10]));
        assert!(zero(&(0..10).map(|i| Point3::new(i as f32 * 0.1, i as f32 * 0.2, 5.0)).collect::<Vec<_>>()));
        assert!(zero(&[Point3::from([f32::NAN; 3]); 10]));
    }

    #[test]
    fn all_neighbours_within_the_radius_are_used_if_their_number_is_open() {
        let points = sphere(Vector3::zeros(), 3000);
        let all = NormalParams { radius_m: 0.3, max_neighbours: 0, ..NormalParams::default() };
        let found = estimate_normals(&points, &all, None).unwrap();
        let most = estimate_normals(&points, &NormalParams { max_neighbours: 3000, ..all }, None).unwrap();
        for (a, b) in found.iter().zip(&most) {
            assert!(a.dot(b).abs() > 1.0 - 1e-6);
        }
        let nearest = NormalParams { radius_m: f64::INFINITY, max_neighbours: 12, min_neighbours: 12 };
        let found = estimate_normals(&points, &nearest, None).unwrap();
        assert!(found.iter().zip(&points).all(|(n, p)| n.dot(&p.coords).abs() > 0.99));
        let far = vec![Point3::new(f32::NAN, 0.0, 0.0); 3];
        assert_eq!(estimate_normals(&far, &all, None).unwrap(), vec![Vector3::zeros(); 3]);
        let dense = vec![Point3::new(1.0, 0.0, 0.0); 40_000];
        assert!(estimate_normals(&dense, &all, None).unwrap_err().to_string().starts_with("radius_m"));
    }

    #[test]
    fn points_far_from_the_origin_have_normals_too() {
        let far: Vec<Point3<f32>> =
            (0..400).map(|i| Point3::new(1e6 + (i % 20) as f32 * 0.25, (i / 20) as f32 * 0.25, 2.0)).collect();
        let params = NormalParams { radius_m: 1.0, ..NormalParams::default() };
        let normals = estimate_normals(&far, &params, Some(&Point3::new(1e6, 0.0, 10.0))).unwrap();
        assert!(normals.iter().all(|n| (n - Vector3::z()).norm() < 1e-5));
    }

    #[test]
    fn parameters_out_of_bounds_are_named() {
        for (params, name) in [
            (NormalParams { radius_m: 0.0, ..Default::default() }, "radius_m"),
            (NormalParams { min_neighbours: 2, ..Default::default() }, "min_neighbours"),
            (NormalParams { max_neighbours: 4, ..Default::default() }, "max_neighbours"),
            (NormalParams { max_neighbours: 0, radius_m: f64::INFINITY, ..Default::default() }, "max_neighbours"),
        ] {
            assert!(estimate_normals(&[], &params, None).unwrap_err().to_string().starts_with(name));
        }
    }
}

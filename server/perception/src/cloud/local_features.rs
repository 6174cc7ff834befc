//! Numbers that describe the surface around each point.

use super::normals::scatter;
use super::{at_least, symmetric_eigen3};
use crate::search::{Group, KdTree, Wanted, What};
use nalgebra::Point3;
use percept_geometry::GeometryError;

/// Shape of the neighbourhood of a point, from the eigenvalues `l1 >= l2 >= l3` of its covariance.
///
/// Source: Demantke et al., "Dimensionality based scale selection in 3D lidar point clouds", 2011; Weinmann et al.,
/// "Semantic point cloud interpretation based on optimal neighborhoods, relevant features and efficient classifiers",
/// 2015, eqs. 1 to 8, with eigenvalues themselves and not their roots.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LocalFeatures {
    /// (l1 - l2) / l1.
    pub linearity: f32,
    /// (l2 - l3) / l1.
    pub planarity: f32,
    /// l3 / l1.
    pub scattering: f32,
    /// 1 - |n . z| of the normal n: 0 on a floor, 1 on a wall.
    pub verticality: f32,
    /// Surface variation, l3 / (l1 + l2 + l3).
    pub curvature: f32,
}

/// Features of every point from its `k` nearest, itself among them. None where the point is not finite, there are
/// fewer than three points, or all neighbours are equal.
///
/// # Errors
/// `OutOfRange` if `k` is less than 3.
pub fn local_features(points: &[Point3<f32>], k: usize) -> Result<Vec<Option<LocalFeatures>>, GeometryError> {
    at_least("k", k, 3, "at least 3")?;
    let tree = KdTree::build(points);
    let wanted = Wanted { k: k.min(tree.len()), radius_m: f32::INFINITY, what: What::Moments(points) };
    let by_task = tree.map_leaves(&wanted, |out: &mut Vec<Option<LocalFeatures>>, leaf, group| {
        out.extend((0..tree.num_points_of(leaf)).map(|i| describe(group, i)));
    });
    Ok(tree.in_cloud_order(&by_task, None))
}

fn describe(group: &Group, i: usize) -> Option<LocalFeatures> {
    if group.count(i) < 3 {
        return None;
    }
    let eigen = symmetric_eigen3(&scatter(group, i).covariance());
    let [l3, l2, l1] = eigen.values.map(|v| v.max(0.0));
    (l1 > 0.0).then(|| LocalFeatures {
        linearity: ((l1 - l2) / l1) as f32,
        planarity: ((l2 - l3) / l1) as f32,
        scattering: (l3 / l1) as f32,
        verticality: (1.0 - eigen.vectors[0].z.abs()).max(0.0) as f32,
        curvature: (l3 / (l1 + l2 + l3)) as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floors_walls_and_lines_are_told_apart() {
        let sheet = |f: fn(f32, f32) -> [f32; 3]| -> Vec<Point3<f32>> {
            (0..400).map(|i| Point3::from(f((i % 20) as f32, (i / 20) as f32))).collect()
        };
        let middle = |points: &[Point3<f32>]| local_features(points, 9).unwrap()[210].unwrap();
        let floor = middle(&sheet(|a, b| [a, b, 0.0]));
        assert!(floor.planarity > 0.999 && floor.verticality < 1e-6 && floor.curvature < 1e-6);
        let wall = middle(&sheet(|a, b| [0.0, a, b]));
        assert!(wall.planarity > 0.999 && wall.verticality > 0.999);
        let line = middle(&sheet(|a, b| [a + 20.0 * b, 0.0, 0.0]));
        assert!(line.linearity > 0.999 && line.planarity < 1e-6);
    }

    #[test]
    fn degenerate_clouds_have_none() {
        assert!(local_features(&[], 20).unwrap().is_empty());
        assert!(local_features(&[], 2).unwrap_err().to_string().starts_with('k'));
        for p in [Point3::from([f32::NAN; 3]), Point3::from([1e7; 3])] {
            assert_eq!(local_features(&[p; 5], 20).unwrap(), [None; 5]);
        }
        assert_eq!(local_features(&[Point3::origin()], 20).unwrap(), [None]);
    }
}

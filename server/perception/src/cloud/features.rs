//! Numbers that describe a cluster's shape.

use super::{Scatter, convex_hull_3d, symmetric_eigen3, upright_box};
use nalgebra::{Point3, Vector3};
use percept_geometry::Aabb3;
use serde::{Deserialize, Serialize};

/// Size and shape of a set of points.
///
/// Source of the ratios: Weinmann et al., "Semantic point cloud interpretation based on optimal
/// neighborhoods, relevant features and efficient classifiers", 2015, eqs. 1 to 3. All three are 0 if the
/// points are all equal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ShapeFeatures {
    /// Number of finite points.
    pub num_points: usize,
    /// Mean, metres.
    pub centroid: Point3<f64>,
    /// Variance along x, y, z, square metres.
    pub variance: Vector3<f64>,
    /// Edges of the axis-aligned box, metres.
    pub extent: Vector3<f64>,
    /// Volume of the smallest box upright along z, cubic metres; 0 if flat.
    pub volume_m3: f64,
    /// Volume of the convex hull, cubic metres; 0 if flat.
    pub hull_volume_m3: f64,
    /// Area of the convex hull's surface, square metres; both sides if flat.
    pub hull_area_m2: f64,
    /// (l1 - l2) / l1.
    pub linearity: f64,
    /// (l2 - l3) / l1.
    pub planarity: f64,
    /// l3 / l1.
    pub sphericity: f64,
    /// Eigenvalues of the covariance, largest first, square metres, not negative.
    pub eigenvalues: [f64; 3],
    /// Unit eigenvectors in the order of the eigenvalues; signs are arbitrary but fixed.
    pub eigenvectors: [Vector3<f64>; 3],
}

impl ShapeFeatures {
    /// Features of the finite ones of `points`; none if there is none.
    pub fn of(points: &[Point3<f32>]) -> Option<Self> {
        let scatter = Scatter::of(points)?;
        let covariance = scatter.covariance();
        let eigen = symmetric_eigen3(&covariance);
        let [l3, l2, l1] = eigen.values.map(|v| v.max(0.0));
        let [v3, v2, v1] = eigen.vectors;
        let hull = convex_hull_3d(points)?;
        let ratio = |a: f64| if l1 > 0.0 { a / l1 } else { 0.0 };
        Some(Self {
            num_points: scatter.num_points(),
            centroid: scatter.mean(),
            variance: covariance.diagonal().map(|v| v.max(0.0)),
            extent: Aabb3::of(points).size(),
            volume_m3: upright_box(points)?.volume(),
            hull_volume_m3: hull.volume_m3,
            hull_area_m2: hull.area_m2,
            linearity: ratio(l1 - l2),
            planarity: ratio(l2 - l3),
            sphericity: ratio(l3),
            eigenvalues: [l1, l2, l3],
            eigenvectors: [v1, v2, v3],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_solid_brick_has_the_moments_of_the_textbook() {
        // Points at the centres of 40 x 20 x 10 cells of a 2 x 1 x 0.5 m brick: variance a^2 / 12 a side.
        let points: Vec<Point3<f32>> = (0..8000)
            .map(|i| Point3::new((i % 40) as f32 + 0.5, (i / 40 % 20) as f32 + 0.5, (i / 800) as f32 + 0.5) * 0.05)
            .collect();
        let f = ShapeFeatures::of(&points).unwrap();
        let expected = [2.0f64, 1.0, 0.5].map(|a| (a * a - 0.0025) / 12.0);
        for (l, e) in f.eigenvalues.iter().zip(expected) {
            assert!((l - e).abs() < 1e-6);
        }
        assert!((f.centroid - Point3::new(1.0, 0.5, 0.25)).norm() < 1e-6);
        assert!((f.volume_m3 - 1.95 * 0.95 * 0.45).abs() < 1e-5);
        assert!((f.hull_volume_m3 - 1.95 * 0.95 * 0.45).abs() < 1e-5);
        let area = 2.0 * (1.95 * 0.95 + 0.95 * 0.45 + 1.95 * 0.45);
        assert!((f.hull_area_m2 - area).abs() < 1e-5);
        assert!((f.variance - Vector3::from(expected)).norm() < 1e-6);
        assert!(f.eigenvectors[0].x.abs() > 0.999 && f.eigenvectors[2].z.abs() > 0.999);
        assert!((f.linearity + f.planarity + f.sphericity - 1.0).abs() < 1e-12);
    }

    #[test]
    fn degenerate_sets_have_defined_features() {
        assert_eq!(ShapeFeatures::of(&[]), None);
        assert_eq!(ShapeFeatures::of(&[Point3::from([f32::NAN; 3])]), None);
        let f = ShapeFeatures::of(&[Point3::new(1e7, 2.0, 3.0); 4]).unwrap();
        assert_eq!((f.num_points, f.linearity, f.planarity, f.sphericity), (4, 0.0, 0.0, 0.0));
        let line: Vec<Point3<f32>> = (0..50).map(|i| Point3::new(i as f32, 0.0, 0.0)).collect();
        let f = ShapeFeatures::of(&line).unwrap();
        assert!((f.linearity - 1.0).abs() < 1e-9 && f.volume_m3 == 0.0);
    }

    proptest! {
        #[test]
        fn ratios_are_within_zero_and_one(points in prop::collection::vec(prop::array::uniform3(-1e3..1e3f32), 1..60)) {
            let points: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
            let f = ShapeFeatures::of(&points).unwrap();
            for v in [f.linearity, f.planarity, f.sphericity] {
                prop_assert!((0.0..=1.0).contains(&v));
            }
        }
    }
}

//! The target of VGICP: a mean point and a mean covariance a voxel.
//!
//! Source: Koide, Yokozuka, Oishi, Banno, "Voxelized GICP for fast and accurate 3D point cloud registration", 2021,
//! section III-C.

use super::factors::gicp;
use nalgebra::{Point3, Vector3};
use percept_geometry::Voxel;
use rustc_hash::FxHashMap;

/// Means and covariances of the points of each voxel.
#[derive(Debug, Clone, Default)]
pub struct GaussianVoxels {
    size: f64,
    slots: FxHashMap<Voxel, u32>,
    cells: Vec<GaussianVoxel>,
}

/// What a voxel holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianVoxel {
    /// Mean of its points, metres.
    pub mean: Vector3<f64>,
    /// Mean of their covariances, upper triangle; see [`gicp::covariance`].
    pub covariance: [f64; 6],
    num_points: f64,
}

impl GaussianVoxels {
    /// Gathers points with their unit normals (zero if undefined). Points whose voxel has no index are left out.
    pub fn new(points: &[Point3<f32>], normals: &[Vector3<f32>], size_m: f64) -> Self {
        let mut out = Self { size: size_m, ..Self::default() };
        for (p, n) in points.iter().zip(normals) {
            let p = p.cast::<f64>();
            let Some(voxel) = Voxel::containing(&p, size_m) else { continue };
            let next = out.cells.len() as u32;
            let slot = *out.slots.entry(voxel).or_insert(next);
            if slot == next {
                out.cells.push(GaussianVoxel { mean: Vector3::zeros(), covariance: [0.0; 6], num_points: 0.0 });
            }
            let cell = &mut out.cells[slot as usize];
            cell.mean += p.coords;
            cell.covariance.iter_mut().zip(gicp::covariance(&n.cast())).for_each(|(s, c)| *s += c);
            cell.num_points += 1.0;
        }
        for cell in &mut out.cells {
            cell.mean /= cell.num_points;
            cell.covariance.iter_mut().for_each(|c| *c /= cell.num_points);
        }
        out
    }

    /// The voxel that a point lies in, if it holds points.
    #[inline]
    pub fn at(&self, p: &Point3<f64>) -> Option<&GaussianVoxel> {
        let slot = self.slots.get(&Voxel::containing(p, self.size)?)?;
        Some(&self.cells[*slot as usize])
    }

    /// Number of voxels with points.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether no voxel holds a point.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voxel_holds_the_means_of_its_points() {
        let points = [[0.2, 0.2, 0.2], [0.6, 0.4, 0.2], [-0.5, 0.5, 0.5]].map(Point3::from);
        let normals = [Vector3::z(), Vector3::x(), Vector3::zeros()];
        let voxels = GaussianVoxels::new(&points, &normals, 1.0);
        assert_eq!(voxels.len(), 2);
        let cell = voxels.at(&Point3::new(0.9, 0.9, 0.9)).unwrap();
        assert!((cell.mean - Vector3::new(0.4, 0.3, 0.2)).norm() < 1e-6);
        let half = 0.5 * (1.0 + gicp::ACROSS);
        assert_eq!(cell.covariance, [half, 0.0, 0.0, 1.0, 0.0, half]);
        assert!(voxels.at(&Point3::new(1.5, 0.5, 0.5)).is_none());
        assert!(voxels.at(&Point3::new(f64::NAN, 0.5, 0.5)).is_none());
    }
}

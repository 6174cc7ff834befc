//! Points in voxels, and which voxels touch.

use crate::cloud::CloudError;
use nalgebra::Point3;
use percept_geometry::cloud::is_finite;
use rustc_hash::FxHashMap;

/// No voxel.
pub(super) const NONE: u32 = u32::MAX;

/// Voxels that hold a point, in the order of their first point, with the voxels that touch them (26 around).
pub(super) struct Voxels {
    /// Means of their points.
    pub(super) means: Vec<Point3<f32>>,
    /// Voxel of each point; `NONE` if it is not finite.
    pub(super) of_point: Vec<u32>,
    starts: Vec<u32>,
    neighbors: Vec<u32>,
}

impl Voxels {
    /// # Errors
    /// `VoxelTooSmall`.
    pub(super) fn new(points: &[Point3<f32>], size: f64) -> Result<Self, CloudError> {
        let far = points.iter().filter(|p| is_finite(p)).map(|p| p.coords.amax()).fold(0.0f32, f32::max);
        let limit = f64::from(i32::MAX / 2);
        if f64::from(far) / size > limit {
            let (coordinate_m, at_least_m) = (f64::from(far), f64::from(far) / limit);
            return Err(CloudError::VoxelTooSmall { voxel_size_m: size, coordinate_m, at_least_m });
        }
        let mut ids: FxHashMap<[i32; 3], u32> = FxHashMap::default();
        let mut cells: Vec<[i32; 3]> = Vec::new();
        let mut sums: Vec<[f64; 4]> = Vec::new();
        let of_point = points.iter().map(|p| {
            if !is_finite(p) {
                return NONE;
            }
            let cell = std::array::from_fn(|a| (f64::from(p[a]) / size).floor() as i32);
            let id = *ids.entry(cell).or_insert_with(|| {
                cells.push(cell);
                sums.push([0.0; 4]);
                cells.len() as u32 - 1
            });
            let sum = &mut sums[id as usize];
            (0..3).for_each(|a| sum[a] += f64::from(p[a]));
            sum[3] += 1.0;
            id
        });
        let of_point = of_point.collect();
        let means = sums.iter().map(|s| Point3::new(s[0] / s[3], s[1] / s[3], s[2] / s[3]).cast()).collect();
        let (mut starts, mut neighbors) = (vec![0], Vec::new());
        for cell in &cells {
            for step in (0..27).filter(|&step| step != 13) {
                let near = [cell[0] + step / 9 - 1, cell[1] + step / 3 % 3 - 1, cell[2] + step % 3 - 1];
                neighbors.extend(ids.get(&near));
            }
            starts.push(neighbors.len() as u32);
        }
        Ok(Self { means, of_point, starts, neighbors })
    }

    pub(super) fn len(&self) -> usize {
        self.means.len()
    }

    /// Voxels that touch this one.
    pub(super) fn around(&self, voxel: u32) -> &[u32] {
        &self.neighbors[self.starts[voxel as usize] as usize..self.starts[voxel as usize + 1] as usize]
    }
}

//! Small patches of even surface.

use super::voxels::{NONE, Voxels};
use crate::cloud::{CloudError, NormalParams, Scatter, estimate_normals, positive, symmetric_eigen3};
use nalgebra::{Point3, Vector3};
use percept_geometry::GeometryError;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// How [`supervoxels`] grow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervoxelParams {
    /// Edge of the voxels that supervoxels are made of, metres; two to three times the spacing of points.
    pub voxel_size_m: f64,
    /// Distance of the seeds, metres; a fraction of the smallest object.
    pub seed_size_m: f64,
    /// Radius of the neighbourhood of a voxel's normal, metres.
    pub normal_radius_m: f64,
    /// Weight of the distance in space, in seed distances.
    pub spatial_weight: f64,
    /// Weight of the turn of the normal (one less its cosine).
    pub normal_weight: f64,
}

impl Default for SupervoxelParams {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.0075,
            seed_size_m: 0.04,
            normal_radius_m: 0.0165,
            spatial_weight: 1.0,
            normal_weight: 4.0,
        }
    }
}

impl SupervoxelParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("voxel_size_m", self.voxel_size_m)?;
        positive("normal_radius_m", self.normal_radius_m)?;
        positive("spatial_weight", self.spatial_weight)?;
        positive("normal_weight", self.normal_weight)?;
        positive("seed_size_m", self.seed_size_m)?;
        if self.seed_size_m < self.voxel_size_m || self.seed_size_m > 100.0 * self.voxel_size_m {
            let requirement = "from one to a hundred voxels";
            return Err(GeometryError::OutOfRange { field: "seed_size_m", value: self.seed_size_m, requirement });
        }
        Ok(())
    }
}

/// A patch of even surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supervoxel {
    /// Mean of its voxels, metres.
    pub center: Point3<f64>,
    /// Unit normal of the plane through them, towards the viewpoint.
    pub normal: Vector3<f64>,
    /// Number of its voxels.
    pub num_voxels: usize,
}

/// A cloud in supervoxels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Supervoxels {
    /// N, the supervoxel of each point; none far from every seed.
    pub labels: Vec<Option<u32>>,
    /// The supervoxels.
    pub supervoxels: Vec<Supervoxel>,
    /// Pairs that touch, the smaller first, ascending.
    pub edges: Vec<(u32, u32)>,
}

/// Patches of about `seed_size_m` that keep to one surface: seeds grow over touching voxels, each voxel going to the
/// seed that is nearest in space and normal. Normals are turned to `viewpoint` (metres).
///
/// Source: Papon et al., "Voxel cloud connectivity segmentation: supervoxels for point clouds", 2013, without colour.
///
/// # Errors
/// `OutOfRange` naming the parameter, `VoxelTooSmall`.
pub fn supervoxels(
    points: &[Point3<f32>],
    viewpoint: &Point3<f64>,
    params: &SupervoxelParams,
) -> Result<Supervoxels, CloudError> {
    params.validate()?;
    let voxels = Voxels::new(points, params.voxel_size_m)?;
    let around = NormalParams { radius_m: params.normal_radius_m, max_neighbours: 40, ..NormalParams::default() };
    let normals = estimate_normals(&voxels.means, &around, Some(viewpoint))?;
    let mut growth = Growth::new(&voxels, &normals, params);
    growth.run();
    Ok(growth.finish(viewpoint))
}

/// The centre that voxels are compared with.
#[derive(Clone, Copy)]
struct Center {
    position: Vector3<f64>,
    normal: Vector3<f64>,
}

struct Growth<'a> {
    voxels: &'a Voxels,
    normals: &'a [Vector3<f32>],
    params: &'a SupervoxelParams,
    centers: Vec<Center>,
    owner: Vec<u32>,
    distance: Vec<f64>,
    rounds: usize,
}

impl<'a> Growth<'a> {
    fn new(voxels: &'a Voxels, normals: &'a [Vector3<f32>], params: &'a SupervoxelParams) -> Self {
        let mut out = Self {
            voxels,
            normals,
            params,
            centers: Vec::new(),
            owner: vec![NONE; voxels.len()],
            distance: vec![f64::INFINITY; voxels.len()],
            // A voxel is at most this many steps from the seed of its place.
            rounds: (1.8 * params.seed_size_m / params.voxel_size_m).ceil() as usize,
        };
        for (label, seed) in (0..).zip(out.seeds()) {
            out.centers.push(out.voxel(seed));
            (out.owner[seed as usize], out.distance[seed as usize]) = (label, 0.0);
        }
        out
    }

    /// In each cube of the seeds' distance the voxel next to the middle of those in it.
    fn seeds(&self) -> Vec<u32> {
        let size = self.params.seed_size_m;
        let mut best: FxHashMap<[i32; 3], (f64, u32)> = FxHashMap::default();
        let mut cells = Vec::new();
        for (p, voxel) in self.voxels.means.iter().zip(0u32..) {
            let cell: [i32; 3] = std::array::from_fn(|a| (f64::from(p[a]) / size).floor() as i32);
            let middle = Vector3::from(cell.map(|c| (f64::from(c) + 0.5) * size));
            let off = (p.coords.cast() - middle).norm_squared();
            let entry = best.entry(cell).or_insert_with(|| {
                cells.push(cell);
                (off, voxel)
            });
            if off < entry.0 {
                *entry = (off, voxel);
            }
        }
        cells.iter().map(|cell| best[cell].1).collect()
    }

    fn voxel(&self, voxel: u32) -> Center {
        let position = self.voxels.means[voxel as usize].coords.cast();
        Center { position, normal: self.normals[voxel as usize].cast() }
    }

    fn distance(&self, center: &Center, voxel: u32) -> f64 {
        let at = self.voxel(voxel);
        let apart = (at.position - center.position).norm() / self.params.seed_size_m;
        self.params.spatial_weight * apart + self.params.normal_weight * (1.0 - at.normal.dot(&center.normal).abs())
    }

    /// All grow by one voxel a round, so that none flows around another; then centres move.
    fn run(&mut self) {
        for _ in 0..self.rounds {
            let mut next = self.owner.clone();
            let mut changed = false;
            for voxel in 0..self.voxels.len() as u32 {
                for &near in self.voxels.around(voxel) {
                    let label = self.owner[near as usize];
                    if label == NONE || label == next[voxel as usize] {
                        continue;
                    }
                    let distance = self.distance(&self.centers[label as usize], voxel);
                    if distance < self.distance[voxel as usize] {
                        self.distance[voxel as usize] = distance;
                        next[voxel as usize] = label;
                        changed = true;
                    }
                }
            }
            self.owner = next;
            if !changed {
                return;
            }
            self.recenter();
        }
    }

    fn recenter(&mut self) {
        let zero = Center { position: Vector3::zeros(), normal: Vector3::zeros() };
        let mut sums = vec![(0.0, zero); self.centers.len()];
        for (voxel, &label) in (0u32..).zip(&self.owner).filter(|(_, l)| **l != NONE) {
            let (count, sum) = &mut sums[label as usize];
            let at = self.voxel(voxel);
            *count += 1.0;
            sum.position += at.position;
            sum.normal += at.normal;
        }
        for (center, (count, sum)) in self.centers.iter_mut().zip(sums) {
            if count > 0.0 {
                let normal = sum.normal.try_normalize(1e-9).unwrap_or(center.normal);
                *center = Center { position: sum.position / count, normal };
            }
        }
        for voxel in 0..self.owner.len() {
            let label = self.owner[voxel];
            if label != NONE {
                self.distance[voxel] = self.distance(&self.centers[label as usize], voxel as u32);
            }
        }
    }

    /// Numbers what has voxels, with a plane through each.
    fn finish(self, viewpoint: &Point3<f64>) -> Supervoxels {
        let mut scatters: Vec<Option<Scatter>> = vec![None; self.centers.len()];
        for (p, &label) in self.voxels.means.iter().zip(&self.owner).filter(|(_, l)| **l != NONE) {
            scatters[label as usize].get_or_insert_with(|| Scatter::new(p.cast())).add(&p.cast());
        }
        let mut number = vec![None; scatters.len()];
        let mut out = Supervoxels::default();
        for ((scatter, center), number) in scatters.iter().zip(&self.centers).zip(&mut number) {
            if let Some(scatter) = scatter {
                *number = Some(out.supervoxels.len() as u32);
                out.supervoxels.push(summary(scatter, center, viewpoint));
            }
        }
        let of_voxel: Vec<Option<u32>> =
            self.owner.iter().map(|&l| if l == NONE { None } else { number[l as usize] }).collect();
        for voxel in 0..self.voxels.len() as u32 {
            let Some(a) = of_voxel[voxel as usize] else { continue };
            let others = self.voxels.around(voxel).iter().filter_map(|&near| of_voxel[near as usize]);
            out.edges.extend(others.filter(|&b| b > a).map(|b| (a, b)));
        }
        out.edges.sort_unstable();
        out.edges.dedup();
        out.labels =
            self.voxels.of_point.iter().map(|&v| if v == NONE { None } else { of_voxel[v as usize] }).collect();
        out
    }
}

fn summary(scatter: &Scatter, center: &Center, viewpoint: &Point3<f64>) -> Supervoxel {
    let mean = scatter.mean();
    // Few voxels span no plane of their own.
    let plane = symmetric_eigen3(&scatter.covariance()).vectors[0];
    let mut normal = if scatter.num_points() >= 5 { plane } else { center.normal };
    if normal.dot(&(viewpoint - mean)) < 0.0 {
        normal = -normal;
    }
    Supervoxel { center: mean, normal, num_voxels: scatter.num_points() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_supervoxel_goes_around_the_edge_of_a_box() {
        // Two faces of a box, 5 mm apart points, seen from above.
        let face = |i: i32| ((i % 60) as f32 * 0.005, (i / 60) as f32 * 0.005);
        let mut points: Vec<Point3<f32>> = (0..3600).map(face).map(|(a, b)| Point3::new(a, b, 0.0)).collect();
        points.extend((0..3600).map(face).map(|(a, b)| Point3::new(a, 0.0, -0.005 - b)));
        let viewpoint = Point3::new(0.1, -1.0, 1.0);
        let found = supervoxels(&points, &viewpoint, &SupervoxelParams::default()).unwrap();
        let mut on = vec![[0, 0]; found.supervoxels.len()];
        for (i, label) in found.labels.iter().enumerate() {
            on[label.unwrap() as usize][usize::from(i >= 3600)] += 1;
        }
        let mixed: usize = on.iter().map(|[a, b]| a.min(b)).sum();
        assert!(mixed < points.len() / 20, "{mixed}");
        assert!((60..200).contains(&found.supervoxels.len()), "{}", found.supervoxels.len());
        let upright = found.supervoxels.iter().filter(|s| s.normal.z > 0.95 || s.normal.y < -0.95).count();
        assert!(10 * upright >= 9 * found.supervoxels.len());
    }

    #[test]
    fn degenerate_clouds_have_few_supervoxels() {
        let with = |points: &[Point3<f32>]| {
            supervoxels(points, &Point3::origin(), &SupervoxelParams::default()).unwrap().supervoxels.len()
        };
        assert_eq!(with(&[]), 0);
        assert_eq!(with(&[Point3::from([f32::NAN; 3])]), 0);
        assert_eq!(with(&[Point3::new(1.0, 2.0, 3.0); 9]), 1);
        assert!(supervoxels(&[Point3::new(3e38, 0.0, 0.0)], &Point3::origin(), &SupervoxelParams::default()).is_err());
    }
}

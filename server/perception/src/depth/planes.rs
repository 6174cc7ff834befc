//! Planes straight from a depth image: connected regions.

use super::{RayTable, VertexMap, positive};
use crate::cloud::{Scatter, symmetric_eigen3};
use nalgebra::{Point3, Unit};
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError, Plane};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What counts as a plane of a depth image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthPlaneParams {
    /// Side of a cell, pixels, 4 to 64; no plane narrower than two cells is found for certain.
    pub cell_px: usize,
    /// Noise of a depth at 1 m, metres; it grows with the square of the depth. A cell is flat within three of it.
    pub noise_at_1m_m: f64,
    /// Largest angle between a cell's normal and its region's, radians.
    pub max_angle_rad: f64,
    /// Largest distance of a pixel from its plane, metres, where noise asks for no more.
    pub max_distance_m: f64,
    /// Pixels of a plane at least.
    pub min_pixels: usize,
}

impl Default for DepthPlaneParams {
    fn default() -> Self {
        Self { cell_px: 10, noise_at_1m_m: 0.002, max_angle_rad: 0.26, max_distance_m: 0.02, min_pixels: 2000 }
    }
}

impl DepthPlaneParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("noise_at_1m_m", self.noise_at_1m_m)?;
        positive("max_angle_rad", self.max_angle_rad)?;
        positive("max_distance_m", self.max_distance_m)?;
        if !(4..=64).contains(&self.cell_px) {
            let value = self.cell_px as f64;
            return Err(GeometryError::OutOfRange { field: "cell_px", value, requirement: "between 4 and 64" });
        }
        Ok(())
    }

    /// Distance from a plane that a pixel at depth `z` may have, metres.
    fn reach(&self, z: f64) -> f64 {
        self.max_distance_m.max(3.0 * self.noise_at_1m_m * z * z)
    }
}

/// One connected planar region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPlane {
    /// The plane, optical frame, normal facing the camera.
    pub plane: Plane,
    /// Mean of its points, metres.
    pub center: Point3<f64>,
    /// Pixels that lie on it.
    pub num_pixels: usize,
    /// Root mean square distance of its points from it, metres.
    pub rms_m: f64,
}

/// The planes of an image and who lies on them.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthPlanes {
    /// Largest first.
    pub planes: Vec<DepthPlane>,
    /// `H x W` row-major: index into `planes`, or none.
    pub labels: Vec<Option<u16>>,
}

/// Finds the connected planes of a depth image: flat cells, grown into regions from the flattest on, merged where they
/// meet on one plane, and taken to the pixel.
///
/// Source: Proença and Gao, "Fast cylinder and plane extraction from depth cameras (CAPE)", 2018, for cells and growing;
/// Feng, Taguchi and Kamat, "Fast plane extraction in organized point clouds using agglomerative hierarchical
/// clustering", 2014, for merging by error and for growing to the pixel.
///
/// # Errors
/// `OutOfRange` naming the parameter; `ShapeMismatch` if the image is not of the intrinsics' size.
pub fn depth_planes(
    depth: &DepthImage,
    intrinsics: &CameraIntrinsics,
    params: &DepthPlaneParams,
) -> Result<DepthPlanes, GeometryError> {
    params.validate()?;
    let vertices = VertexMap::new(depth, &RayTable::new(intrinsics)?)?;
    let cells = Cells::new(&vertices, params);
    let (mut regions, cell_regions) = cells.grow(params);
    let regions_of = merge(&mut regions, &cell_regions, &cells, params);
    let labels = refine(&vertices, &cells, &cell_regions, &regions_of, &regions, params);
    Ok(finish(&vertices, labels, regions.len(), params))
}

/// A least-squares plane and what it explains.
#[derive(Clone, Copy)]
struct Fit {
    scatter: Scatter,
    plane: Plane,
    /// Mean squared distance.
    error: f64,
}

impl Fit {
    fn new(scatter: Scatter) -> Self {
        let eigen = symmetric_eigen3(&scatter.covariance());
        let mean = scatter.mean();
        let facing = if eigen.vectors[0].dot(&mean.coords) > 0.0 { -eigen.vectors[0] } else { eigen.vectors[0] };
        let plane = Plane::through(&mean, Unit::new_normalize(facing));
        Self { scatter, plane, error: eigen.values[0].max(0.0) }
    }

    fn with(&self, other: &Self) -> Self {
        Self::new(self.scatter.merged(&other.scatter))
    }

    fn agrees(&self, other: &Self, params: &DepthPlaneParams) -> bool {
        let mean = other.scatter.mean();
        self.plane.normal.dot(&other.plane.normal) > params.max_angle_rad.cos()
            && self.plane.distance(&mean).abs() < params.reach(mean.z)
    }
}

/// The image in squares; those that are flat have a plane.
struct Cells {
    columns: usize,
    side: usize,
    fits: Vec<Option<Fit>>,
}

impl Cells {
    fn new(vertices: &VertexMap, params: &DepthPlaneParams) -> Self {
        let side = params.cell_px;
        let (columns, rows) = (vertices.width / side, vertices.height / side);
        let fit = |c: usize| flat_cell(vertices, c % columns * side, c / columns * side, params);
        Self { columns, side, fits: (0..columns * rows).map(fit).collect() }
    }

    fn neighbours(&self, c: usize) -> impl Iterator<Item = usize> {
        let (u, n, columns) = (c % self.columns, self.fits.len(), self.columns);
        let sides = [
            (u > 0, -1),
            (u + 1 < columns, 1),
            (c >= columns, -(columns as isize)),
            (c + columns < n, columns as isize),
        ];
        sides.into_iter().filter(|s| s.0).map(move |s| c.wrapping_add_signed(s.1))
    }

    /// Regions of cells, and the region of each cell.
    fn grow(&self, params: &DepthPlaneParams) -> (Vec<Fit>, Vec<Option<usize>>) {
        let mut order: Vec<usize> = (0..self.fits.len()).filter(|&c| self.fits[c].is_some()).collect();
        let error = |c: usize| self.fits[c].map_or(f64::INFINITY, |f| f.error / f.scatter.mean().z.powi(4));
        order.sort_by(|&a, &b| error(a).total_cmp(&error(b)));
        let (mut regions, mut of) = (Vec::new(), vec![None; self.fits.len()]);
        for seed in order {
            let (None, Some(mut fit)) = (of[seed], self.fits[seed]) else { continue };
            let mut queue = VecDeque::from([seed]);
            of[seed] = Some(regions.len());
            while let Some(c) = queue.pop_front() {
                for n in self.neighbours(c) {
                    let (None, Some(next)) = (of[n], &self.fits[n]) else { continue };
                    if fit.agrees(next, params) {
                        of[n] = Some(regions.len());
                        fit = fit.with(next);
                        queue.push_back(n);
                    }
                }
            }
            regions.push(fit);
        }
        (regions, of)
    }
}

/// The plane of a cell without holes to speak of, without jumps, and flat.
fn flat_cell(vertices: &VertexMap, u0: usize, v0: usize, params: &DepthPlaneParams) -> Option<Fit> {
    let side = params.cell_px;
    let points = (0..side * side).filter_map(|i| vertices.at(u0 + i % side, v0 + i / side));
    let mut scatter: Option<Scatter> = None;
    let (mut near, mut far) = (f32::INFINITY, 0.0f32);
    for p in points {
        (near, far) = (near.min(p.z), far.max(p.z));
        scatter.get_or_insert_with(|| Scatter::new(p.cast())).add(&p.cast());
    }
    let scatter = scatter.filter(|s| 4 * s.num_points() > 3 * side * side)?;
    let fit = Fit::new(scatter);
    let noise = 3.0 * params.noise_at_1m_m * scatter.mean().z.powi(2);
    (fit.error <= noise * noise && f64::from(far - near) < 0.3 * f64::from(near)).then_some(fit)
}

/// Joins regions that touch and lie on one plane; tells the region that each became part of.
fn merge(regions: &mut [Fit], of: &[Option<usize>], cells: &Cells, params: &DepthPlaneParams) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..regions.len()).collect();
    fn root(parent: &[usize], mut r: usize) -> usize {
        while parent[r] != r {
            r = parent[r];
        }
        r
    }
    for _ in 0..3 {
        for c in 0..of.len() {
            for n in cells.neighbours(c) {
                let (Some(a), Some(b)) = (of[c], of[n]) else { continue };
                let (a, b) = (root(&parent, a), root(&parent, b));
                if a == b || !(regions[a].agrees(&regions[b], params) && regions[b].agrees(&regions[a], params)) {
                    continue;
                }
                let (keep, drop) = (a.min(b), a.max(b));
                let joined = regions[keep].with(&regions[drop]);
                if joined.error.sqrt() <= params.reach(joined.scatter.mean().z) {
                    regions[keep] = joined;
                    parent[drop] = keep;
                }
            }
        }
    }
    (0..regions.len()).map(|r| root(&parent, r)).collect()
}

const FREE: u32 = u32::MAX;

/// Pixels of flat cells, then their neighbours as long as they lie on the plane.
fn refine(
    vertices: &VertexMap,
    cells: &Cells,
    of: &[Option<usize>],
    regions_of: &[usize],
    regions: &[Fit],
    params: &DepthPlaneParams,
) -> Vec<u32> {
    let (w, h) = (vertices.width, vertices.height);
    let mut labels = vec![FREE; w * h];
    let mut queue = VecDeque::new();
    let on = |region: usize, i: usize| {
        let p = vertices.points[i];
        !p.z.is_nan() && regions[region].plane.distance(&p.cast()).abs() < params.reach(f64::from(p.z))
    };
    // Small regions are noise on their way to a plane: their cells are left to those that grow over them.
    let mut cells_of = vec![0usize; regions.len()];
    of.iter().flatten().for_each(|&r| cells_of[regions_of[r]] += 1);
    for (c, region) in of.iter().enumerate() {
        let Some(region) = region.map(|r| regions_of[r]).filter(|&r| cells_of[r] >= 4) else { continue };
        let (u0, v0) = (c % cells.columns * cells.side, c / cells.columns * cells.side);
        for i in 0..cells.side * cells.side {
            let i = (v0 + i / cells.side) * w + u0 + i % cells.side;
            if on(region, i) {
                labels[i] = region as u32;
                queue.push_back(i);
            }
        }
    }
    while let Some(i) = queue.pop_front() {
        let (u, v) = (i % w, i / w);
        let sides = [(u > 0, i.wrapping_sub(1)), (u + 1 < w, i + 1), (v > 0, i.wrapping_sub(w)), (v + 1 < h, i + w)];
        for (_, n) in sides.into_iter().filter(|s| s.0) {
            if labels[n] == FREE && on(labels[i] as usize, n) {
                labels[n] = labels[i];
                queue.push_back(n);
            }
        }
    }
    labels
}

/// Fits each region's pixels once more, drops small ones, sorts by size.
fn finish(vertices: &VertexMap, labels: Vec<u32>, num_regions: usize, params: &DepthPlaneParams) -> DepthPlanes {
    let mut scatters: Vec<Option<Scatter>> = vec![None; num_regions];
    for (p, &label) in vertices.points.iter().zip(&labels).filter(|(_, l)| **l != FREE) {
        scatters[label as usize].get_or_insert_with(|| Scatter::new(p.cast())).add(&p.cast());
    }
    let big = |s: &Scatter| s.num_points() >= params.min_pixels.max(3);
    let mut kept: Vec<(usize, Fit)> =
        scatters.iter().enumerate().filter_map(|(r, s)| s.filter(big).map(|s| (r, Fit::new(s)))).collect();
    kept.sort_by_key(|(r, fit)| (std::cmp::Reverse(fit.scatter.num_points()), *r));
    kept.truncate(usize::from(u16::MAX));
    let mut rank = vec![None; num_regions];
    kept.iter().enumerate().for_each(|(k, (r, _))| rank[*r] = Some(k as u16));
    let plane = |fit: &Fit| DepthPlane {
        plane: fit.plane,
        center: fit.scatter.mean(),
        num_pixels: fit.scatter.num_points(),
        rms_m: fit.error.sqrt(),
    };
    DepthPlanes {
        planes: kept.iter().map(|(_, fit)| plane(fit)).collect(),
        labels: labels.iter().map(|&l| if l == FREE { None } else { rank[l as usize] }).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn a_room_is_floor_and_walls_and_two_tables_of_one_height_are_two() {
        let camera = CameraIntrinsics::pinhole(320, 240, 260.0, 260.0, 159.5, 119.5);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        // Floor 1 m below, wall 4 m ahead, wall 2 m to the right; two tops 0.4 m below, apart in x.
        let data = (0..320 * 240).map(|i| {
            let ray = camera.ray((i % 320) as f64, (i / 320) as f64);
            let mut z = 4.0f64;
            if ray.y > 0.0 {
                z = z.min(1.0 / ray.y);
                let top = 0.4 / ray.y;
                let x = ray.x * top;
                if (1.5..2.6).contains(&top) && ((-1.2..-0.4).contains(&x) || (0.2..0.9).contains(&x)) {
                    z = z.min(top);
                }
            }
            if ray.x > 0.0 {
                z = z.min(2.0 / ray.x);
            }
            (z + 0.001 * z * z * rng.random_range(-1.0..1.0)) as f32
        });
        let depth = DepthImage::new(320, 240, data.collect()).unwrap();
        let params = DepthPlaneParams { min_pixels: 600, ..Default::default() };
        let found = depth_planes(&depth, &camera, &params).unwrap();
        let expected = [(-Vector3::y(), 1.0), (-Vector3::z(), 4.0), (-Vector3::x(), 2.0), (-Vector3::y(), 0.4)];
        for (normal, offset) in expected {
            let like = |p: &&DepthPlane| p.plane.normal.angle(&normal) < 0.03 && (p.plane.offset - offset).abs() < 0.03;
            let count = found.planes.iter().filter(like).count();
            assert_eq!(count, if offset == 0.4 { 2 } else { 1 }, "{normal} {offset}: {:?}", found.planes);
        }
        assert_eq!(found.planes.len(), 5);
        let labelled = found.labels.iter().filter(|l| l.is_some()).count();
        assert!(labelled > 320 * 240 * 95 / 100, "{labelled}");
    }

    #[test]
    fn nothing_flat_gives_nothing() {
        let camera = CameraIntrinsics::pinhole(64, 48, 60.0, 60.0, 31.5, 23.5);
        let empty = DepthImage::new(64, 48, vec![0.0; 64 * 48]).unwrap();
        assert!(depth_planes(&empty, &camera, &DepthPlaneParams::default()).unwrap().planes.is_empty());
    }
}

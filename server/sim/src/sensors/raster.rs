//! What a pinhole camera sees, without noise: for every pixel the first solid on its ray.
//!
//! Solids are sorted by depth and binned into tiles of the image, so that a pixel tries only the few
//! that can be on its ray. The result equals casting every ray through the tree, which tests hold it to.

use crate::solid::Solid;
use crate::world::View;
use nalgebra::{Point3, Vector3};
use percept_geometry::{CameraIntrinsics, Pose};
use rayon::prelude::*;

/// Edge of a tile, pixels.
const TILE: usize = 16;
/// Nothing is nearer to a camera than this, metres.
const NEAR_M: f64 = 0.02;
/// Corner pairs that are the edges of a box, by the bits of [`Solid::corners`].
const EDGES: [(usize, usize); 12] =
    [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)];

/// What one pixel sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    /// Depth along the optical axis, metres; infinite if nothing is there.
    pub(crate) depth: f32,
    /// Cosine of the angle between ray and normal.
    pub(crate) cos_incidence: f32,
    /// Which solid of the view.
    pub(crate) solid: u32,
    /// Shaded colour.
    pub(crate) rgb: [u8; 3],
}

const NOTHING: Sample = Sample { depth: f32::INFINITY, cos_incidence: 1.0, solid: u32::MAX, rgb: [0; 3] };

/// A solid seen from the camera.
struct Candidate<'a> {
    solid: &'a Solid,
    index: u32,
    origin_local: Point3<f64>,
    near: f64,
    /// Columns and rows that it can cover, `u0, u1, v0, v1`.
    rect: [f64; 4],
}

/// `H x W` samples, row-major, from a rectified camera at `t_world_optical`.
pub(crate) fn render(view: &View<'_>, t_world_optical: &Pose, camera: &CameraIntrinsics) -> Vec<Sample> {
    let t_optical_world = t_world_optical.inverse();
    let origin = Point3::from(t_world_optical.translation.vector);
    let mut candidates: Vec<Candidate<'_>> = view
        .solids()
        .enumerate()
        .filter_map(|(index, solid)| candidate(solid, index as u32, &origin, &t_optical_world, camera))
        .collect();
    candidates.sort_by(|a, b| a.near.total_cmp(&b.near).then(a.index.cmp(&b.index)));
    let rotation = t_world_optical.rotation.to_rotation_matrix();
    let axes: [Vector3<f64>; 3] = std::array::from_fn(|i| rotation.matrix().column(i).into_owned());
    let mut samples = vec![NOTHING; camera.width * camera.height];
    samples.par_chunks_mut(TILE * camera.width).enumerate().for_each(|(band, rows)| {
        let v0 = band * TILE;
        let v1 = v0 + rows.len() / camera.width;
        for u0 in (0..camera.width).step_by(TILE) {
            let u1 = (u0 + TILE).min(camera.width);
            let here: Vec<&Candidate<'_>> = candidates
                .iter()
                .filter(|c| {
                    c.rect[0] <= u1 as f64
                        && c.rect[1] >= u0 as f64 - 1.0
                        && c.rect[2] <= v1 as f64
                        && c.rect[3] >= v0 as f64 - 1.0
                })
                .collect();
            for v in v0..v1 {
                let y = (v as f64 - camera.cy) / camera.fy;
                for u in u0..u1 {
                    let x = (u as f64 - camera.cx) / camera.fx;
                    let direction = axes[0] * x + axes[1] * y + axes[2];
                    rows[(v - v0) * camera.width + u] = look(&here, &origin, &direction);
                }
            }
        }
    });
    samples
}

fn look(candidates: &[&Candidate<'_>], origin: &Point3<f64>, direction: &Vector3<f64>) -> Sample {
    let (mut depth, mut best) = (f64::INFINITY, None);
    for c in candidates {
        if c.near > depth {
            break;
        }
        let local = c.solid.frame.vector_to_local(direction);
        if let Some(t) = c.solid.shape.intersect(&c.origin_local, &local)
            && t < depth
        {
            (depth, best) = (t, Some(c));
        }
    }
    let Some(c) = best else { return NOTHING };
    let (normal, color) = c.solid.appearance(&(origin + direction * depth));
    Sample {
        depth: depth as f32,
        cos_incidence: (normal.dot(direction).abs() / direction.norm()) as f32,
        solid: c.index,
        rgb: color.map(|c| (c * 255.0 + 0.5) as u8),
    }
}

/// Where a solid can appear; none if it is behind the camera or outside of the image.
fn candidate<'a>(
    solid: &'a Solid,
    index: u32,
    origin: &Point3<f64>,
    t_optical_world: &Pose,
    camera: &CameraIntrinsics,
) -> Option<Candidate<'a>> {
    let corners = solid.corners().map(|p| t_optical_world * p);
    let near = corners.iter().map(|p| p.z).fold(f64::INFINITY, f64::min).max(NEAR_M);
    let mut rect = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let mut cover = |p: &Point3<f64>| {
        let (u, v) = (camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
        rect = [rect[0].min(u), rect[1].max(u), rect[2].min(v), rect[3].max(v)];
    };
    corners.iter().filter(|p| p.z >= NEAR_M).for_each(&mut cover);
    for (a, b) in EDGES.map(|(a, b)| (corners[a], corners[b])) {
        if (a.z < NEAR_M) != (b.z < NEAR_M) {
            // Where the edge passes through the near plane.
            let s = (NEAR_M - a.z) / (b.z - a.z);
            let p = a + (b - a) * s;
            cover(&Point3::new(p.x, p.y, NEAR_M));
        }
    }
    let visible =
        rect[0] <= camera.width as f64 && rect[1] >= -1.0 && rect[2] <= camera.height as f64 && rect[3] >= -1.0;
    visible.then(|| Candidate { solid, index, origin_local: solid.frame.to_local(origin), near, rect })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RobotParams, RobotPath, World, WorldParams};
    use percept_geometry::SensorSpec;

    #[test]
    fn tiles_show_what_the_tree_of_boxes_shows() {
        for seed in 0..4 {
            let world = World::generate(&WorldParams { seed, ..WorldParams::default() }).unwrap();
            let path = RobotPath::new(&world, &RobotParams::default()).unwrap();
            let camera = CameraIntrinsics::pinhole(80, 60, 65.0, 65.0, 39.5, 29.5);
            for k in 0..6 {
                let t = f64::from(k) / 6.0 * path.lap_duration_s();
                let mut t_base_optical = crate::sensors::mount(0.1, 0.6, 0.12, 0.0);
                t_base_optical.rotation *= SensorSpec::optical_rotation();
                let pose = path.pose_at(t) * t_base_optical;
                let view = world.view(t);
                let samples = render(&view, &pose, &camera);
                for (i, sample) in samples.iter().enumerate() {
                    let ray = camera.ray((i % 80) as f64, (i / 80) as f64).coords;
                    let hit = view.cast(&Point3::from(pose.translation.vector), &(pose.rotation * ray), 1e9);
                    let depth = hit.map_or(f64::INFINITY, |h| h.0);
                    assert!((f64::from(sample.depth) - depth).abs() < 1e-5, "pixel {i}: {} {depth}", sample.depth);
                }
            }
        }
    }
}

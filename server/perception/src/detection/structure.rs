//! Floor and walls: what objects stand on and before.

use super::DetectionParams;
use super::walls::{Wall, find_walls};
use crate::cloud::{CloudError, NormalParams, PlaneParams, estimate_normals, segment_among, voxel_downsample};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Plane, PointCloud};

/// A floor tilts at most this much against z: what the pose may be off, not what ramps have. 8 degrees.
const MAX_TILT_COS: f64 = 0.99;

/// What holds a room together.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// The floor, normal upward.
    pub floor: Plane,
    /// Walls, longest support first.
    pub walls: Vec<Wall>,
}

impl Structure {
    /// Height of a point above the floor, metres.
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.floor.distance(p)
    }

    /// Whether a point lies in a wall or on its surface, `margin` metres around it.
    pub fn in_wall(&self, p: &Point3<f64>, margin: f64) -> bool {
        self.walls.iter().any(|w| w.contains(p, margin)) || self.between_walls(p)
    }

    /// Distance to the nearest wall's surface, metres, infinite if there is none beside the point.
    pub fn wall_distance(&self, p: &Point3<f64>) -> f64 {
        self.walls.iter().filter(|w| w.is_beside(p)).map(|w| w.distance(p).abs()).fold(f64::INFINITY, f64::min)
    }

    /// Whether a point is inside a wall of which both faces are known: jambs and lintels are.
    fn between_walls(&self, p: &Point3<f64>) -> bool {
        self.walls.iter().enumerate().any(|(i, a)| {
            let d = a.distance(p);
            d.abs() < MAX_THICKNESS_M
                && a.is_near_run(p)
                && self.walls[..i].iter().any(|b| {
                    let turn = a.normal.dot(&b.normal);
                    let across = b.distance(p) * turn.signum();
                    // On opposite sides of two parallel faces.
                    turn.abs() > 0.996 && d * across < 0.0 && (d - across).abs() < MAX_THICKNESS_M && b.is_near_run(p)
                })
        })
    }
}

/// Two parallel faces at most this far apart are the two sides of one wall, metres.
const MAX_THICKNESS_M: f64 = 0.35;

/// Finds floor and walls among thinned points (finite, z up). Walls are large: they are looked for with a
/// quarter of the points.
///
/// # Errors
/// `Input` naming a parameter.
pub fn find_structure(points: &[Point3<f32>], params: &DetectionParams) -> Result<Structure, CloudError> {
    let floor = find_floor(points, params);
    let standing = points.iter().filter(|p| floor.distance(&p.cast()) > params.floor_margin_m);
    let spacing = 2.0 * params.voxel_size_m;
    let coarse = voxel_downsample(&PointCloud::from_positions(standing.copied().collect()), spacing)?.positions;
    // Not as far as the other face of a thin wall (0.15 m with the defaults): the two together have no direction.
    let normals = NormalParams { radius_m: 1.45 * spacing, max_neighbours: 12, min_neighbours: 4 };
    let normals = estimate_normals(&coarse, &normals, None)?;
    Ok(Structure { walls: find_walls(&coarse, &normals, &floor, spacing, params), floor })
}

/// The best nearly level plane near z = 0; without one, the level of the lowest points seen there; z = 0 if
/// nothing is.
fn find_floor(points: &[Point3<f32>], params: &DetectionParams) -> Plane {
    let reach = params.floor_search_m as f32;
    let low: Vec<u32> = (0..points.len() as u32).filter(|&i| points[i as usize].z.abs() <= reach).collect();
    let search = PlaneParams {
        distance_m: 0.5 * params.floor_margin_m,
        max_iterations: 400,
        min_points: params.min_points.max(30),
        seed: params.seed,
        ..PlaneParams::default()
    };
    let found = segment_among(points, &low, &search, |n: &Vector3<f64>| n.z.abs() >= MAX_TILT_COS);
    // A plane of a fifth of what is low there is the floor; less is the edge of something.
    if let Some(segment) = found.filter(|s| 5 * s.inliers.len() >= low.len()) {
        return segment.plane;
    }
    let mut heights: Vec<f32> = low.iter().map(|&i| points[i as usize].z).collect();
    heights.sort_unstable_by(f32::total_cmp);
    let level = heights.get(heights.len() / 20).copied().filter(|_| heights.len() >= 20).unwrap_or(0.0);
    Plane::through(&Point3::new(0.0, 0.0, f64::from(level)), Vector3::z_axis())
}

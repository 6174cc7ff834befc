//! Which way a thing's sides face.

use crate::cloud::{NormalParams, estimate_normals};
use nalgebra::{Point3, Vector2};

/// Normals are told by what lies so near, metres.
const RADIUS_M: f64 = 0.15;
/// Of fewer normals nothing is told.
const MIN_NORMALS: usize = 10;
/// From so square a thing on, its sides tell its direction: half of what is made of boards has less noise than that, what is round
/// has a quarter (see [`super::GaussianClassifier`]'s models).
const SQUARE: f64 = 0.45;

/// How much the sides of a thing face four directions a right angle apart, and which.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sides {
    /// Near 1 for what is made of boards, near 0 for what is round; 0.5 where too few points tell.
    pub(super) squareness: f64,
    /// The direction of the first of the four, radians, -1/8 to 1/8 of a turn; none where too few tell.
    yaw: Option<f64>,
}

impl Sides {
    /// Of thinned points, by the mean of exp(4 i angle) over horizontal normals: directions a right angle apart count as one.
    ///
    /// Two faces of a box meet in a corner, and the rectangle of least area around these is as often one along the line
    /// that joins their ends: area does not tell the direction, faces do.
    pub(super) fn of(points: &[Point3<f32>]) -> Self {
        let params = NormalParams { radius_m: RADIUS_M, max_neighbours: 30, min_neighbours: 6 };
        let unknown = Self { squareness: 0.5, yaw: None };
        let Ok(normals) = estimate_normals(points, &params, None) else { return unknown };
        let (mut sum, mut count) = (Vector2::zeros(), 0);
        for n in normals.iter().filter(|n| n.xy().norm() > 0.8) {
            let angle = 4.0 * f64::from(n.y).atan2(f64::from(n.x));
            sum += Vector2::new(angle.cos(), angle.sin());
            count += 1;
        }
        if count < MIN_NORMALS {
            return unknown;
        }
        Self { squareness: sum.norm() / f64::from(count as u32), yaw: Some(0.25 * sum.y.atan2(sum.x)) }
    }

    /// The direction of a side, of what has sides; radians.
    pub(super) fn yaw(&self) -> Option<f64> {
        self.yaw.filter(|_| self.squareness >= SQUARE)
    }
}

//! From where a cloud is looked at.

use nalgebra::{Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// From where a cloud is looked at; the cloud's z points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum View {
    /// From above: x to the right, y up. Parallel.
    #[default]
    Top,
    /// Against x, as someone whom the robot drives towards sees it: y to the right, z up. Parallel.
    Front,
    /// Along y: x to the right, z up. Parallel.
    Side,
    /// From in front and above, with vanishing points.
    Perspective,
    /// As the camera sees it that made the cloud: x to the right, y down, z away. With vanishing points.
    Camera,
}

/// Half of the picture's opening angle in perspective, tangent.
const TAN_HALF_FOV: f64 = 0.42;
/// Shares of the points that may lie outside of the picture, at each end of each axis.
const OUTSIDE: f64 = 0.004;
const MARGIN: f64 = 1.06;

/// Where points come to lie in a picture.
pub(super) struct Projection {
    /// World to eye: x right, y up, z towards the viewer.
    rotation: Rotation3<f64>,
    center: Vector3<f64>,
    /// Pixels a metre (parallel), or of distance 1 (perspective).
    scale: f64,
    /// Distance of the eye from the centre; none for parallel views.
    distance: Option<f64>,
    half: (f64, f64),
}

impl Projection {
    /// Fits nearly all of the (finite) points into a picture.
    pub(super) fn fit(view: View, points: &[Point3<f32>], width_px: usize, height_px: usize) -> Self {
        let rotation = orientation(view);
        let half = (0.5 * width_px as f64, 0.5 * height_px as f64);
        // A sample is enough to know where nearly all are.
        let step = points.len().div_ceil(20_000).max(1);
        let eye: Vec<Vector3<f64>> = points.iter().step_by(step).map(|p| rotation * p.coords.cast::<f64>()).collect();
        let range = |axis: usize| {
            let mut values: Vec<f64> = eye.iter().map(|p| p[axis]).collect();
            values.sort_by(f64::total_cmp);
            let last = values.len().saturating_sub(1);
            let at = |share: f64| values.get((share * last as f64).round() as usize).copied().unwrap_or(0.0);
            (at(OUTSIDE), at(1.0 - OUTSIDE))
        };
        let ranges = [range(0), range(1), range(2)];
        let center = Vector3::from_fn(|i, _| 0.5 * (ranges[i].0 + ranges[i].1));
        let extent = ranges.map(|(low, high)| (high - low).max(1e-6) * MARGIN);
        let parallel = (2.0 * half.0 / extent[0]).min(2.0 * half.1 / extent[1]);
        if !matches!(view, View::Perspective | View::Camera) {
            return Self { rotation, center, scale: parallel, distance: None, half };
        }
        // Far enough for the near side of the cloud to fit.
        let focal = half.0.min(half.1) / TAN_HALF_FOV;
        let distance = focal / parallel + 0.35 * extent[2];
        Self { rotation, center, scale: focal, distance: Some(distance), half }
    }

    /// Pixel and distance (smaller is nearer); none behind the eye.
    pub(super) fn project(&self, p: &Point3<f32>) -> Option<(f64, f64, f32)> {
        let q = self.rotation * p.coords.cast::<f64>() - self.center;
        let (scale, away) = match self.distance {
            None => (self.scale, -q.z),
            Some(distance) => {
                let away = distance - q.z;
                if away <= 1e-3 * distance {
                    return None;
                }
                (self.scale / away, away)
            }
        };
        Some((self.half.0 + scale * q.x, self.half.1 - scale * q.y, away as f32))
    }
}

fn orientation(view: View) -> Rotation3<f64> {
    // Rows: right, up, towards the viewer.
    let rows = |right: [f64; 3], up: [f64; 3]| {
        let (right, up) = (Vector3::from(right).normalize(), Vector3::from(up));
        let towards = right.cross(&up).normalize();
        let up = towards.cross(&right);
        Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_rows(&[
            right.transpose(),
            up.transpose(),
            towards.transpose(),
        ]))
    };
    match view {
        View::Top => rows([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        View::Front => rows([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
        View::Side => rows([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        // The viewer stands at x < 0, y < 0, and looks down by some 35 degrees.
        View::Perspective => rows([0.8, -0.6, 0.0], [0.6 * 0.57, 0.8 * 0.57, 0.82]),
        View::Camera => rows([1.0, 0.0, 0.0], [0.0, -1.0, 0.0]),
    }
}

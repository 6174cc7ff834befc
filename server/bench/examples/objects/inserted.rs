//! Things put into a recorded scan: shapes made of boxes stand on its ground, and beams that meet them end there.
//!
//! The street around them, the pattern of the beams and what hides them stay those of the recording (as Fang et al.,
//! "Augmented LiDAR simulator for autonomous driving", 2020, do with models of things); beams that came back from
//! nowhere do not meet them.

use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud};
use percept_perception::segmentation::{GroundParams, segment_ground};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Normal};
use std::f64::consts::PI;

/// Noise of ranges, metres, and share of beams that do not come back.
const NOISE_M: f64 = 0.02;
const LOST: f64 = 0.05;

/// A part of a shape in its own frame (x ahead, z up from the ground), and the share of beams that it returns.
struct Part {
    low: [f64; 3],
    high: [f64; 3],
    returns: f64,
}

/// What is put in.
pub(crate) struct Shape {
    pub(crate) class: ObjectClass,
    parts: Vec<Part>,
    size: Vector3<f64>,
}

fn about(rng: &mut impl Rng, mean: f64, deviation: f64) -> f64 {
    let z: f64 = Normal::new(0.0, 1.0).map_or(0.0, |n| n.sample(rng));
    mean + deviation * z.clamp(-2.0, 2.0)
}

/// A shape of a class, of the sizes that such things have: means of KITTI and nuScenes, see `usual_size`, and the
/// spread of what is sold.
pub(crate) fn shape(class: ObjectClass, rng: &mut impl Rng) -> Shape {
    let mut parts = vec![];
    let mut part = |x: [f64; 2], width: f64, z: [f64; 2], returns: f64| {
        parts.push(Part { low: [x[0], -0.5 * width, z[0]], high: [x[1], 0.5 * width, z[1]], returns });
    };
    let size = match class {
        ObjectClass::Car => {
            let (l, w, h) = (about(rng, 4.0, 0.45), about(rng, 1.68, 0.1), about(rng, 1.53, 0.11));
            let (bonnet, boot, glass) =
                (rng.random_range(0.2..0.28), rng.random_range(0.0..0.2), rng.random_range(0.2..0.7));
            part([-0.5 * l, 0.5 * l], w, [0.2, 0.5 * h], 1.0);
            part([-0.5 * l, (0.5 - bonnet) * l], w, [0.5 * h, 0.6 * h], 1.0);
            part([(-0.5 + boot) * l, (0.45 - bonnet) * l], 0.95 * w, [0.6 * h, 0.8 * h], glass);
            part([(-0.46 + boot) * l, (0.35 - bonnet) * l], 0.85 * w, [0.8 * h, h], 0.8);
            part([-0.36 * l, -0.22 * l], w, [0.0, 0.25], 0.7);
            part([0.24 * l, 0.38 * l], w, [0.0, 0.25], 0.7);
            [l, w, h]
        }
        ObjectClass::Van => {
            let (l, w, h) = (about(rng, 5.0, 0.5), about(rng, 1.9, 0.1), about(rng, 2.1, 0.2));
            let (nose, glass) = (rng.random_range(0.04..0.2), rng.random_range(0.3..1.0));
            part([-0.5 * l, 0.5 * l], w, [0.25, 0.5 * h], 1.0);
            part([-0.5 * l, (0.5 - nose) * l], w, [0.5 * h, 0.8 * h], glass);
            part([-0.49 * l, (0.45 - nose) * l], 0.93 * w, [0.8 * h, h], 1.0);
            part([-0.36 * l, -0.22 * l], w, [0.0, 0.3], 0.7);
            part([0.24 * l, 0.38 * l], w, [0.0, 0.3], 0.7);
            [l, w, h]
        }
        ObjectClass::Truck => {
            let (l, w, h) = (rng.random_range(6.0..12.0), about(rng, 2.5, 0.1), rng.random_range(2.6..3.7));
            part([0.5 * l - 2.0, 0.5 * l], w, [0.35, rng.random_range(0.8..1.0) * h], 0.9);
            part([-0.5 * l, 0.5 * l - rng.random_range(2.1..2.6)], w, [rng.random_range(0.5..1.1), h], 1.0);
            part([-0.45 * l, -0.25 * l], w, [0.0, 0.9], 0.7);
            part([-0.5 * l, 0.5 * l], 0.8, [0.5, 0.9], 1.0);
            [l, w, h]
        }
        ObjectClass::Bus => {
            let (l, w, h) = (about(rng, 11.0, 1.2), about(rng, 2.6, 0.1), about(rng, 3.2, 0.2));
            part([-0.5 * l, 0.5 * l], w, [0.3, 0.4 * h], 1.0);
            part([-0.5 * l, 0.5 * l], w, [0.4 * h, 0.8 * h], rng.random_range(0.3..1.0));
            part([-0.5 * l, 0.5 * l], w, [0.8 * h, h], 1.0);
            [l, w, h]
        }
        ObjectClass::Person => {
            let (h, stride) = (about(rng, 1.72, 0.1), rng.random_range(0.15..0.55));
            let wide = rng.random_range(0.4..0.6);
            // Legs from the feet up to the hips.
            for (i, side) in (0..4).flat_map(|i| [(i, -1.0), (i, 1.0)]) {
                let x = side * (stride - 0.1) * (1.0 - 0.25 * f64::from(i));
                part([x - 0.1, x + 0.1], 0.28, [0.12 * h * f64::from(i), 0.12 * h * f64::from(i + 1)], 0.8);
            }
            part([-0.15, 0.15], wide, [0.48 * h, 0.84 * h], 1.0);
            part([-0.1, rng.random_range(0.1..0.35)], wide, [0.55 * h, 0.7 * h], 0.5);
            part([-0.1, 0.1], 0.2, [0.84 * h, h], 1.0);
            [2.0 * stride, wide, h]
        }
        ObjectClass::Cyclist => {
            let (l, h) = (about(rng, 1.76, 0.1), about(rng, 1.72, 0.1));
            let wide = rng.random_range(0.4..0.6);
            part([-0.5 * l, -0.5 * l + 0.68], 0.06, [0.0, 0.68], 0.35);
            part([0.5 * l - 0.68, 0.5 * l], 0.06, [0.0, 0.68], 0.35);
            part([-0.3, 0.45], 0.08, [0.4, 0.9], 0.6);
            part([0.35, 0.5], 0.5, [0.95, 1.1], 0.8);
            part([-0.2, 0.2], 0.35, [0.3, 0.95], 0.9);
            part([-0.3, 0.15], wide, [0.9, 0.84 * h], 1.0);
            part([0.0, 0.3], wide, [1.0, 0.76 * h], 0.6);
            part([-0.05, 0.2], 0.2, [0.84 * h, h], 1.0);
            [l, wide, h]
        }
        _ => {
            let (l, is_ridden) = (about(rng, 2.1, 0.15), rng.random_bool(0.6));
            let h = if is_ridden { about(rng, 1.55, 0.1) } else { about(rng, 1.15, 0.1) };
            part([-0.5 * l, -0.5 * l + 0.6], 0.15, [0.0, 0.6], 0.7);
            part([0.5 * l - 0.6, 0.5 * l], 0.15, [0.0, 0.6], 0.7);
            part([-0.35 * l, 0.25 * l], 0.4, [0.25, 0.85], 0.9);
            part([0.2 * l, 0.3 * l], 0.75, [0.85, 1.1], 0.8);
            if is_ridden {
                part([-0.4, 0.1], 0.5, [0.8, 0.84 * h], 1.0);
                part([-0.15, 0.12], 0.25, [0.84 * h, h], 1.0);
            }
            [l, 0.75, h]
        }
    };
    Shape { class, parts, size: size.into() }
}

/// The ground to stand on: pieces of plane.
pub(crate) struct Ground(Vec<percept_perception::segmentation::GroundPatch>, Vec<bool>);

impl Ground {
    pub(crate) fn of(scan: &PointCloud) -> Option<Self> {
        let ground = segment_ground(&scan.positions, &GroundParams::default()).ok()?;
        Some(Self(ground.patches, ground.is_ground))
    }

    fn height(&self, x: f64, y: f64) -> Option<f64> {
        let away = |p: &Point3<f64>| (p.x - x).powi(2) + (p.y - y).powi(2);
        let patch = self.0.iter().min_by(|a, b| away(&a.center).total_cmp(&away(&b.center)))?;
        let n = patch.plane.normal;
        // Far from any ground nothing is put.
        (away(&patch.center) < 25.0).then(|| -(n.x * x + n.y * y + patch.plane.offset) / n.z)
    }
}

/// Puts a shape where there is room for it, 5 to 65 m away, into the scan; its box, or none if no room was found.
/// `ground` is that of the scan as it was recorded.
pub(crate) fn insert(
    scan: &mut PointCloud,
    ground: &Ground,
    shape: &Shape,
    others: &[OrientedBox3],
    rng: &mut impl Rng,
) -> Option<OrientedBox3> {
    for _ in 0..30 {
        let (range, bearing) = (rng.random_range(5.0..65.0f64), rng.random_range(-PI..PI));
        let (x, y) = (range * bearing.cos(), range * bearing.sin());
        let Some(z) = ground.height(x, y) else { continue };
        let center = Point3::new(x, y, z + 0.5 * shape.size.z);
        let yaw = rng.random_range(-PI..PI);
        let bbox = OrientedBox3::upright(center, shape.size, yaw);
        let mut room = bbox;
        room.size += Vector3::new(0.4, 0.4, 0.0);
        room.t_frame_box.translation.vector.z += 0.3;
        let reach = room.size.norm();
        let is_taken = others.iter().any(|o| (o.center() - center).xy().norm() < 0.5 * (o.size.norm() + reach))
            || scan.positions.iter().zip(&ground.1).any(|(p, is_ground)| !is_ground && room.contains(&p.cast()));
        if !is_taken {
            cast(scan, shape, &OrientedBox3::upright(Point3::new(x, y, z), shape.size, yaw), rng);
            return Some(bbox);
        }
    }
    None
}

/// Ends beams where they meet the shape; `foot` has its pose on the ground.
fn cast(scan: &mut PointCloud, shape: &Shape, foot: &OrientedBox3, rng: &mut impl Rng) {
    let origin = foot.t_frame_box.inverse_transform_point(&Point3::origin());
    let noise = Normal::new(0.0, NOISE_M);
    for p in scan.positions.iter_mut().filter(|p| p.iter().all(|v| v.is_finite())) {
        let range = p.coords.cast::<f64>().norm();
        let direction = foot.t_frame_box.inverse_transform_vector(&(p.coords.cast::<f64>() / range.max(1e-6)));
        let mut first = range;
        for part in &shape.parts {
            if let Some(at) = meets(part, &origin, &direction).filter(|at| *at < first)
                && rng.random_bool(part.returns)
            {
                first = at;
            }
        }
        if first < range {
            let at = first + noise.map_or(0.0, |n| n.sample(rng));
            let scale = if rng.random_bool(LOST) { f64::NAN } else { at / range };
            *p = (p.cast::<f64>() * scale).cast();
        }
    }
}

/// Distance along a beam to a part.
fn meets(part: &Part, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for axis in 0..3 {
        let inverse = 1.0 / direction[axis];
        let (a, b) = ((part.low[axis] - origin[axis]) * inverse, (part.high[axis] - origin[axis]) * inverse);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    (near > 0.0 && near <= far).then_some(near)
}

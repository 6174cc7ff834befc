//! The solids that worlds are built of: upright boxes, cylinders and capsules; rays and distances to them.

use crate::texture::Material;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::Aabb3;

/// A place and heading in the plane: the frame of a piece of furniture, `t_world_local`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlanarFrame {
    pub(crate) x: f64,
    pub(crate) y: f64,
    cos: f64,
    sin: f64,
}

impl PlanarFrame {
    pub(crate) const WORLD: Self = Self { x: 0.0, y: 0.0, cos: 1.0, sin: 0.0 };

    pub(crate) fn new(x: f64, y: f64, yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        Self { x, y, cos, sin }
    }

    pub(crate) fn yaw(&self) -> f64 {
        self.sin.atan2(self.cos)
    }

    pub(crate) fn to_local(self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.vector_to_local(&Vector3::new(p.x - self.x, p.y - self.y, p.z)))
    }

    pub(crate) fn vector_to_local(self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z)
    }

    pub(crate) fn vector_to_world(self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)
    }

    pub(crate) fn to_world(self, p: &Point3<f64>) -> Point3<f64> {
        let v = self.vector_to_world(&p.coords);
        Point3::new(v.x + self.x, v.y + self.y, v.z)
    }

    pub(crate) fn xy_to_world(self, p: &Point2<f64>) -> Point2<f64> {
        self.to_world(&Point3::new(p.x, p.y, 0.0)).xy()
    }
}

/// A shape in its local frame, metres; all axes upright.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    Box {
        min: Point3<f64>,
        max: Point3<f64>,
    },
    Cylinder {
        x: f64,
        y: f64,
        radius: f64,
        z_min: f64,
        z_max: f64,
    },
    /// All points within `radius` of the upright segment from `z_min` to `z_max`.
    Capsule {
        x: f64,
        y: f64,
        radius: f64,
        z_min: f64,
        z_max: f64,
    },
}

/// A shape with its place, look, and the object that it is part of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Solid {
    pub(crate) shape: Shape,
    pub(crate) frame: PlanarFrame,
    pub(crate) material: Material,
    pub(crate) object: Option<u32>,
}

impl Shape {
    /// A box from its centre and size.
    pub(crate) fn block(center: [f64; 3], size: [f64; 3]) -> Self {
        let (c, h) = (Point3::from(center), Vector3::from(size) * 0.5);
        Self::Box { min: c - h, max: c + h }
    }

    /// Smallest box around it, in its local frame.
    pub(crate) fn bounds(&self) -> Aabb3 {
        let around = |x: f64, y: f64, r: f64, z0: f64, z1: f64| Aabb3 {
            min: Point3::new(x - r, y - r, z0),
            max: Point3::new(x + r, y + r, z1),
        };
        match *self {
            Self::Box { min, max } => Aabb3 { min, max },
            Self::Cylinder { x, y, radius, z_min, z_max } => around(x, y, radius, z_min, z_max),
            Self::Capsule { x, y, radius, z_min, z_max } => around(x, y, radius, z_min - radius, z_max + radius),
        }
    }

    /// Smallest `t > 0` at which `origin + t * direction` is on the surface.
    ///
    /// The direction need not be of unit length: with z = 1 in an optical frame, `t` is the depth.
    pub(crate) fn intersect(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        match *self {
            Self::Box { min, max } => intersect_box(&(min - origin), &(max - origin), direction),
            Self::Cylinder { x, y, radius, z_min, z_max } => {
                intersect_cylinder(&(origin - Vector3::new(x, y, 0.0)), direction, radius, z_min, z_max)
            }
            Self::Capsule { x, y, radius, z_min, z_max } => {
                intersect_capsule(&(origin - Vector3::new(x, y, 0.0)), direction, radius, z_min, z_max)
            }
        }
    }

    /// Signed distance to the surface, metres; negative inside. Source: Quilez, "Distance functions".
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        match *self {
            Self::Box { min, max } => {
                let q = (min - p).sup(&(p - max));
                q.map(|c| c.max(0.0)).norm() + q.max().min(0.0)
            }
            Self::Cylinder { x, y, radius, z_min, z_max } => {
                let side = (p.x - x).hypot(p.y - y) - radius;
                let cap = (z_min - p.z).max(p.z - z_max);
                side.max(0.0).hypot(cap.max(0.0)) + side.max(cap).min(0.0)
            }
            Self::Capsule { x, y, radius, z_min, z_max } => {
                (p - Point3::new(x, y, p.z.clamp(z_min, z_max))).norm() - radius
            }
        }
    }

    /// Outward unit normal at a point on the surface.
    pub(crate) fn normal(&self, p: &Point3<f64>) -> Vector3<f64> {
        match *self {
            Self::Box { min, max } => {
                // The face that the point is nearest to, or farthest outside of.
                let (mut best, mut n) = (f64::NEG_INFINITY, Vector3::zeros());
                for axis in 0..3 {
                    let (below, above) = (min[axis] - p[axis], p[axis] - max[axis]);
                    if below.max(above) > best {
                        best = below.max(above);
                        n = Vector3::zeros();
                        n[axis] = if above > below { 1.0 } else { -1.0 };
                    }
                }
                n
            }
            Self::Cylinder { x, y, radius, z_min, z_max } => {
                let radial = Vector3::new(p.x - x, p.y - y, 0.0);
                if (radial.norm() - radius).abs() <= (p.z - z_min).abs().min((p.z - z_max).abs()) {
                    radial.normalize()
                } else {
                    Vector3::z() * if p.z > 0.5 * (z_min + z_max) { 1.0 } else { -1.0 }
                }
            }
            Self::Capsule { x, y, z_min, z_max, .. } => (p - Point3::new(x, y, p.z.clamp(z_min, z_max))).normalize(),
        }
    }
}

/// Slabs (Kay and Kajiya 1986); `low` and `high` are the corners seen from the origin.
fn intersect_box(low: &Vector3<f64>, high: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..3 {
        // A direction of zero gives infinities of the right sign; NaN (0/0) is dropped by min and max.
        let inverse = 1.0 / direction[i];
        let (a, b) = (low[i] * inverse, high[i] * inverse);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    first_ahead(enter, leave)
}

fn intersect_cylinder(o: &Point3<f64>, d: &Vector3<f64>, radius: f64, z_min: f64, z_max: f64) -> Option<f64> {
    let (side_enter, side_leave) = circle_interval(o, d, radius)?;
    let inverse = 1.0 / d.z;
    let (a, b) = ((z_min - o.z) * inverse, (z_max - o.z) * inverse);
    if d.z == 0.0 && (o.z < z_min || o.z > z_max) {
        return None;
    }
    first_ahead(side_enter.max(a.min(b)), side_leave.min(a.max(b)))
}

/// The infinite cylinder about z as an interval of t.
fn circle_interval(o: &Point3<f64>, d: &Vector3<f64>, radius: f64) -> Option<(f64, f64)> {
    let (a, b) = (d.x * d.x + d.y * d.y, o.x * d.x + o.y * d.y);
    let c = o.x * o.x + o.y * o.y - radius * radius;
    if a < 1e-18 {
        return (c <= 0.0).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let root = b * b - a * c;
    if root < 0.0 {
        return None;
    }
    let root = root.sqrt();
    Some(((-b - root) / a, (-b + root) / a))
}

fn intersect_capsule(o: &Point3<f64>, d: &Vector3<f64>, radius: f64, z_min: f64, z_max: f64) -> Option<f64> {
    // The union of three convex pieces that overlap: it is entered where the first is entered and left
    // where the last is left.
    let pieces = [
        circle_interval(o, d, radius).and_then(|(enter, leave)| {
            let (a, b) = ((z_min - o.z) / d.z, (z_max - o.z) / d.z);
            let (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
            (enter <= leave).then_some((enter, leave))
        }),
        sphere_interval(o, d, radius, z_min),
        sphere_interval(o, d, radius, z_max),
    ];
    let joined = pieces.into_iter().flatten().reduce(|(e0, l0), (e1, l1)| (e0.min(e1), l0.max(l1)))?;
    first_ahead(joined.0, joined.1)
}

fn sphere_interval(o: &Point3<f64>, d: &Vector3<f64>, radius: f64, z: f64) -> Option<(f64, f64)> {
    let q = o - Point3::new(0.0, 0.0, z);
    let (a, b) = (d.norm_squared(), q.dot(d));
    let root = b * b - a * (q.norm_squared() - radius * radius);
    if root < 0.0 {
        return None;
    }
    let root = root.sqrt();
    Some(((-b - root) / a, (-b + root) / a))
}

fn first_ahead(enter: f64, leave: f64) -> Option<f64> {
    if enter > leave || leave <= 0.0 {
        None
    } else if enter > 0.0 {
        Some(enter)
    } else {
        // From inside one sees the far side.
        Some(leave)
    }
}

impl Solid {
    /// As [`Shape::intersect`], in the world frame.
    pub(crate) fn intersect(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        self.shape.intersect(&self.frame.to_local(origin), &self.frame.vector_to_local(direction))
    }

    /// Signed distance of a world point, metres.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        self.shape.distance(&self.frame.to_local(p))
    }

    /// Normal and shaded colour (0..1) at a world point on the surface.
    pub(crate) fn appearance(&self, p: &Point3<f64>) -> (Vector3<f64>, [f32; 3]) {
        let local = self.frame.to_local(p);
        let normal = self.shape.normal(&local);
        let normal_world = self.frame.vector_to_world(&normal);
        let albedo = self.material.albedo(&local, &normal);
        let shade = crate::texture::shade(&normal_world);
        (normal_world, albedo.map(|c| (c * shade).clamp(0.0, 1.0)))
    }

    /// Corners of its local bounding box, in the world.
    pub(crate) fn corners(&self) -> [Point3<f64>; 8] {
        let b = self.shape.bounds();
        std::array::from_fn(|i| {
            let pick = |axis: usize| if i >> axis & 1 == 1 { b.max[axis] } else { b.min[axis] };
            self.frame.to_world(&Point3::new(pick(0), pick(1), pick(2)))
        })
    }

    /// Axis-aligned box in the world that holds it.
    pub(crate) fn world_bounds(&self) -> Aabb3 {
        let mut out = Aabb3::empty();
        for corner in self.corners() {
            out.grow(&corner);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shapes() -> Vec<Shape> {
        vec![
            Shape::block([0.3, -0.2, 0.5], [1.0, 0.6, 0.8]),
            Shape::Cylinder { x: 0.2, y: 0.1, radius: 0.4, z_min: 0.0, z_max: 1.1 },
            Shape::Capsule { x: -0.1, y: 0.2, radius: 0.3, z_min: 0.3, z_max: 1.2 },
            Shape::Capsule { x: 0.0, y: 0.0, radius: 0.5, z_min: 0.7, z_max: 0.7 },
        ]
    }

    #[test]
    fn rays_meet_each_shape_at_the_closed_form() {
        let x = Vector3::x();
        let at = |shape: &Shape, o: [f64; 3], d: Vector3<f64>| shape.intersect(&Point3::from(o), &d);
        let shapes = shapes();
        assert_eq!(at(&shapes[0], [-2.0, 0.0, 0.5], x), Some(1.8));
        assert_eq!(at(&shapes[0], [-2.0, 0.2, 0.5], x), None);
        // Parallel to a face, outside of its slab.
        assert_eq!(at(&shapes[0], [-2.0, 0.0, 1.0], x), None);
        // A chord at half the radius: 0.2 + sqrt(0.4^2 - 0.2^2) from the axis.
        let chord = (0.4f64 * 0.4 - 0.2 * 0.2).sqrt();
        assert!((at(&shapes[1], [-1.0, 0.3, 0.5], x).unwrap() - (1.2 - chord)).abs() < 1e-12);
        assert!((at(&shapes[1], [0.2, 0.2, 2.0], -Vector3::z()).unwrap() - 0.9).abs() < 1e-12);
        assert!((at(&shapes[2], [-0.1, 0.2, 3.0], -Vector3::z()).unwrap() - 1.5).abs() < 1e-12);
        assert!((at(&shapes[2], [-2.1, 0.2, 0.6], x).unwrap() - 1.7).abs() < 1e-12);
        assert!((at(&shapes[3], [3.0, 0.0, 0.7], -x * 2.0).unwrap() - 1.25).abs() < 1e-12);
        // From inside, the far side.
        assert!((at(&shapes[3], [0.0, 0.0, 0.7], x).unwrap() - 0.5).abs() < 1e-12);
    }

    proptest! {
        /// Sphere tracing along the signed distance finds the same point, or the same absence.
        #[test]
        fn rays_agree_with_the_distance_field(
            o in prop::array::uniform3(-3.0..3.0f64), d in prop::array::uniform3(-1.0..1.0f64), which in 0..4usize,
        ) {
            let (shape, origin) = (shapes()[which], Point3::from(o));
            let d = Vector3::from(d);
            prop_assume!(d.norm() > 0.1 && shape.distance(&origin) > 0.01);
            let d = d.normalize();
            let (mut t, mut nearest) = (0.0, f64::INFINITY);
            while t < 12.0 {
                let step = shape.distance(&(origin + d * t));
                nearest = nearest.min(step);
                if step < 1e-9 { break; }
                t += step;
            }
            match shape.intersect(&origin, &d) {
                Some(hit) => {
                    let p = origin + d * hit;
                    prop_assert!(shape.distance(&p).abs() < 1e-9);
                    // Grazing rays may be stopped early by the tracing's tolerance.
                    if shape.normal(&p).dot(&d) < -0.05 { prop_assert!((hit - t).abs() < 1e-6); }
                    prop_assert!(shape.normal(&p).dot(&d) < 1e-6);
                }
                None => prop_assert!(nearest > -1e-9 && t >= 12.0 || nearest < 1e-6),
            }
        }
    }
}

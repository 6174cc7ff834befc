//! Planes, boxes and rays.

use crate::Pose;
use nalgebra::{Point3, Unit, Vector3};

/// The plane `normal . p + offset = 0`, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: Unit<Vector3<f64>>,
    /// Signed distance of the origin from the plane, metres.
    pub offset: f64,
}

impl Plane {
    /// The plane through `p` with this normal.
    pub fn through(p: &Point3<f64>, normal: Unit<Vector3<f64>>) -> Self {
        Self { normal, offset: -normal.dot(&p.coords) }
    }

    /// Signed distance, metres; positive on the normal's side.
    pub fn distance(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) + self.offset
    }

    /// The same plane in frame a, from frame b.
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        let normal = t_a_b.rotation * self.normal;
        Self { normal, offset: self.offset - normal.dot(&t_a_b.translation.vector) }
    }
}

/// Axis-aligned box, metres; empty if a minimum exceeds its maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb3 {
    /// Smallest coordinates.
    pub min: Point3<f64>,
    /// Largest coordinates.
    pub max: Point3<f64>,
}

impl Aabb3 {
    /// The box that holds nothing, ready to grow.
    pub fn empty() -> Self {
        Self { min: Point3::from([f64::INFINITY; 3]), max: Point3::from([f64::NEG_INFINITY; 3]) }
    }

    /// The smallest box around the finite ones of `points`.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f32>>) -> Self {
        let mut out = Self::empty();
        for p in points {
            if crate::cloud::is_finite(p) {
                out.grow(&p.cast());
            }
        }
        out
    }

    /// Grows to hold `p`.
    pub fn grow(&mut self, p: &Point3<f64>) {
        self.min = self.min.inf(p);
        self.max = self.max.sup(p);
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x || self.min.y > self.max.y || self.min.z > self.max.z
    }

    /// Edge lengths, metres; zero if empty.
    pub fn size(&self) -> Vector3<f64> {
        if self.is_empty() { Vector3::zeros() } else { self.max - self.min }
    }

    /// Centre.
    pub fn center(&self) -> Point3<f64> {
        nalgebra::center(&self.min, &self.max)
    }

    /// Whether `p` lies inside or on it.
    pub fn contains(&self, p: &Point3<f64>) -> bool {
        (0..3).all(|i| p[i] >= self.min[i] && p[i] <= self.max[i])
    }
}

/// A box with a pose: `t_frame_box` maps box coordinates (origin at the centre, axes along the edges).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OrientedBox3 {
    /// Box to its surrounding frame.
    pub t_frame_box: Pose,
    /// Edge lengths along the box's x, y, z, metres.
    pub size: Vector3<f64>,
}

impl OrientedBox3 {
    /// A box upright in a z-up frame: turned about z only.
    pub fn upright(center: Point3<f64>, size: Vector3<f64>, yaw: f64) -> Self {
        let mut t_frame_box = crate::se3::from_xy_yaw(center.x, center.y, yaw);
        t_frame_box.translation.vector.z = center.z;
        Self { t_frame_box, size }
    }

    /// Centre in the surrounding frame.
    pub fn center(&self) -> Point3<f64> {
        Point3::from(self.t_frame_box.translation.vector)
    }

    /// Volume, cubic metres.
    pub fn volume(&self) -> f64 {
        self.size.x * self.size.y * self.size.z
    }

    /// Whether `p`, in the surrounding frame, lies inside or on it.
    pub fn contains(&self, p: &Point3<f64>) -> bool {
        let q = self.t_frame_box.inverse_transform_point(p);
        (0..3).all(|i| q[i].abs() <= 0.5 * self.size[i])
    }

    /// The eight corners; index bits 0, 1, 2 choose the sign of x, y, z.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        std::array::from_fn(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 0.5 } else { -0.5 };
            self.t_frame_box * Point3::new(sign(0) * self.size.x, sign(1) * self.size.y, sign(2) * self.size.z)
        })
    }

    /// The four corners of the footprint in the frame's xy plane, counter-clockwise, for an upright box.
    pub fn footprint(&self) -> [nalgebra::Point2<f64>; 4] {
        let c = self.corners();
        [c[0].xy(), c[1].xy(), c[3].xy(), c[2].xy()]
    }

    /// The same box in frame a, from frame b.
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        Self { t_frame_box: t_a_b * self.t_frame_box, size: self.size }
    }

    /// Volume shared over volume of the union, exact for boxes upright in the same frame.
    ///
    /// Footprints are clipped against each other (Sutherland and Hodgman 1974).
    pub fn iou_upright(&self, other: &Self) -> f64 {
        let z = |b: &Self| (b.center().z - 0.5 * b.size.z, b.center().z + 0.5 * b.size.z);
        let ((a0, a1), (b0, b1)) = (z(self), z(other));
        let height = (a1.min(b1) - a0.max(b0)).max(0.0);
        let shared = height * convex_intersection_area(&self.footprint(), &other.footprint());
        let union = self.volume() + other.volume() - shared;
        if union > 0.0 { (shared / union).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Area shared by two convex polygons given counter-clockwise, square metres.
pub fn convex_intersection_area(a: &[nalgebra::Point2<f64>], b: &[nalgebra::Point2<f64>]) -> f64 {
    let mut polygon = a.to_vec();
    for i in 0..b.len() {
        let (p, q) = (b[i], b[(i + 1) % b.len()]);
        let side = |x: &nalgebra::Point2<f64>| (q - p).perp(&(x - p));
        let input = std::mem::take(&mut polygon);
        for j in 0..input.len() {
            let (c, d) = (input[j], input[(j + 1) % input.len()]);
            let (sc, sd) = (side(&c), side(&d));
            if sc >= 0.0 {
                polygon.push(c);
            }
            if (sc > 0.0 && sd < 0.0) || (sc < 0.0 && sd > 0.0) {
                polygon.push(c + (d - c) * (sc / (sc - sd)));
            }
        }
    }
    0.5 * (0..polygon.len())
        .map(|i| polygon[i].coords.perp(&polygon[(i + 1) % polygon.len()].coords))
        .sum::<f64>()
        .abs()
}

/// A half-line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start, metres.
    pub origin: Point3<f64>,
    /// Unit direction.
    pub direction: Unit<Vector3<f64>>,
}

impl Ray {
    /// The point `distance` metres along.
    pub fn at(&self, distance: f64) -> Point3<f64> {
        self.origin + self.direction.into_inner() * distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_of_boxes_matches_the_closed_form() {
        let unit = OrientedBox3::upright(Point3::origin(), Vector3::new(1.0, 1.0, 1.0), 0.0);
        assert!((unit.iou_upright(&unit) - 1.0).abs() < 1e-12);
        let half = OrientedBox3::upright(Point3::new(0.5, 0.0, 0.0), Vector3::new(1.0, 1.0, 1.0), 0.0);
        assert!((unit.iou_upright(&half) - 1.0 / 3.0).abs() < 1e-12);
        // A square and itself turned by 45 degrees share a regular octagon of area 2 (sqrt 2 - 1).
        let turned = OrientedBox3::upright(Point3::origin(), Vector3::new(1.0, 1.0, 1.0), std::f64::consts::FRAC_PI_4);
        let shared = 2.0 * (2f64.sqrt() - 1.0);
        assert!((unit.iou_upright(&turned) - shared / (2.0 - shared)).abs() < 1e-12);
        let apart = OrientedBox3::upright(Point3::new(3.0, 0.0, 0.0), Vector3::new(1.0, 1.0, 1.0), 0.3);
        assert_eq!(unit.iou_upright(&apart), 0.0);
    }

    #[test]
    fn a_plane_keeps_its_points_when_both_are_moved() {
        let plane = Plane::through(&Point3::new(0.0, 0.0, 2.0), Unit::new_normalize(Vector3::new(0.1, 0.2, 1.0)));
        let t = crate::se3::exp(&nalgebra::Vector6::new(1.0, -2.0, 0.5, 0.3, 0.2, -0.4));
        let p = Point3::new(1.0, 2.0, 3.0);
        assert!((plane.transformed(&t).distance(&(t * p)) - plane.distance(&p)).abs() < 1e-12);
    }
}

//! How upright boxes lie to each other: shared volume, shared ground, the gap between them.

use nalgebra::{Point2, Vector3};
use percept_geometry::{OrientedBox3, se3, shapes::convex_intersection_area};

/// The box turned upright: same centre and edge lengths, yaw of its x axis.
pub fn upright(b: &OrientedBox3) -> OrientedBox3 {
    OrientedBox3::upright(b.center(), b.size, se3::yaw(&b.t_frame_box))
}

/// Lowest and highest z, metres.
pub fn z_range(b: &OrientedBox3) -> (f64, f64) {
    let (z, half) = (b.center().z, 0.5 * b.size.z);
    (z - half, z + half)
}

/// Area of the footprint, square metres.
pub fn footprint_area(b: &OrientedBox3) -> f64 {
    b.size.x * b.size.y
}

/// Area common to the footprints, square metres.
pub fn shared_footprint(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let reach = 0.5 * (a.size.xy().norm() + b.size.xy().norm());
    if (a.center().xy() - b.center().xy()).norm() >= reach {
        return 0.0;
    }
    convex_intersection_area(&a.footprint(), &b.footprint())
}

/// Volume common to both, cubic metres.
pub fn shared_volume(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let ((a0, a1), (b0, b1)) = (z_range(a), z_range(b));
    let height = a1.min(b1) - a0.max(b0);
    if height <= 0.0 { 0.0 } else { height * shared_footprint(a, b) }
}

/// Common volume over the volume of the union, 0..1.
pub fn iou(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let shared = shared_volume(a, b);
    let union = a.volume() + b.volume() - shared;
    if union > 0.0 { (shared / union).clamp(0.0, 1.0) } else { 0.0 }
}

/// Common volume over the volume of `a`, 0..1: 1 if `a` lies in `b`.
pub fn share_of(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let volume = a.volume();
    if volume > 0.0 { (shared_volume(a, b) / volume).clamp(0.0, 1.0) } else { 0.0 }
}

/// Common volume over the smaller volume, 0..1: 1 if one lies in the other.
pub fn share_of_smaller(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    if a.volume() <= b.volume() { share_of(a, b) } else { share_of(b, a) }
}

/// Distance between the boxes, metres; 0 if they touch or overlap.
pub fn gap(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    footprint_gap(a, b).hypot(vertical_gap(a, b))
}

/// Distance between the height ranges, metres; 0 if they meet.
pub fn vertical_gap(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let ((a0, a1), (b0, b1)) = (z_range(a), z_range(b));
    (b0 - a1).max(a0 - b1).max(0.0)
}

/// Distance between the footprints, metres; 0 if they touch or overlap.
pub fn footprint_gap(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    if shared_footprint(a, b) > 0.0 {
        return 0.0;
    }
    let (p, q) = (a.footprint(), b.footprint());
    let corners_to_edges = |p: &[Point2<f64>; 4], q: &[Point2<f64>; 4]| {
        let mut least = f64::INFINITY;
        for corner in p {
            for i in 0..4 {
                least = least.min(distance_to_segment(corner, &q[i], &q[(i + 1) % 4]));
            }
        }
        least
    };
    corners_to_edges(&p, &q).min(corners_to_edges(&q, &p))
}

fn distance_to_segment(p: &Point2<f64>, a: &Point2<f64>, b: &Point2<f64>) -> f64 {
    let ab = b - a;
    let length2 = ab.norm_squared();
    let s = if length2 > 0.0 { ((p - a).dot(&ab) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (a + ab * s - p).norm()
}

/// The smallest upright box with the yaw of `a` that holds both.
pub fn hull(a: &OrientedBox3, b: &OrientedBox3) -> OrientedBox3 {
    let yaw = se3::yaw(&a.t_frame_box);
    let along = |p: &Point2<f64>| nalgebra::Rotation2::new(-yaw) * p;
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for bbox in [a, b] {
        let (from, to) = z_range(bbox);
        for p in bbox.footprint().iter().map(along) {
            low = low.inf(&Vector3::new(p.x, p.y, from));
            high = high.sup(&Vector3::new(p.x, p.y, to));
        }
    }
    let middle = 0.5 * (low + high);
    let flat = nalgebra::Rotation2::new(yaw) * Point2::new(middle.x, middle.y);
    OrientedBox3::upright(nalgebra::Point3::new(flat.x, flat.y, middle.z), high - low, yaw)
}

/// The box a share `s` of the way from `a` (0) to `b` (1), along the shorter turn.
///
/// A box turned by a quarter with x and y exchanged is the same box: the description of `b` nearest to `a` counts.
pub fn blend(a: &OrientedBox3, b: &OrientedBox3, s: f64) -> OrientedBox3 {
    let yaw_a = se3::yaw(&a.t_frame_box);
    let turn = se3::wrap_angle(se3::yaw(&b.t_frame_box) - yaw_a);
    let quarters = (turn / std::f64::consts::FRAC_PI_2).round();
    let rest = turn - quarters * std::f64::consts::FRAC_PI_2;
    let swap = quarters.rem_euclid(2.0) == 1.0;
    let size = if swap { Vector3::new(b.size.y, b.size.x, b.size.z) } else { b.size };
    let center = a.center() + (b.center() - a.center()) * s;
    OrientedBox3::upright(center, a.size + (size - a.size) * s, yaw_a + s * rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn boxes() -> impl Strategy<Value = OrientedBox3> {
        (prop::array::uniform3(-1.5..1.5f64), prop::array::uniform3(0.1..2.0f64), -4.0..4.0f64)
            .prop_map(|(c, s, yaw)| OrientedBox3::upright(Point3::from(c), Vector3::from(s), yaw))
    }

    proptest! {
        #[test]
        fn overlap_agrees_with_the_shared_definition(a in boxes(), b in boxes()) {
            prop_assert!((iou(&a, &b) - a.iou_upright(&b)).abs() < 1e-9);
            prop_assert!((iou(&a, &b) - iou(&b, &a)).abs() < 1e-9);
            prop_assert!(share_of_smaller(&a, &b) + 1e-9 >= iou(&a, &b));
        }

        /// Projecting to and fro between two convex bodies closes in on their distance from above (Cheney and
        /// Goldstein 1959).
        #[test]
        fn gap_is_the_distance_of_the_convex_bodies(a in boxes(), b in boxes()) {
            let nearest = |b: &OrientedBox3, p: &Point3<f64>| {
                let q = b.t_frame_box.inverse_transform_point(p).coords;
                b.t_frame_box * Point3::from(q.zip_map(&b.size, |v, s| v.clamp(-0.5 * s, 0.5 * s)))
            };
            let mut p = a.center();
            let mut distance = f64::INFINITY;
            for _ in 0..3000 {
                let q = nearest(&b, &p);
                p = nearest(&a, &q);
                distance = (p - q).norm();
            }
            prop_assert!(gap(&a, &b) <= distance + 1e-9);
            prop_assert!(gap(&a, &b) >= distance - 2e-3, "{} {}", gap(&a, &b), distance);
            prop_assert_eq!(gap(&a, &b) == 0.0, shared_volume(&a, &b) > 0.0);
        }

        #[test]
        fn a_box_blended_with_itself_described_otherwise_stays(a in boxes(), quarters in 0usize..4, s in 0.0..1.0f64) {
            let yaw = se3::yaw(&a.t_frame_box) + quarters as f64 * std::f64::consts::FRAC_PI_2;
            let size = if quarters % 2 == 1 { Vector3::new(a.size.y, a.size.x, a.size.z) } else { a.size };
            let same = OrientedBox3::upright(a.center(), size, yaw);
            prop_assert!(iou(&blend(&a, &same, s), &a) > 1.0 - 1e-9);
        }

        #[test]
        fn a_full_blend_is_the_other_box(a in boxes(), b in boxes()) {
            prop_assert!(iou(&blend(&a, &b, 1.0), &b) > 1.0 - 1e-9);
        }
    }
}

//! The upright box of a set of points.

use super::minimum_area_rectangle;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{OrientedBox3, cloud::is_finite};
use std::f64::consts::FRAC_PI_2;

/// The box upright along z with the smallest footprint around the finite ones of `points`: its x runs along
/// the longer side. None if there is no point; a single point gives a box of size 0.
pub fn upright_box(points: &[Point3<f32>]) -> Option<OrientedBox3> {
    upright_box_trimmed(points, 0.0)
}

/// As [`upright_box`], leaving out on either side of each axis the part `trim` (0 to 0.49) of the points that
/// lies farthest out: strays do not stretch it. The direction comes from the points that are left.
pub fn upright_box_trimmed(points: &[Point3<f32>], trim: f64) -> Option<OrientedBox3> {
    let anchor: Point3<f64> = points.iter().find(|p| is_finite(p))?.cast();
    // About the anchor: far from the origin nothing is lost.
    let local: Vec<Vector3<f64>> = points.iter().filter(|p| is_finite(p)).map(|p| p.cast::<f64>() - anchor).collect();
    let first = footprint(&local)?;
    let trim = trim.clamp(0.0, 0.49);
    if trim == 0.0 {
        return around(&local, first.yaw, anchor);
    }
    let kept = trimmed(&local, first.yaw, trim);
    let yaw = footprint(&kept)?.yaw;
    around(&kept, yaw, anchor)
}

/// As [`upright_box_trimmed`], with one of the horizontal edges along `yaw`, radians about z.
pub fn upright_box_along(points: &[Point3<f32>], yaw: f64, trim: f64) -> Option<OrientedBox3> {
    let anchor: Point3<f64> = points.iter().find(|p| is_finite(p))?.cast();
    let local: Vec<Vector3<f64>> = points.iter().filter(|p| is_finite(p)).map(|p| p.cast::<f64>() - anchor).collect();
    let kept = trimmed(&local, yaw, trim.clamp(0.0, 0.49));
    let first = around(&kept, yaw, anchor)?;
    // Its x runs along the longer side.
    if first.size.x >= first.size.y { Some(first) } else { around(&kept, yaw + FRAC_PI_2, anchor) }
}

fn footprint(points: &[Vector3<f64>]) -> Option<super::Rectangle> {
    let flat: Vec<Point2<f64>> = points.iter().map(|p| Point2::from(p.xy())).collect();
    minimum_area_rectangle(&flat)
}

fn trimmed(points: &[Vector3<f64>], yaw: f64, trim: f64) -> Vec<Vector3<f64>> {
    let cut = (points.len() as f64 * trim) as usize;
    let bounds = axes(yaw).map(|axis| {
        let mut values: Vec<f64> = points.iter().map(|p| axis.dot(p)).collect();
        values.sort_unstable_by(f64::total_cmp);
        (axis, values[cut], values[values.len() - 1 - cut])
    });
    let inside = |p: &&Vector3<f64>| bounds.iter().all(|(axis, low, high)| (*low..=*high).contains(&axis.dot(p)));
    points.iter().filter(inside).copied().collect()
}

fn axes(yaw: f64) -> [Vector3<f64>; 3] {
    let (s, c) = yaw.sin_cos();
    [Vector3::new(c, s, 0.0), Vector3::new(-s, c, 0.0), Vector3::z()]
}

/// The box along `yaw` around points given about `anchor`; x is the longer side as far as `yaw` says so.
fn around(points: &[Vector3<f64>], yaw: f64, anchor: Point3<f64>) -> Option<OrientedBox3> {
    let ranges = axes(yaw).map(|axis| {
        let values = points.iter().map(|p| axis.dot(p));
        (axis, values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
    });
    let center = ranges.iter().map(|(axis, low, high)| axis * (0.5 * (low + high))).sum::<Vector3<f64>>();
    let size = Vector3::from(ranges.map(|(_, low, high)| high - low));
    (!points.is_empty()).then(|| OrientedBox3::upright(anchor + center, size, yaw))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_turned_brick_is_found_as_it_is(
            yaw in -1.5..1.5f64, x in -50.0..50.0f64, long in 1.1..3.0f64, high in 0.1..2.0f64,
        ) {
            let truth = OrientedBox3::upright(Point3::new(x, 2.0, 1.0), Vector3::new(long, 1.0, high), yaw);
            let points: Vec<Point3<f32>> = truth.corners().iter().map(|p| p.cast()).collect();
            let found = upright_box(&points).unwrap();
            prop_assert!(found.iou_upright(&truth) > 0.999);
            prop_assert!((found.size - truth.size).norm() < 1e-3);
        }
    }

    #[test]
    fn degenerate_sets_have_flat_boxes() {
        assert_eq!(upright_box(&[]), None);
        assert_eq!(upright_box(&[Point3::from([f32::NAN; 3])]), None);
        let one = upright_box(&[Point3::new(1e7, -2.0, 3.0); 3]).unwrap();
        assert_eq!((one.center(), one.size), (Point3::new(1e7, -2.0, 3.0), Vector3::zeros()));
        let line: Vec<Point3<f32>> = (0..11).map(|i| Point3::new(i as f32, i as f32, 0.0)).collect();
        let found = upright_box(&line).unwrap();
        assert!((found.size - Vector3::new(200f64.sqrt(), 0.0, 0.0)).norm() < 1e-6);
        let pole: Vec<Point3<f32>> = (0..11).map(|i| Point3::new(1.0, 2.0, i as f32)).collect();
        assert_eq!(upright_box(&pole).unwrap().size, Vector3::new(0.0, 0.0, 10.0));
    }

    #[test]
    fn strays_do_not_stretch_a_trimmed_box() {
        let mut points: Vec<Point3<f32>> =
            (0..1000).map(|i| Point3::new((i % 10) as f32, (i / 10 % 10) as f32 * 0.5, (i / 100) as f32)).collect();
        points.push(Point3::new(100.0, 100.0, 100.0));
        let found = upright_box_trimmed(&points, 0.01).unwrap();
        assert!((found.size - Vector3::new(9.0, 4.5, 9.0)).norm() < 1e-5, "{}", found.size);
    }
}

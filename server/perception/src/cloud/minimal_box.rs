//! The smallest box around a cloud, in any direction.

use super::{Hull3, Rectangle, convex_hull_3d, minimum_area_rectangle, upright_box};
use nalgebra::{Matrix3, Point2, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use percept_geometry::{OrientedBox3, Pose};

/// Facets of the hull that are tried as a side of the box, the largest first.
const MAX_FACETS: usize = 256;
/// Boxes that are turned further until no axis can be bettered.
const MAX_REFINED: usize = 16;
/// Directions over the half sphere that are tried besides: a least box may hold no facet.
const SPREAD: usize = 48;

/// The box of least volume around the finite ones of `points`, found to a local optimum; none if there is no point.
/// Axes x, y, z run along the longest, middle and shortest edge. Flat clouds have boxes without thickness.
///
/// Each large facet of the convex hull is tried as a side, with the rectangle of least area about the rest; the best of
/// these, and the upright box, are then turned about each of their axes in turn to the least rectangle across it, as
/// long as that makes them smaller. The least box of all has two adjacent sides that hold an edge each, and need not
/// hold a facet (O'Rourke, "Finding minimal enclosing boxes", 1985); turning comes to such boxes, too (after Chang,
/// Gorissen and Melchior, "Fast oriented bounding box optimization on the rotation group SO(3, R)", 2011).
pub fn minimal_box(points: &[Point3<f32>]) -> Option<OrientedBox3> {
    minimal_box_of_hull(&convex_hull_3d(points)?)
}

/// As [`minimal_box`], from the hull; none if it has no corner.
pub fn minimal_box_of_hull(hull: &Hull3) -> Option<OrientedBox3> {
    let anchor = *hull.vertices.first()?;
    let corners: Vec<Vector3<f64>> = hull.vertices.iter().map(|p| p - anchor).collect();
    let mut boxes: Vec<Box3> = directions(hull).into_iter().filter_map(|axis| Box3::along(&corners, axis)).collect();
    boxes.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    boxes.truncate(MAX_REFINED);
    boxes.extend((0..SPREAD).filter_map(|i| Box3::along(&corners, spread(i))));
    let local: Vec<Point3<f32>> = corners.iter().map(|p| Point3::from(p.cast::<f32>())).collect();
    let upright = upright_box(&local)?.t_frame_box.rotation * Vector3::x_axis();
    boxes.extend(Box3::along(&corners, upright));
    let refined = boxes.into_iter().map(|b| b.refined(&corners));
    let best = refined.min_by(|a, b| a.cost().total_cmp(&b.cost()))?;
    Some(best.posed(anchor))
}

/// Direction `i` of a spiral over the half sphere (Fibonacci's).
fn spread(i: usize) -> Unit<Vector3<f64>> {
    let z = (i as f64 + 0.5) / SPREAD as f64;
    let (sin, cos) = (i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt())).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Unit::new_normalize(Vector3::new(r * cos, r * sin, z))
}

/// Normals of the largest facets; of a flat cloud its own, of a line any across it.
fn directions(hull: &Hull3) -> Vec<Unit<Vector3<f64>>> {
    let at = |i: u32| hull.vertices[i as usize];
    let mut crosses: Vec<Vector3<f64>> =
        hull.triangles.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(&(at(c) - at(a)))).collect();
    if crosses.is_empty() {
        let (a, b) = (at(0), at(hull.vertices.len() as u32 / 2));
        let across = hull.vertices.iter().map(|p| (b - a).cross(&(p - a)));
        let normal = across.max_by(|x, y| x.norm_squared().total_cmp(&y.norm_squared())).unwrap_or_default();
        crosses.push(normal);
    }
    crosses.sort_by(|a, b| b.norm_squared().total_cmp(&a.norm_squared()));
    crosses.truncate(MAX_FACETS);
    let mut axes: Vec<Unit<Vector3<f64>>> = crosses.iter().filter_map(|c| Unit::try_new(*c, 0.0)).collect();
    if axes.is_empty() {
        let along = hull.vertices.last().map(|p| p - at(0)).unwrap_or_default();
        let across = along.cross(&Vector3::ith(along.iamin(), 1.0));
        axes.push(Unit::try_new(across, 0.0).unwrap_or_else(Vector3::z_axis));
    }
    axes
}

/// Axes, and the interval of the cloud along each.
#[derive(Clone, Copy)]
struct Box3 {
    axes: [Vector3<f64>; 3],
    intervals: [[f64; 2]; 3],
}

impl Box3 {
    /// The least box with a side across `axis`.
    fn along(points: &[Vector3<f64>], axis: Unit<Vector3<f64>>) -> Option<Self> {
        let u = Unit::new_normalize(axis.cross(&Vector3::ith(axis.iamin(), 1.0)));
        let v = axis.cross(&u);
        let flat: Vec<Point2<f64>> = points.iter().map(|p| Point2::new(u.dot(p), v.dot(p))).collect();
        let Rectangle { yaw, .. } = minimum_area_rectangle(&flat)?;
        let (sin, cos) = yaw.sin_cos();
        let axes = [u.into_inner() * cos + v * sin, v * cos - u.into_inner() * sin, axis.into_inner()];
        let interval = |axis: &Vector3<f64>| {
            let along = points.iter().map(|p| axis.dot(p));
            [along.clone().fold(f64::INFINITY, f64::min), along.fold(f64::NEG_INFINITY, f64::max)]
        };
        Some(Self { axes, intervals: [interval(&axes[0]), interval(&axes[1]), interval(&axes[2])] })
    }

    fn sizes(&self) -> [f64; 3] {
        self.intervals.map(|[low, high]| high - low)
    }

    /// Volume, and for flat boxes area.
    fn cost(&self) -> f64 {
        let [a, b, c] = self.sizes();
        let thin = 1e-9 * a.max(b).max(c);
        (a + thin) * (b + thin) * (c + thin)
    }

    fn refined(mut self, points: &[Vector3<f64>]) -> Self {
        for _ in 0..50 {
            let turned = self.axes.iter().filter_map(|axis| Self::along(points, Unit::new_normalize(*axis)));
            let best = turned.min_by(|a, b| a.cost().total_cmp(&b.cost()));
            match best {
                Some(better) if better.cost() < self.cost() * (1.0 - 1e-9) => self = better,
                _ => break,
            }
        }
        self
    }

    fn posed(&self, anchor: Point3<f64>) -> OrientedBox3 {
        let sizes = self.sizes();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| sizes[b].total_cmp(&sizes[a]));
        let [x, y] = [self.axes[order[0]], self.axes[order[1]]];
        let r = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
        let middles = self.axes.iter().zip(&self.intervals).map(|(axis, [low, high])| axis * (0.5 * (low + high)));
        let center = anchor + middles.sum::<Vector3<f64>>();
        let t_frame_box = Pose::from_parts(center.coords.into(), UnitQuaternion::from_rotation_matrix(&r));
        OrientedBox3 { t_frame_box, size: Vector3::from(order.map(|i| sizes[i])) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_turned_brick_is_found_as_it_is(
            turn in prop::array::uniform3(-3.0..3.0f64), size in prop::array::uniform3(0.2..3.0f64),
        ) {
            let r = Rotation3::from_scaled_axis(Vector3::from(turn));
            let t_frame_box = Pose::from_parts(Vector3::new(1.0, 2.0, 3.0).into(), r.into());
            let truth = OrientedBox3 { t_frame_box, size: Vector3::from(size) };
            let points: Vec<Point3<f32>> = truth.corners().iter().map(|p| p.cast()).collect();
            let found = minimal_box(&points).unwrap();
            prop_assert!((found.volume() / truth.volume() - 1.0).abs() < 1e-4);
            prop_assert!(found.size.x >= found.size.y && found.size.y >= found.size.z);
        }

        #[test]
        fn points_are_inside_and_no_turned_box_is_much_smaller(
            points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f32), 4..40),
            turns in prop::collection::vec(prop::array::uniform3(-3.0..3.0f64), 40),
        ) {
            let points: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
            let found = minimal_box(&points).unwrap();
            let grown = OrientedBox3 { size: found.size.add_scalar(1e-4), ..found };
            prop_assert!(points.iter().all(|p| grown.contains(&p.cast())));
            for turn in turns {
                let r = Rotation3::from_scaled_axis(Vector3::from(turn));
                let turned: Vec<Point3<f32>> = points.iter().map(|p| (r * p.cast::<f64>()).cast()).collect();
                let other = percept_geometry::Aabb3::of(&turned).size().product();
                prop_assert!(found.volume() <= other * 1.002);
            }
        }
    }

    #[test]
    fn the_smallest_box_of_a_regular_tetrahedron_is_a_cube() {
        // No side of that cube holds a facet of it: only edges.
        let points = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0f32]].map(Point3::from);
        assert!((minimal_box(&points).unwrap().volume() - 8.0).abs() < 1e-4);
    }

    #[test]
    fn degenerate_clouds_have_flat_boxes() {
        assert_eq!(minimal_box(&[]), None);
        assert_eq!(minimal_box(&[Point3::new(1e7, 2.0, 3.0); 3]).unwrap().size, Vector3::zeros());
        let line: Vec<Point3<f32>> = (0..11).map(|i| Point3::new(i as f32, i as f32, 0.0)).collect();
        assert!((minimal_box(&line).unwrap().size - Vector3::new(200f64.sqrt(), 0.0, 0.0)).norm() < 1e-6);
        let r = Rotation3::from_euler_angles(0.3, 0.4, 0.5);
        let sheet: Vec<Point3<f32>> =
            (0..66).map(|i| (r * Point3::new((i % 11) as f64, (i / 11) as f64, 0.0)).cast()).collect();
        assert!((minimal_box(&sheet).unwrap().size - Vector3::new(10.0, 5.0, 0.0)).norm() < 1e-4);
    }
}

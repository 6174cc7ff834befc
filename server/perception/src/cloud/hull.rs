//! Convex hull and smallest rectangle in the plane.

use nalgebra::{Point2, Vector2};

/// The convex hull, counter-clockwise from the leftmost point, without points inside its edges.
/// One or two points if all are equal or on a line. Points must be finite.
///
/// Source: Andrew, "Another efficient algorithm for convex hulls in two dimensions", 1979.
pub fn convex_hull(points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    // A zero with a sign would be sorted apart from the other zeros.
    let mut sorted: Vec<Point2<f64>> = points.iter().map(|p| p.map(|v| v + 0.0)).collect();
    sorted.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    let mut hull: Vec<Point2<f64>> = Vec::new();
    for pass in 0..2 {
        let base = hull.len();
        let mut push = |p: Point2<f64>| {
            while hull.len() >= base + 2 && turn(&hull[hull.len() - 2], &hull[hull.len() - 1], &p) <= 0.0 {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            sorted.iter().for_each(|p| push(*p))
        } else {
            sorted.iter().rev().for_each(|p| push(*p))
        }
        // The last point of a chain is the first of the other.
        hull.pop();
    }
    hull
}

fn turn(a: &Point2<f64>, b: &Point2<f64>, c: &Point2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// A rectangle: centre, edge lengths (the longer first) and the angle of its longer edge from x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Centre.
    pub center: Point2<f64>,
    /// Longer and shorter edge.
    pub size: Vector2<f64>,
    /// Angle of the longer edge, radians in (-pi/2, pi/2].
    pub yaw: f64,
}

/// The rectangle of least area around points (finite), none if there is none. A point gives size 0, points
/// on a line width 0.
///
/// One side of it lies along an edge of the hull (Freeman and Shapira 1975); all edges are tried in a single
/// turn of four calipers (Toussaint, "Solving geometric problems with the rotating calipers", 1983). Of
/// rectangles whose areas agree to 1e-9 the first wins.
pub fn minimum_area_rectangle(points: &[Point2<f64>]) -> Option<Rectangle> {
    let hull = convex_hull(points);
    match hull[..] {
        [] => None,
        [p] => Some(Rectangle { center: p, size: Vector2::zeros(), yaw: 0.0 }),
        [p, q] => Some(Rectangle {
            center: nalgebra::center(&p, &q),
            size: Vector2::new((q - p).norm(), 0.0),
            yaw: half_turn((q - p).y.atan2((q - p).x)),
        }),
        _ => calipers(&hull),
    }
}

fn calipers(hull: &[Point2<f64>]) -> Option<Rectangle> {
    let n = hull.len();
    let at = |i: usize| hull[i % n].coords;
    let mut best: Option<(f64, Rectangle)> = None;
    // Farthest along the edge, across it, and back along it; each only ever moves on.
    let (mut right, mut top, mut left) = (1, 1, 1);
    for i in 0..n {
        let u = (at(i + 1) - at(i)).normalize();
        let v = Vector2::new(-u.y, u.x);
        let advance = |from: usize, along: Vector2<f64>| {
            let mut k = from;
            while k < i + 2 * n && along.dot(&(at(k + 1) - at(k))) > 0.0 {
                k += 1;
            }
            k
        };
        right = advance(right.max(i + 1), u);
        top = advance(top.max(right), v);
        left = advance(left.max(top), -u);
        let (u0, u1) = (u.dot(&at(left)), u.dot(&at(right)));
        let (v0, v1) = (v.dot(&at(i)), v.dot(&at(top)));
        let area = (u1 - u0) * (v1 - v0);
        if best.as_ref().is_none_or(|(least, _)| area < least * (1.0 - 1e-9)) {
            let center = Point2::from(u * (0.5 * (u0 + u1)) + v * (0.5 * (v0 + v1)));
            best = Some((area, rectangle(center, u1 - u0, v1 - v0, u.y.atan2(u.x))));
        }
    }
    best.map(|(_, rectangle)| rectangle)
}

fn rectangle(center: Point2<f64>, along: f64, across: f64, angle: f64) -> Rectangle {
    let (size, yaw) = if along >= across {
        (Vector2::new(along, across), angle)
    } else {
        (Vector2::new(across, along), angle + std::f64::consts::FRAC_PI_2)
    };
    Rectangle { center, size, yaw: half_turn(yaw) }
}

/// The same direction of an edge in (-pi/2, pi/2].
fn half_turn(angle: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, PI};
    let a = angle.rem_euclid(PI);
    if a > FRAC_PI_2 { a - PI } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn extents(points: &[Point2<f64>], angle: f64) -> Vector2<f64> {
        let range = |d: Vector2<f64>| {
            let values = points.iter().map(|p| d.dot(&p.coords));
            values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
        };
        Vector2::new(range(Vector2::new(angle.cos(), angle.sin())), range(Vector2::new(-angle.sin(), angle.cos())))
    }

    #[test]
    fn zeros_with_a_sign_are_on_the_same_line() {
        let points = [Point2::new(0.0, 0.0), Point2::new(0.0, 3.0), Point2::new(-0.0, 4.0)];
        assert_eq!(convex_hull(&points), [points[0], Point2::new(0.0, 4.0)]);
        let found = minimum_area_rectangle(&points).unwrap();
        assert_eq!((found.size, found.center), (Vector2::new(4.0, 0.0), Point2::new(0.0, 2.0)));
    }

    proptest! {
        #[test]
        fn no_edge_of_the_hull_gives_a_smaller_rectangle(
            points in prop::collection::vec([-5.0..5.0f64, -5.0..5.0f64], 3..60), snap in any::<bool>(),
        ) {
            let points: Vec<Point2<f64>> =
                points.into_iter().map(|p| Point2::from(if snap { p.map(f64::round) } else { p })).collect();
            let hull = convex_hull(&points);
            let found = minimum_area_rectangle(&points).unwrap();
            for p in &points {
                let q = nalgebra::Rotation2::new(-found.yaw) * (p - found.center);
                prop_assert!(q.x.abs() <= 0.5 * found.size.x + 1e-9 && q.y.abs() <= 0.5 * found.size.y + 1e-9);
            }
            if hull.len() >= 3 {
                let brute = (0..hull.len()).map(|i| {
                    let e = hull[(i + 1) % hull.len()] - hull[i];
                    extents(&points, e.y.atan2(e.x)).product()
                }).fold(f64::INFINITY, f64::min);
                prop_assert!((found.size.product() - brute).abs() <= 1e-8 * brute.max(1e-3));
            }
        }

        #[test]
        fn every_point_is_left_of_every_edge_of_the_hull(
            points in prop::collection::vec([-3..3i32, -3..3i32], 3..40),
        ) {
            let points: Vec<Point2<f64>> = points.iter().map(|p| Point2::from(p.map(f64::from))).collect();
            let hull = convex_hull(&points);
            for i in 0..hull.len() {
                for p in &points {
                    prop_assert!(turn(&hull[i], &hull[(i + 1) % hull.len()], p) >= 0.0 || hull.len() < 3);
                }
            }
        }
    }

    #[test]
    fn a_turned_rectangle_is_found_as_it_is() {
        let r = nalgebra::Rotation2::new(0.4);
        let points: Vec<Point2<f64>> = (0..400)
            .map(|i| r * Point2::new((i % 20) as f64 / 19.0 * 3.0, (i / 20) as f64 / 19.0) + Vector2::new(7.0, -2.0))
            .collect();
        let found = minimum_area_rectangle(&points).unwrap();
        assert!((found.size - Vector2::new(3.0, 1.0)).norm() < 1e-9);
        assert!((found.yaw - 0.4).abs() < 1e-9);
    }
}

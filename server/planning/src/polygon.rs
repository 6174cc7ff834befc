//! Polygons in the plane, as their corners in order.

use nalgebra::{Point2, Vector2};

/// From corner to corner.
pub(crate) type Edge = (Point2<f64>, Point2<f64>);

/// All of a polygon, from its first corner on.
pub(crate) fn edges(corners: &[Point2<f64>]) -> impl Iterator<Item = Edge> + '_ {
    (0..corners.len()).map(|i| (corners[i], corners[(i + 1) % corners.len()]))
}

/// Whether a point is inside a polygon: a ray to the right crosses its edges an odd number of times.
pub(crate) fn contains(corners: &[Point2<f64>], p: &Point2<f64>) -> bool {
    edges(corners).fold(false, |inside, (a, b)| {
        let crosses = (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x);
        inside != crosses
    })
}

/// Whether the segment passes through the square: slabs of Kay and Kajiya 1986.
pub(crate) fn crosses(a: &Point2<f64>, along: &Vector2<f64>, low: &Point2<f64>, high: &Point2<f64>) -> bool {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for i in 0..2 {
        if along[i] == 0.0 {
            if a[i] < low[i] || a[i] > high[i] {
                return false;
            }
            continue;
        }
        let (t0, t1) = ((low[i] - a[i]) / along[i], (high[i] - a[i]) / along[i]);
        enter = enter.max(t0.min(t1));
        leave = leave.min(t0.max(t1));
    }
    enter <= leave
}

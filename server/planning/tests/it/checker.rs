//! Checks a steered path without the planner's code: separating axes at poses a few millimetres apart.

use nalgebra::{Point2, Vector2};
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::{Path, Pose2, Waypoint};

/// Between the poses that the planner looks at, it allows half of this, metres.
const SLACK_M: f64 = 1e-3;

/// Whether a convex polygon, placed at a pose, overlaps a cell that is occupied, unknown or outside, by more than the slack.
pub(crate) fn overlaps(grid: &DenseGrid, polygon: &[[f64; 2]], pose: &Pose2) -> bool {
    let (sin, cos) = pose.yaw_rad.sin_cos();
    let placed = |[x, y]: [f64; 2]| pose.position + Vector2::new(x * cos - y * sin, x * sin + y * cos);
    let corners: Vec<Point2<f64>> = polygon.iter().map(|c| placed(*c)).collect();
    let mut axes = vec![Vector2::x(), Vector2::y()];
    axes.extend((0..corners.len()).map(|i| {
        let edge = corners[(i + 1) % corners.len()] - corners[i];
        Vector2::new(-edge.y, edge.x).normalize()
    }));
    let range = |points: &[Point2<f64>], axis: &Vector2<f64>| {
        let along = |p: &Point2<f64>| p.coords.dot(axis);
        points.iter().map(along).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
    };
    let reach = corners.iter().map(|c| (c - pose.position).norm()).fold(0.0, f64::max) + grid.geometry.resolution_m;
    let low = grid.geometry.cell(&(pose.position - Vector2::repeat(reach))).unwrap();
    let high = grid.geometry.cell(&(pose.position + Vector2::repeat(reach))).unwrap();
    for cell in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| Cell::new(x, y))) {
        if grid.value(cell).is_some_and(|v| v.is_some_and(|v| v < 60)) {
            continue;
        }
        let a = grid.geometry.corner(cell);
        let b = grid.geometry.corner(Cell::new(cell.x + 1, cell.y + 1));
        let square = [a, Point2::new(b.x, a.y), b, Point2::new(a.x, b.y)];
        let apart = |axis: &Vector2<f64>| {
            let (one, other) = (range(&corners, axis), range(&square, axis));
            one.1 <= other.0 + SLACK_M || other.1 <= one.0 + SLACK_M
        };
        if !axes.iter().any(apart) {
            return true;
        }
    }
    false
}

/// Panics unless waypoints lie on arcs no tighter than `radius`, driven as they say, along which the polygon fits, and the
/// told length is theirs. Returns whether any of it is driven backwards.
pub(crate) fn check(grid: &DenseGrid, polygon: &[[f64; 2]], path: &Path, radius: f64) -> bool {
    let (mut length, mut reverse) = (0.0, false);
    for pair in path.waypoints.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        let chord = b.position - a.position;
        if chord.norm() < 1e-7 {
            continue;
        }
        let turned = percept_geometry::se3::wrap_angle(b.yaw_rad - a.yaw_rad);
        let direction = if a.is_reverse { -1.0 } else { 1.0 };
        // The chord of an arc lies half way between the tangents at its ends.
        let along = chord * direction / chord.norm();
        let (sin, cos) = (a.yaw_rad + 0.5 * turned).sin_cos();
        // Rounding of joined arcs, over the chord.
        assert!((along - Vector2::new(cos, sin)).norm() < 1e-6 + 1e-7 / chord.norm(), "{a:?} {b:?}");
        let arc = if turned.abs() < 1e-9 { chord.norm() } else { chord.norm() * 0.5 * turned / (0.5 * turned).sin() };
        assert!(turned.abs() <= arc / radius * (1.0 + 1e-6) + 1e-6, "{a:?} {b:?} turn on {}", arc / turned);
        length += arc;
        reverse |= a.is_reverse;
        let steps = (arc / 0.005).ceil();
        for i in 0..=steps as usize {
            let pose = between(a, turned, arc * direction, i as f64 / steps);
            assert!(!overlaps(grid, polygon, &pose), "{pose:?}");
        }
    }
    assert!((length - path.length_m).abs() < 1e-4 * (1.0 + length), "{length} {}", path.length_m);
    reverse
}

fn between(a: &Waypoint, turned: f64, length: f64, share: f64) -> Pose2 {
    let half = 0.5 * turned * share;
    let chord = length * share * if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
    let (sin, cos) = (a.yaw_rad + half).sin_cos();
    Pose2 { position: a.position + Vector2::new(cos, sin) * chord, yaw_rad: a.yaw_rad + 2.0 * half }
}

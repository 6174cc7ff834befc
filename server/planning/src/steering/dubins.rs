//! Curves that go forwards only.

use super::{Piece, TOUCHING};
use nalgebra::Point2;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Visits Dubins' six words from the origin, looking along x, to a pose in turning radii.
///
/// Source: Dubins, "On curves of minimal length with a constraint on average curvature", 1957; the lengths are derived here
/// from the circles that touch both poses: their centres' distance and bearing give the middle piece.
pub(super) fn words(goal: Point2<f64>, yaw: f64, mut visit: impl FnMut(&[Piece])) {
    let center = |p: Point2<f64>, yaw: f64, turn: f64| Point2::new(p.x - turn * yaw.sin(), p.y + turn * yaw.cos());
    for (first, last) in [(1i8, 1i8), (1, -1), (-1, 1), (-1, -1)] {
        let (s, e) = (f64::from(first), f64::from(last));
        let d = center(goal, yaw, e) - center(Point2::origin(), 0.0, s);
        let (distance, bearing) = (d.norm(), d.y.atan2(d.x));
        // Both arcs in the direction of their turns.
        let arcs = |along: f64| (angle(s * along), angle(e * (yaw - along)));
        if first == last {
            // The straight piece is as long as the way between the centres, and parallel to it.
            let (t, v) = arcs(bearing);
            visit(&[piece(first, t), piece(0, distance), piece(last, v)]);
            if distance <= 4.0 {
                // A third circle touches both, with its centre to either side of the line between theirs. On a circle, the
                // robot looks a quarter turn from the direction in which it stands from the centre.
                let off = (0.25 * distance).acos();
                for side in [off, -off] {
                    let leave = bearing + side + s * FRAC_PI_2;
                    let enter = bearing + PI - side + s * FRAC_PI_2;
                    let (t, u, v) = (angle(s * leave), angle(s * (leave - enter)), angle(s * (yaw - enter)));
                    visit(&[piece(first, t), piece(-first, u), piece(last, v)]);
                }
            }
        } else if distance >= TOUCHING {
            // The straight piece crosses the line between the centres.
            let length = (distance * distance - 4.0).max(0.0).sqrt();
            let (t, v) = arcs(bearing + s * 2.0f64.atan2(length));
            visit(&[piece(first, t), piece(0, length), piece(last, v)]);
        }
    }
}

fn piece(turn: i8, length: f64) -> Piece {
    Piece { turn, length }
}

/// 0 up to a whole turn; a hair less than a whole one is none.
fn angle(a: f64) -> f64 {
    let a = a.rem_euclid(TAU);
    if a > TAU - 1e-9 { 0.0 } else { a }
}

//! Curves of bounded curvature: arcs and straight pieces between two poses.
//!
//! Comes in: two poses and the least turning radius. Goes out: [`Curve`]s, by Dubins for robots that only go forwards, by
//! Reeds and Shepp for those that may go back. No obstacles here.

mod dubins;
mod reeds_shepp;

use crate::Pose2;
use nalgebra::{Point2, Vector2};
use percept_geometry::se3::wrap_angle;

/// A piece of a curve in units of the turning radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// 1 to the left, -1 to the right, 0 straight.
    pub turn: i8,
    /// Its length over the turning radius (of an arc: its angle); negative: backwards.
    pub length: f64,
}

/// Up to five pieces, each followed from where the one before ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    pieces: [Piece; 5],
    num_pieces: usize,
    turning_radius_m: f64,
}

/// Shorter pieces are left out, in turning radii: they come from rounding.
const SHORTEST: f64 = 1e-9;

/// Circles of radius 1 whose centres are so far apart touch, but for rounding.
const TOUCHING: f64 = 2.0 - 1e-12;

impl Curve {
    fn new(pieces: &[Piece], turning_radius_m: f64) -> Self {
        let mut out = Self { pieces: [Piece { turn: 0, length: 0.0 }; 5], num_pieces: 0, turning_radius_m };
        for piece in pieces.iter().filter(|p| p.length.abs() > SHORTEST) {
            out.pieces[out.num_pieces] = *piece;
            out.num_pieces += 1;
        }
        out
    }

    /// Its pieces in order.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces[..self.num_pieces]
    }

    /// Length of the way, metres.
    pub fn length_m(&self) -> f64 {
        self.pieces().iter().map(|p| p.length.abs()).sum::<f64>() * self.turning_radius_m
    }

    /// Changes between forwards and backwards.
    pub fn num_cusps(&self) -> usize {
        self.pieces().windows(2).filter(|p| p[0].length * p[1].length < 0.0).count()
    }

    /// Each piece as it lies: where it begins, and what is driven from there.
    pub fn arcs(&self, from: &Pose2) -> impl Iterator<Item = (Pose2, Arc)> {
        let mut at = *from;
        self.pieces().iter().map(move |piece| {
            let curvature = f64::from(piece.turn) / self.turning_radius_m;
            let arc = Arc { curvature, length: piece.length * self.turning_radius_m };
            let begin = at;
            at = arc.after(&at, arc.length);
            (begin, arc)
        })
    }

    /// Where it leads from a pose.
    pub fn end(&self, from: &Pose2) -> Pose2 {
        self.arcs(from).last().map_or(*from, |(begin, arc)| arc.after(&begin, arc.length))
    }
}

/// A way of constant curvature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// 1/m, positive to the left seen in the direction in which the robot looks.
    pub curvature: f64,
    /// Metres, negative: backwards.
    pub length: f64,
}

impl Arc {
    /// The pose after `along` metres (negative: backwards) from a pose on it.
    pub fn after(&self, from: &Pose2, along: f64) -> Pose2 {
        let turned = self.curvature * along;
        // The chord: the sine over its angle is exact for small ones too.
        let half = 0.5 * turned;
        let chord = if half.abs() < 1e-6 { along } else { along * half.sin() / half };
        let (sin, cos) = (from.yaw_rad + half).sin_cos();
        Pose2 { position: from.position + Vector2::new(cos, sin) * chord, yaw_rad: wrap_angle(from.yaw_rad + turned) }
    }
}

/// All curves of the known families between two poses, in no order; the shortest possible one is among them.
///
/// `turning_radius_m` is positive. Without `allow_reverse` no piece is driven backwards.
pub fn curves(from: &Pose2, to: &Pose2, turning_radius_m: f64, allow_reverse: bool) -> Vec<Curve> {
    let mut out = Vec::new();
    each_curve(from, to, turning_radius_m, allow_reverse, |curve| out.push(curve));
    out
}

/// As [`curves`], without keeping them.
pub(crate) fn each_curve(
    from: &Pose2,
    to: &Pose2,
    turning_radius_m: f64,
    allow_reverse: bool,
    mut visit: impl FnMut(Curve),
) {
    let (goal, yaw) = seen_from(from, to, turning_radius_m);
    let visit = |pieces: &[Piece]| visit(Curve::new(pieces, turning_radius_m));
    if allow_reverse { reeds_shepp::words(goal, yaw, visit) } else { dubins::words(goal, yaw, visit) }
}

/// The shortest curve between two poses.
pub fn shortest_curve(from: &Pose2, to: &Pose2, turning_radius_m: f64, allow_reverse: bool) -> Option<Curve> {
    let mut best: Option<(f64, Curve)> = None;
    each_curve(from, to, turning_radius_m, allow_reverse, |curve| {
        let length = curve.length_m();
        if best.as_ref().is_none_or(|(least, _)| length < *least) {
            best = Some((length, curve));
        }
    });
    best.map(|(_, curve)| curve)
}

/// `to` in the frame of `from`, in turning radii.
fn seen_from(from: &Pose2, to: &Pose2, turning_radius_m: f64) -> (Point2<f64>, f64) {
    let d = (to.position - from.position) / turning_radius_m;
    let (sin, cos) = from.yaw_rad.sin_cos();
    let position = Point2::new(d.x * cos + d.y * sin, d.y * cos - d.x * sin);
    (position, wrap_angle(to.yaw_rad - from.yaw_rad))
}

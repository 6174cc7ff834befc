//! Curves that go forwards and backwards.

use super::{Piece, TOUCHING};
use nalgebra::Point2;
use percept_geometry::se3::wrap_angle;
use std::f64::consts::{FRAC_PI_2, PI};

/// Visits Reeds' and Shepp's words from the origin, looking along x, to a pose in turning radii.
///
/// Source: Reeds and Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990, section 8: nine base
/// words (equations 8.1 to 8.11; there 8.3 and 8.4 share their formula, 8.5 and 8.6 are it reversed), each also time-flipped,
/// reflected and reversed. A word whose lengths have the wrong sign is no shorter than others and left out.
pub(super) fn words(goal: Point2<f64>, yaw: f64, mut visit: impl FnMut(&[Piece])) {
    let (sin, cos) = yaw.sin_cos();
    // Followed from its end, a word leads to this pose.
    let reversed = (goal.x * cos + goal.y * sin, goal.x * sin - goal.y * cos);
    for (is_reversed, (x, y)) in [(false, (goal.x, goal.y)), (true, reversed)] {
        for (flip, mirror) in [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)] {
            let yaw = yaw * flip * mirror;
            let ends = Ends::new(x * flip, y * mirror, yaw);
            let mut visit = |word: Option<([i8; 5], [f64; 5])>| {
                let Some((turns, lengths)) = word else { return };
                let mut pieces = [Piece { turn: 0, length: 0.0 }; 5];
                for i in 0..5 {
                    let to = if is_reversed { 4 - i } else { i };
                    pieces[to] = Piece { turn: turns[i] * mirror as i8, length: lengths[i] * flip };
                }
                visit(&pieces);
            };
            visit(ends.ccc());
            visit(ends.ccsc_same());
            visit(ends.ccsc_other());
            if !is_reversed {
                // Reversed, these are words of the same family.
                visit(ends.csc_same());
                visit(ends.csc_other());
                visit(ends.cccc_equal());
                visit(ends.cccc_opposite());
                visit(ends.ccscc());
            }
        }
    }
}

const L: i8 = 1;
const R: i8 = -1;
const S: i8 = 0;

type Word = Option<([i8; 5], [f64; 5])>;

/// The goal, and what all words need of it: the centres of its left and of its right circle, seen from that of the
/// start's left circle.
struct Ends {
    yaw: f64,
    same: (f64, f64),
    other: (f64, f64),
}

impl Ends {
    fn new(x: f64, y: f64, yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        Self { yaw, same: (x - sin, y - 1.0 + cos), other: (x + sin, y - 1.0 - cos) }
    }

    /// Eq. 8.1: L+ S+ L+.
    fn csc_same(&self) -> Word {
        let (u, t) = polar(self.same);
        let v = wrap_angle(self.yaw - t);
        (t >= 0.0 && v >= 0.0).then_some(([L, S, L, S, S], [t, u, v, 0.0, 0.0]))
    }

    /// Eq. 8.2: L+ S+ R+.
    fn csc_other(&self) -> Word {
        let (distance, bearing) = polar(self.other);
        if distance < TOUCHING {
            return None;
        }
        let u = (distance * distance - 4.0).max(0.0).sqrt();
        let t = wrap_angle(bearing + 2.0f64.atan2(u));
        let v = wrap_angle(t - self.yaw);
        (t >= 0.0 && v >= 0.0).then_some(([L, S, R, S, S], [t, u, v, 0.0, 0.0]))
    }

    /// Eq. 8.3 and 8.4: L+ R- L with either sign.
    fn ccc(&self) -> Word {
        let (distance, bearing) = polar(self.same);
        if distance > 4.0 {
            return None;
        }
        let u = -2.0 * (0.25 * distance).asin();
        let t = wrap_angle(bearing + 0.5 * u + PI);
        let v = wrap_angle(self.yaw - t + u);
        (t >= 0.0 && u <= 0.0).then_some(([L, R, L, S, S], [t, u, v, 0.0, 0.0]))
    }

    /// Eq. 8.7: L+ R+ L- R-, the middle ones as long as each other.
    fn cccc_equal(&self) -> Word {
        let rho = 0.25 * (2.0 + self.other.0.hypot(self.other.1));
        if rho > 1.0 {
            return None;
        }
        let u = rho.acos();
        let (t, v) = self.outer(u, -u);
        (t >= 0.0 && v <= 0.0).then_some(([L, R, L, R, S], [t, u, -u, v, 0.0]))
    }

    /// Eq. 8.8: L+ R- L- R+.
    fn cccc_opposite(&self) -> Word {
        let rho = (20.0 - self.other.0 * self.other.0 - self.other.1 * self.other.1) / 16.0;
        if !(0.0..=1.0).contains(&rho) {
            return None;
        }
        let u = -rho.acos();
        let (t, v) = self.outer(u, u);
        (t >= 0.0 && v >= 0.0).then_some(([L, R, L, R, S], [t, u, u, v, 0.0]))
    }

    /// Eq. 8.6: the first and the last arc of four, by the two between.
    fn outer(&self, u: f64, v: f64) -> (f64, f64) {
        let (xi, eta) = self.other;
        let delta = wrap_angle(u - v);
        let a = u.sin() - delta.sin();
        let b = u.cos() - delta.cos() - 1.0;
        let t1 = (eta * a - xi * b).atan2(xi * a + eta * b);
        let t2 = 2.0 * (delta.cos() - v.cos() - u.cos()) + 3.0;
        let t = wrap_angle(if t2 < 0.0 { t1 + PI } else { t1 });
        (t, wrap_angle(t - u + v - self.yaw))
    }

    /// Eq. 8.9: L+ R-(pi/2) S- L-.
    fn ccsc_same(&self) -> Word {
        let (distance, bearing) = polar(self.same);
        if distance < 2.0 {
            return None;
        }
        let r = (distance * distance - 4.0).max(0.0).sqrt();
        let u = 2.0 - r;
        let t = wrap_angle(bearing + r.atan2(-2.0));
        let v = wrap_angle(self.yaw - FRAC_PI_2 - t);
        (t >= 0.0 && u <= 0.0 && v <= 0.0).then_some(([L, R, S, L, S], [t, -FRAC_PI_2, u, v, 0.0]))
    }

    /// Eq. 8.10: L+ R-(pi/2) S- R-.
    fn ccsc_other(&self) -> Word {
        let (distance, t) = polar((-self.other.1, self.other.0));
        let u = 2.0 - distance;
        let v = wrap_angle(t + FRAC_PI_2 - self.yaw);
        (t >= 0.0 && u <= 0.0 && v <= 0.0).then_some(([L, R, S, R, S], [t, -FRAC_PI_2, u, v, 0.0]))
    }

    /// Eq. 8.11: L+ R-(pi/2) S- L-(pi/2) R+.
    fn ccscc(&self) -> Word {
        let (xi, eta) = self.other;
        let distance = xi.hypot(eta);
        if distance < 2.0 {
            return None;
        }
        let u = 4.0 - (distance * distance - 4.0).max(0.0).sqrt();
        let t = wrap_angle(((4.0 - u) * xi - 2.0 * eta).atan2(-2.0 * xi + (u - 4.0) * eta));
        let v = wrap_angle(t - self.yaw);
        (u <= 0.0 && t >= 0.0 && v >= 0.0).then_some(([L, R, S, L, R], [t, -FRAC_PI_2, u, -FRAC_PI_2, v]))
    }
}

fn polar((x, y): (f64, f64)) -> (f64, f64) {
    (x.hypot(y), y.atan2(x))
}

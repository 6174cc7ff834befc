//! Shorten, smooth, check again.

use crate::Costmap;
use nalgebra::Point2;

/// Rounds of smoothing.
const ROUNDS: usize = 50;

/// Steps of the path that one straight leg may replace: keeps the work linear in the path's length.
const LONGEST_LEG: usize = 400;

/// How far a waypoint moves towards the middle of its neighbours in one round, as a share.
const PULL: f64 = 0.5;

/// Leaves out corners of the path: each waypoint is followed by the last one that it can see before it first cannot. A
/// straight leg is taken if it keeps `clearance` (m), or as much as what it replaces, and costs no more than that.
/// Keeps the ends.
pub fn shorten(costmap: &Costmap, path: &[Point2<f64>], clearance: f64) -> Vec<Point2<f64>> {
    let Some(&first) = path.first() else { return Vec::new() };
    let mut out = vec![first];
    let mut from = 0;
    while from + 1 < path.len() {
        let mut to = from + 1;
        let mut replaced = Leg::of(costmap, &path[from], &path[to], clearance);
        for next in to + 1..path.len().min(from + LONGEST_LEG) {
            replaced = replaced.and(&Leg::of(costmap, &path[next - 1], &path[next], clearance));
            let straight = Leg::of(costmap, &path[from], &path[next], replaced.clearance);
            if !straight.is_no_worse_than(&replaced) {
                break;
            }
            to = next;
        }
        out.push(path[to]);
        from = to;
    }
    out
}

/// Points along the path at most `spacing` (m) apart, its corners among them.
pub fn resample(path: &[Point2<f64>], spacing: f64) -> Vec<Point2<f64>> {
    let mut out: Vec<Point2<f64>> = path.first().copied().into_iter().collect();
    for leg in path.windows(2) {
        let pieces = ((leg[1] - leg[0]).norm() / spacing).ceil().max(1.0);
        out.extend((1..pieces as usize).map(|i| leg[0] + (leg[1] - leg[0]) * (i as f64 / pieces)));
        out.push(leg[1]);
    }
    out
}

/// Rounds the corners: each waypoint is drawn to the middle of its neighbours, as long as the two legs keep
/// `clearance` (m), or as much as they had, and cost no more. Keeps the ends.
pub fn smooth(costmap: &Costmap, path: &[Point2<f64>], clearance: f64) -> Vec<Point2<f64>> {
    let mut out = path.to_vec();
    for _ in 0..ROUNDS {
        let mut moved = false;
        for i in 1..out.len().saturating_sub(1) {
            let (a, b) = (out[i - 1], out[i + 1]);
            let target = out[i] + (nalgebra::center(&a, &b) - out[i]) * PULL;
            // A hundredth of a cell is no visible corner.
            if (target - out[i]).norm() < 0.01 * costmap.geometry().resolution_m {
                continue;
            }
            let both =
                |p: &Point2<f64>, limit: f64| Leg::of(costmap, &a, p, limit).and(&Leg::of(costmap, p, &b, limit));
            let now = both(&out[i], clearance);
            if both(&target, now.clearance).is_no_worse_than(&now) {
                out[i] = target;
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
    out
}

/// Part of a way: what it costs and how near it comes to obstacles (m, at most the limit that it was asked with).
struct Leg {
    cost: f64,
    clearance: f64,
}

impl Leg {
    fn of(costmap: &Costmap, a: &Point2<f64>, b: &Point2<f64>, limit: f64) -> Self {
        Self { cost: costmap.segment_cost(a, b), clearance: costmap.segment_clearance(a, b, limit) }
    }

    fn and(&self, other: &Self) -> Self {
        Self { cost: self.cost + other.cost, clearance: self.clearance.min(other.clearance) }
    }

    fn is_no_worse_than(&self, other: &Self) -> bool {
        self.clearance >= other.clearance && self.cost <= other.cost * (1.0 + 1e-9)
    }
}

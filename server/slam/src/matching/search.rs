//! Correlative search: the pose in a window at which the hits are likeliest.
//!
//! Source: Olson, "Real-time correlative scan matching", 2009, section III (two levels). The coarse level
//! bounds the fine one from above, so that the result is that of trying every pose of the window.

use super::field::{BLOCK, Field};
use nalgebra::{Isometry2, Matrix3, Point2, Vector2, Vector3};

/// Half widths of the window around the prediction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    pub(crate) translation: f64,
    pub(crate) rotation: f64,
}

/// How much a full match of one hit counts against the prediction's squared deviation. On the log with a short range
/// halved 24.2 mm, doubled 24.1, of 26.2 (see [`crate::odometry::lidar2d`]).
const HIT_WORTH: f64 = 0.4;

/// The best pose, and its mean likelihood, 0 to 1. `prior` is the information of (x, y, yaw) in odom.
pub(crate) fn search(
    field: &Field,
    points: &[Point2<f64>],
    center: &Isometry2<f64>,
    prior: &Matrix3<f64>,
    window: &Window,
) -> (Isometry2<f64>, f64) {
    let resolution = field.resolution();
    let reach = points.iter().map(|p| p.coords.norm()).fold(1.0, f64::max).min(20.0);
    let angle_step = (resolution / reach).max(0.004);
    let num_angles = (window.rotation / angle_step).ceil() as i32;
    let blocks = (window.translation / (resolution * f64::from(BLOCK))).ceil().max(1.0) as i32;
    let worth = HIT_WORTH / 255.0;
    let mut candidates = vec![];
    let mut rotated: Vec<Vec<(i32, i32)>> = vec![];
    for a in -num_angles..=num_angles {
        let angle = f64::from(a) * angle_step;
        let turn = Isometry2::new(center.translation.vector, center.rotation.angle() + angle);
        let cells: Vec<(i32, i32)> = points.iter().map(|p| field.cell(&(turn * p))).collect();
        for by in -blocks..blocks {
            for bx in -blocks..blocks {
                let (dx, dy) = (bx * BLOCK, by * BLOCK);
                let sum: u32 = cells.iter().map(|&(x, y)| field.bound(x + dx, y + dy)).sum();
                let penalty = least_penalty(prior, dx, dy, resolution, angle);
                candidates.push((f64::from(sum) * worth - penalty, a, dx, dy));
            }
        }
        rotated.push(cells);
    }
    // Best bound first; ties by position, so that the order is fixed.
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2, a.3).cmp(&(b.1, b.2, b.3))));
    let mut best = (f64::NEG_INFINITY, *center, 0.0);
    for (bound, a, dx, dy) in candidates {
        if bound <= best.0 {
            break;
        }
        let cells = &rotated[(a + num_angles) as usize];
        let angle = f64::from(a) * angle_step;
        for y in dy..dy + BLOCK {
            for x in dx..dx + BLOCK {
                let sum: u32 = cells.iter().map(|&(px, py)| field.fine(px + x, py + y)).sum();
                let d = Vector3::new(f64::from(x) * resolution, f64::from(y) * resolution, angle);
                let value = f64::from(sum) * worth - 0.5 * d.dot(&(prior * d));
                if value > best.0 {
                    let moved = center.translation.vector + Vector2::new(d.x, d.y);
                    let share = f64::from(sum) / (255.0 * points.len().max(1) as f64);
                    best = (value, Isometry2::new(moved, center.rotation.angle() + angle), share);
                }
            }
        }
    }
    (best.1, best.2)
}

/// A lower bound of the prior's penalty over a block: nothing for the shift, the turn alone.
fn least_penalty(prior: &Matrix3<f64>, dx: i32, dy: i32, resolution: f64, angle: f64) -> f64 {
    let near = |d: i32| {
        let (low, high) = (f64::from(d) * resolution, f64::from(d + BLOCK - 1) * resolution);
        if low > 0.0 { low } else { high.min(0.0) }
    };
    // Without cross terms the penalty is least at the block's nearest corner; with them the diagonal alone
    // is no bound, so shrink it by what they can take back.
    let d = Vector3::new(near(dx), near(dy), angle);
    let cross = (prior[(0, 1)].abs() + prior[(0, 2)].abs() + prior[(1, 2)].abs()) > 1e-9;
    if cross { 0.0 } else { 0.5 * d.dot(&(prior * d)) }
}

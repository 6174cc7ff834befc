//! A planar scan made ready: points in base's plane with the normals of the surfaces they lie on.

use crate::deskew::Sweep;
use crate::matching::field::Hit;
use crate::scan::PlanarScan;
use nalgebra::{Point2, Point3, Vector2, Vector6};
use percept_geometry::Pose;
use percept_geometry::cloud::Beam;

/// A normal is fitted to neighbours up to so far to each side, metres: the noise of ranges is a centimetre. Halved 89
/// and 55.6, doubled 58 and 104.1, with 0.81 instead of 0.91 of the frames placed at once ([`crate::loops::planar`]).
const SIDE_M: f64 = 0.15;
/// But to at least and at most so many of them to each side. Three tell a line from noise; 24 are 12 degrees of beams
/// half a degree apart.
const SIDE: (usize, usize) = (3, 24);
/// Hits farther apart than [`SIDE_M`] are of one wall if one step along it is so many times the other at most, and the
/// sine of the turn between the steps is no more than this. Halved 15.1 and 26.1, doubled 15.1 and 36.2 ([`super`]).
const SPARSE: (f64, f64) = (3.0, 0.15);

/// Hits within `max_range`, in beam order, later echoes behind them, with the sweep's motion undone.
pub(crate) fn hits(scan: &PlanarScan, max_range: f64, velocity: &Vector6<f64>) -> Vec<Hit> {
    let sweep = Sweep::new(scan, velocity);
    let mut points: Vec<Point2<f64>> = vec![];
    for (i, beam) in scan.scan.echoes() {
        if let Beam::Hit(r) = beam
            && f64::from(r) <= max_range
        {
            points.push(sweep.end(i, f64::from(r)).xy());
        }
    }
    with_normals(points, &scan.t_base_sensor, scan.scan.angle_increment_rad.abs())
}

/// Hits of a keyframe again: points in base, in beam order.
pub(crate) fn from_points(points: &[Point3<f32>], t_base_sensor: &Pose) -> Vec<Hit> {
    let points: Vec<Point2<f64>> = points.iter().map(|p| p.cast::<f64>().xy()).collect();
    // The beams' spacing is not kept; a degree is the widest usual one.
    with_normals(points, t_base_sensor, 1f64.to_radians())
}

fn with_normals(points: Vec<Point2<f64>>, t_base_sensor: &Pose, spacing: f64) -> Vec<Hit> {
    let origin = Point2::new(t_base_sensor.translation.x, t_base_sensor.translation.y);
    let hit =
        |i: usize| Hit { p: points[i], n: normal(&points, i, &origin, spacing), is_sparse: is_sparse(&points, i) };
    (0..points.len()).map(hit).collect()
}

/// Normal of the line through a point and its neighbours on the same surface, towards the sensor.
fn normal(points: &[Point2<f64>], i: usize, origin: &Point2<f64>, spacing: f64) -> Vector2<f64> {
    let p = points[i];
    // Beams on a wall seen at 75 degrees lie four times their spacing apart.
    let gap = 0.1 + 4.0 * spacing * (p - origin).norm();
    let same = |a: usize, b: usize| (points[a] - points[b]).norm() < gap;
    let wanted = |j: usize| {
        let count = i.abs_diff(j);
        count <= SIDE.0 || (count <= SIDE.1 && (points[j] - p).norm() < SIDE_M)
    };
    let (mut first, mut last) = (i, i);
    while first > 0 && wanted(first - 1) && same(first - 1, first) {
        first -= 1;
    }
    while last + 1 < points.len() && wanted(last + 1) && same(last, last + 1) {
        last += 1;
    }
    let num = (last - first + 1) as f64;
    if num < 4.0 {
        return Vector2::zeros();
    }
    let mean = points[first..=last].iter().map(|q| q.coords).sum::<Vector2<f64>>() / num;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for q in &points[first..=last] {
        let d = q.coords - mean;
        xx += d.x * d.x;
        xy += d.x * d.y;
        yy += d.y * d.y;
    }
    let (half, root) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    if half - root > 0.05 * (half + root) {
        return Vector2::zeros();
    }
    let along = 0.5 * (2.0 * xy).atan2(xx - yy);
    let n = Vector2::new(-along.sin(), along.cos());
    if n.dot(&(origin - p)) < 0.0 { -n } else { n }
}

/// Whether the hits before and after one lie in line with it, each far from the next, as on a wall seen along it. What
/// stands alone, such as a leg, does not; of the first and the last hit that is not known, and they count as sparse.
fn is_sparse(points: &[Point2<f64>], i: usize) -> bool {
    if i == 0 || i + 1 >= points.len() {
        return true;
    }
    let (a, b) = (points[i] - points[i - 1], points[i + 1] - points[i]);
    let (short, long) = (a.norm().min(b.norm()), a.norm().max(b.norm()));
    short > SIDE_M && long < SPARSE.0 * short && a.dot(&b) > 0.0 && a.perp(&b).abs() < SPARSE.1 * short * long
}

/// Every hit that is at least `spacing` from the last one kept, then at most `count` of them, evenly.
pub(crate) fn thin(hits: &[Hit], spacing: f64, count: usize) -> Vec<Point2<f64>> {
    let mut kept: Vec<Point2<f64>> = vec![];
    for h in hits {
        if kept.last().is_none_or(|last| (h.p - last).norm() >= spacing) {
            kept.push(h.p);
        }
    }
    let step = kept.len().div_ceil(count.max(1)).max(1);
    kept.into_iter().step_by(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::LaserScan;
    use std::sync::Arc;

    #[test]
    fn a_wall_seen_along_it_is_sparse_and_a_leg_before_a_wall_is_not() {
        let along: Vec<_> =
            (0..6).map(|k| Point2::new(3.0 * 1.15f64.powi(k), 1.0 + 0.005 * f64::from(k % 2))).collect();
        assert_eq!([1, 2, 3, 4].map(|i| is_sparse(&along, i)), [true; 4]);
        let leg = [(4.0, -0.5), (4.0, -0.2), (2.0, 0.0), (2.0, 0.05), (4.0, 0.2), (4.0, 0.5)];
        let leg: Vec<_> = leg.iter().map(|&(x, y)| Point2::new(x, y)).collect();
        assert!(!is_sparse(&leg, 2) && !is_sparse(&leg, 3));
    }

    #[test]
    fn a_wall_ahead_has_its_normal_towards_the_sensor() {
        let ranges_m = (0..61).map(|i| (2.0 / (f64::from(i - 30) * 0.02).cos()) as f32).collect();
        let scan = LaserScan {
            angle_min_rad: -0.6,
            angle_increment_rad: 0.02,
            range_min_m: 0.0,
            range_max_m: 10.0,
            time_increment_s: 0.0,
            ranges_m,
            intensities: None,
            later_echoes_m: vec![],
        };
        let scan = PlanarScan { scan: Arc::new(scan), t_base_sensor: Pose::identity() };
        let hits = hits(&scan, 10.0, &Vector6::zeros());
        assert_eq!(hits.len(), 61);
        for h in &hits {
            assert!((h.p.x - 2.0).abs() < 1e-6 && (h.n + Vector2::x()).norm() < 1e-3);
        }
        assert!(thin(&hits, 0.0, 20).len() <= 20 && thin(&hits, 0.5, 100).len() <= 7);
    }
}

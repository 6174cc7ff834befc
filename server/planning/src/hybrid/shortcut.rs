//! Shorter ways between poses of a path.

use super::{Arcs, DrivingCost};
use crate::Pose2;
use crate::fit::{Fit, Motion};
use crate::steering::{Arc, Curve, each_curve};

/// A shortcut has to save this share of what it replaces: less is not worth a new curve.
const LEAST_GAIN: f64 = 1e-3;

/// Curves tried for one shortcut, cheapest first.
const TRIED_CURVES: usize = 3;

/// Replaces parts of a path by single curves where those cost less and fit: first long parts, then ones half as long, and
/// so on, each overlapping half of the next. Keeps the ends, and never costs more.
///
/// Source: Reeds-Shepp shortcuts as in Dolgov et al. 2010, section 4, in place of their gradient descent; a fixed order of
/// trials makes it deterministic.
pub(crate) fn shortcut(cost: &DrivingCost<'_>, fit: &Fit<'_>, path: Arcs) -> Arcs {
    let spacing = 0.25 * cost.params.turning_radius_m;
    let mut path = split(&path, spacing);
    let mut window = path.len();
    while window >= 2 {
        let mut begin = 0;
        while begin + 2 <= path.len() {
            let end = (begin + window).min(path.len());
            if let Some(shorter) = best_curve(cost, fit, &path, begin, end) {
                let pieces = split(&shorter, spacing);
                path.splice(begin..end, pieces);
            }
            begin += (window / 2).max(1);
        }
        window /= 2;
    }
    joined(path)
}

/// The cheapest curve that fits from where arc `begin` starts to where the arc before `end` stops, if it is cheaper.
fn best_curve(cost: &DrivingCost<'_>, fit: &Fit<'_>, path: &[(Pose2, Arc)], begin: usize, end: usize) -> Option<Arcs> {
    let (from, (last, arc)) = (path[begin].0, path[end - 1]);
    let to = arc.after(&last, arc.length);
    let before = begin.checked_sub(1).map(|i| path[i].1);
    let after = path.get(end).map(|(_, arc)| *arc);
    let whole = |arcs: &[(Pose2, Arc)]| {
        let change = after.map_or(0.0, |after| cost.of_change(arcs.last().map(|(_, arc)| *arc).or(before), &after));
        cost.of_arcs(arcs, before) + change
    };
    let limit = whole(&path[begin..end]) * (1.0 - LEAST_GAIN);
    let mut found: Vec<(f64, Curve)> = Vec::new();
    each_curve(&from, &to, cost.params.turning_radius_m, cost.params.allow_reverse, |curve| {
        // A metre costs 1 at least.
        if curve.length_m() < limit {
            let arcs: Arcs = curve.arcs(&from).collect();
            let least: f64 = arcs.iter().map(|(_, arc)| cost.steering(arc) * arc.length.abs()).sum();
            found.push((least, curve));
        }
    });
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut best: Option<(f64, Arcs)> = None;
    for (least, curve) in found.into_iter().take(TRIED_CURVES) {
        let limit = best.as_ref().map_or(limit, |(cost, _)| *cost);
        if least >= limit {
            break;
        }
        let arcs: Arcs = curve.arcs(&from).collect();
        let price = whole(&arcs);
        if price < limit && arcs.iter().all(|(from, arc)| fit.is_drivable(from, &Motion::Arc(*arc))) {
            best = Some((price, arcs));
        }
    }
    best.map(|(_, arcs)| arcs)
}

/// The same way in arcs of at most this length, metres.
pub(super) fn split(path: &[(Pose2, Arc)], spacing: f64) -> Arcs {
    let mut out = Vec::new();
    for (from, arc) in path {
        let pieces = (arc.length.abs() / spacing).ceil().max(1.0);
        let length = arc.length / pieces;
        out.extend((0..pieces as usize).map(|i| (arc.after(from, length * i as f64), Arc { length, ..*arc })));
    }
    out
}

/// The same way with arcs that go on alike made one.
fn joined(path: Arcs) -> Arcs {
    let mut out: Arcs = Vec::new();
    for (from, arc) in path {
        match out.last_mut() {
            Some((_, last)) if last.curvature == arc.curvature && last.length * arc.length > 0.0 => {
                last.length += arc.length;
            }
            _ => out.push((from, arc)),
        }
    }
    out
}

//! What finding a robot without a guess takes, the same for lidars in the plane and in space: the query that is laid over a
//! map from above, how many views speak for a place, and what a single one has to bring.

use nalgebra::Point2;
use percept_geometry::Pose;
use std::f64::consts::TAU;

/// Views from the way that a place is checked with, besides the one that is searched for. In the plane halved and
/// doubled as it is ([`super::planar`]).
pub(super) const WITNESSES: usize = 5;
/// Points of a query, at most. In the plane halved and doubled as it is ([`super::planar`]).
pub(super) const QUERY_POINTS: usize = 150;
/// Least share of a query's points that lies on the map, without a guess. In the plane times 0.7 104 and 35.2, times
/// 1.4 106 and 35.1 ([`super::planar`]).
pub(super) const MIN_SCORE: f64 = 0.6;
/// Cell of a search from above, metres. Twice that of a planar visit's map: what is found is measured there.
pub(super) const CELL_M: f64 = 0.1;
/// Directions that a view is told by: ten degrees each.
const DIRECTIONS: usize = 36;

/// What a scan has to bring where it is measured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strictness {
    /// Least share of its points on the map.
    pub(super) min_inlier_ratio: f64,
    /// Most that may contradict, as a share of what both saw.
    pub(super) max_contradicted: f64,
}

impl Strictness {
    /// It may be anywhere, and no other view says so: a room that was never seen resembles those that were. With 0.7 and
    /// 0.1, one of nine simulated robots that saw a second room first was said to be in the first.
    pub(super) const ALONE: Self = Self { min_inlier_ratio: 0.9, max_contradicted: 0.02 };
}

/// Directions in which something was seen.
#[derive(Default)]
pub(super) struct Around(u64);

impl Around {
    /// Something is seen in this direction, radians.
    pub(super) fn add(&mut self, angle: f64) {
        let sector = (angle.rem_euclid(TAU) / TAU * DIRECTIONS as f64) as usize;
        self.0 |= 1 << sector.min(DIRECTIONS - 1);
    }

    /// Whether that is so much of a full turn, a share.
    pub(super) fn covers(&self, share: f64) -> bool {
        f64::from(self.0.count_ones()) >= share * DIRECTIONS as f64
    }
}

/// At most [`QUERY_POINTS`] points, one a cell, evenly taken.
pub(super) fn spread_out(points: impl Iterator<Item = Point2<f64>>) -> Vec<Point2<f64>> {
    let mut taken = rustc_hash::FxHashSet::default();
    let cell = |p: &Point2<f64>| ((p.x / CELL_M).floor() as i64, (p.y / CELL_M).floor() as i64);
    let kept: Vec<Point2<f64>> = points.filter(|p| taken.insert(cell(p))).collect();
    let few = QUERY_POINTS.min(kept.len());
    let step = kept.len() as f64 / few.max(1) as f64;
    (0..few).map(|i| kept[(i as f64 * step) as usize]).collect()
}

/// The way since the robot was lost until now, metres: `before` has base then seen from base now, oldest first.
pub(super) fn way_m<S>(before: &[(Pose, S)]) -> f64 {
    let here = Pose::identity();
    let stations: Vec<&Pose> = before.iter().map(|(t, _)| t).chain([&here]).collect();
    stations.windows(2).map(|s| (s[0].translation.vector - s[1].translation.vector).norm()).sum()
}

//! A scan measured against the local map of a visit, and whether what both saw agrees.

use super::spatial;
use crate::covariance::diagonal;
use crate::loops::lost::Strictness;
use crate::matching::field::{Field, Hit};
use crate::matching::search::{Window, search};
use crate::matching::sight::{Sight, View, contradicted};
use crate::odometry::Prediction;
use crate::odometry::lidar2d::planar;
use crate::odometry::lidar2d::refine::refine;
use crate::odometry::lidar2d::sweep;
use nalgebra::{Isometry2, Matrix3, Point2};
use percept_geometry::{Covariance6, KeyframeScan, Pose};
use std::sync::Arc;

/// Cell of a local map, metres. As `lidar2d.resolution_m` has it for the odometry's map.
const CELL_M: f64 = 0.05;
/// A local map's least half width, metres: a visit's length and the windows that it is searched in. Two of the metres
/// that a large search's query is made of (`QUERY_M`).
const HALF_M: f64 = 10.0;
/// What a measurement may be off beyond its noise: the local map's own errors, metres and radians. Halved 26.2 mm,
/// doubled 26.3, of 26.2 on the log with a short range (see [`crate::odometry::lidar2d`]).
const FLOOR: (f64, f64) = (0.01, 0.003);
/// A match may leave so much open before it counts as open, metres and radians. Halved 26.1 mm, of 26.2 on the log with
/// a short range (see [`crate::odometry::lidar2d`]).
const MAX_SIGMA: (f64, f64) = (0.1, 0.05);
/// Points for the search. As the odometry's search has it: see its constant of this name.
const SEARCH_POINTS: usize = 180;

/// The robot is believed to be here. Both numbers halved and doubled as it is ([`super`]).
pub(super) const NEAR: Strictness = Strictness { min_inlier_ratio: 0.45, max_contradicted: 0.2 };
/// It is believed to be somewhere around. Both numbers halved 104 and 35.2; doubled (never) no loop is closed and the
/// robot, once lost, is not found ([`super`]).
pub(super) const FAR: Strictness = Strictness { min_inlier_ratio: 0.6, max_contradicted: 0.12 };
/// It may be anywhere. Both numbers halved as it is; doubled (never) the robot, once lost, is not found ([`super`]).
pub(super) const LOST: Strictness = Strictness { min_inlier_ratio: 0.7, max_contradicted: 0.1 };

/// A scan placed in a visit.
#[derive(Debug, Clone)]
pub(crate) struct Measurement {
    pub(crate) t_from_to: Pose,
    pub(crate) covariance: Covariance6,
    pub(crate) inlier_ratio: f64,
}

/// Why a scan was not placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Refused {
    TooFewHits,
    NotRefined(crate::LostReason),
    Contradicted(f64),
    Open(f64, f64),
    AtBorder,
}

/// Keyframes with their poses in the base of the one that they are gathered around.
pub(crate) type Visit = [(Isometry2<f64>, Arc<KeyframeScan>)];

/// Places scans in visits; keeps the memory of the local map.
pub(crate) struct Visits {
    /// Farther hits are not used, metres.
    max_range_m: f64,
    /// None before the first.
    field: Option<Field>,
}

impl Visits {
    pub(crate) fn new(max_range_m: f64) -> Self {
        Self { max_range_m, field: None }
    }

    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.field.as_ref().map_or(0, Field::memory_bytes)
    }

    /// Places `scan` within `window` (metres, radians) of the guess.
    pub(crate) fn measure(
        &mut self,
        visit: &Visit,
        scan: &KeyframeScan,
        guess: &Isometry2<f64>,
        window: (f64, f64),
        strictness: &Strictness,
    ) -> Result<Measurement, Refused> {
        let scan_hits = hits(scan, self.max_range_m);
        if scan_hits.len() < 20 || visit.is_empty() {
            return Err(Refused::TooFewHits);
        }
        let half = self.max_range_m.max(HALF_M);
        let field = self.field.get_or_insert_with(|| Field::new(CELL_M, half, Point2::origin()));
        field.reset(Point2::from(guess.translation.vector));
        let seen: Vec<Vec<Hit>> = visit.iter().map(|(_, s)| hits(s, self.max_range_m)).collect();
        visit.iter().zip(&seen).for_each(|((t, _), hits)| field.add(hits, t));
        let start = start(field, &scan_hits, guess, window);
        let off = guess.inverse() * start;
        if off.translation.vector.amax() > 0.95 * window.0 || off.rotation.angle().abs() > 0.95 * window.1 {
            return Err(Refused::AtBorder);
        }
        // Hardly a prior: the measurement shall not know what was believed.
        let prediction = Prediction::within(spatial(&start), diagonal(1.0, 0.5));
        let found =
            refine(field, &scan_hits, &start, &prediction, strictness.min_inlier_ratio).map_err(Refused::NotRefined)?;
        let views = views(visit, &seen);
        let contradicted = contradicted(field, &views, (&sight(scan), &scan_hits), &planar(&found.t_odom_base));
        if contradicted > strictness.max_contradicted {
            return Err(Refused::Contradicted(contradicted));
        }
        let covariance = found.covariance + diagonal(FLOOR.0, FLOOR.1);
        let (sigma_t, sigma_r) = (covariance[(0, 0)].max(covariance[(1, 1)]).sqrt(), covariance[(5, 5)].sqrt());
        if sigma_t > MAX_SIGMA.0 || sigma_r > MAX_SIGMA.1 {
            return Err(Refused::Open(sigma_t, sigma_r));
        }
        Ok(Measurement { t_from_to: found.t_odom_base, covariance, inlier_ratio: found.inlier_ratio })
    }

    /// Share of what both a visit and `scan` saw in which they contradict each other, if the scan was taken just there.
    pub(crate) fn contradicted(&mut self, visit: &Visit, scan: &KeyframeScan, t: &Isometry2<f64>) -> f64 {
        let half = self.max_range_m.max(HALF_M);
        let field = self.field.get_or_insert_with(|| Field::new(CELL_M, half, Point2::origin()));
        field.reset(Point2::from(t.translation.vector));
        let seen: Vec<Vec<Hit>> = visit.iter().map(|(_, s)| hits(s, self.max_range_m)).collect();
        visit.iter().zip(&seen).for_each(|((t, _), hits)| field.add(hits, t));
        contradicted(field, &views(visit, &seen), (&sight(scan), &hits(scan, self.max_range_m)), t)
    }
}

fn views<'a>(visit: &Visit, seen: &'a [Vec<Hit>]) -> Vec<View<'a>> {
    visit.iter().zip(seen).map(|((t, s), hits)| View { t_map_base: *t, hits, sight: sight(s) }).collect()
}

fn start(field: &Field, hits: &[Hit], guess: &Isometry2<f64>, window: (f64, f64)) -> Isometry2<f64> {
    let points = sweep::thin(hits, 0.5 * CELL_M, SEARCH_POINTS);
    let information = |half: f64| 9.0 / (half * half);
    let prior = Matrix3::from_diagonal(&[information(window.0), information(window.0), information(window.1)].into());
    let window = Window { translation: window.0, rotation: window.1 };
    search(field, &points, guess, &prior, &window).0
}

fn hits(scan: &KeyframeScan, max_range: f64) -> Vec<Hit> {
    let origin = scan.t_base_sensor.translation.vector.xy();
    let mut hits = sweep::from_points(&scan.hits.positions, &scan.t_base_sensor);
    hits.retain(|h| (h.p.coords - origin).norm() < max_range);
    hits
}

fn sight(scan: &KeyframeScan) -> Sight {
    let ends = scan.hits.positions.iter().chain(&scan.misses).map(|p| p.cast::<f64>().xy());
    Sight::new(ends, &planar(&scan.t_base_sensor))
}

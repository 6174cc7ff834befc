//! A robot that may be anywhere: what it has seen since it was lost is searched for in all of the map.
//!
//! Rooms resemble each other, and one view of them all the more. So the query is a local map of some metres; every place
//! in which it fits nearly as well as in the best one is looked at; what was seen on the way has to agree with each place,
//! view by view, and only if it does in the best one and in no other is that claimed.

use super::measure::{Measurement, Refused, Strictness, Visits};
use super::pyramid::Pyramid;
use super::{CELL_M, Kept, MIN_SCORE_LOST, NEAR_M, QUERY_M, ends, length, optima, spread_out, visit};
use crate::loops::{KeyframePoses, Relocalisation};
use crate::odometry::lidar2d::planar;
use nalgebra::Isometry2;
use percept_geometry::{KeyframeId, KeyframeScan};
use std::collections::BTreeMap;

/// Places that may fit nearly alike: where there are more, nothing tells them apart.
const MAX_PLACES: usize = 4;
/// Views from the way that a place is checked with, besides the newest one.
const WITNESSES: usize = 5;
/// Where a view is expected by odometry, it is measured to be: metres and radians.
const WINDOW: (f64, f64) = (0.3, 0.06);

/// What a lost robot has seen: views from the way, oldest first, with base then seen from base now.
pub(super) struct Lost<'a> {
    pub(super) before: Vec<(Isometry2<f64>, &'a KeyframeScan)>,
    pub(super) scan: &'a KeyframeScan,
}

impl Lost<'_> {
    /// The way since the robot was lost, metres.
    pub(super) fn way_m(&self) -> f64 {
        let here = Isometry2::identity();
        let stations: Vec<&Isometry2<f64>> = self.before.iter().map(|(t, _)| t).chain([&here]).collect();
        stations.windows(2).map(|s| (s[0].translation.vector - s[1].translation.vector).norm()).sum()
    }

    /// The only place among the keyframes where all of it fits.
    pub(super) fn find(&self, kept: &BTreeMap<KeyframeId, Kept>, poses: &KeyframePoses) -> Option<Relocalisation> {
        let known: BTreeMap<KeyframeId, Isometry2<f64>> =
            poses.iter().filter(|(id, _)| kept.contains_key(id)).map(|(id, t)| (*id, planar(t))).collect();
        let points: Vec<_> = known.iter().flat_map(|(id, t)| ends(&kept[id].scan).map(move |p| t * p)).collect();
        let near = self.before.iter().rev().filter(|(t, _)| t.translation.vector.norm() < QUERY_M);
        let on_the_way = near.flat_map(|(t, s)| ends(s).map(move |p| t * p));
        let query = spread_out(ends(self.scan).chain(on_the_way).collect());
        let pyramid = Pyramid::new(CELL_M, &points)?;
        let places = optima(&pyramid, &query, &pyramid.everywhere(), MIN_SCORE_LOST, MAX_PLACES)?;
        let mut map = KnownMap { kept, known, visits: Visits::new() };
        let mut verified = places.iter().map(|fit| self.verify(&fit.t, &mut map));
        let best = verified.next().flatten()?;
        verified.all(|other| other.is_none()).then_some(best)
    }

    /// What the newest view measures at a place, if what was seen on the way agrees.
    fn verify(&self, t_map_base: &Isometry2<f64>, map: &mut KnownMap<'_>) -> Option<Relocalisation> {
        let (keyframe, found) = map.measure(self.scan, t_map_base, &Strictness::LOST)?;
        let found = found.ok()?;
        let t_map_base = map.known[&keyframe] * planar(&found.t_from_to);
        let (mut agree, mut against) = (0, 0);
        for (t_now_then, scan) in self.before.iter().step_by(self.before.len().div_ceil(WITNESSES).max(1)) {
            match map.measure(scan, &(t_map_base * t_now_then), &Strictness::FAR) {
                Some((_, Ok(_))) => agree += 1,
                Some((_, Err(Refused::Contradicted(_)))) => return None,
                // A view that leaves something open says nothing.
                Some((_, Err(Refused::Open(..)))) | None => {}
                Some((_, Err(_))) => against += 1,
            }
        }
        (3 * against <= agree).then_some(Relocalisation {
            keyframe,
            t_keyframe_base: found.t_from_to,
            covariance: found.covariance,
            inlier_ratio: found.inlier_ratio,
        })
    }
}

/// Keyframes where they are believed to be.
struct KnownMap<'a> {
    kept: &'a BTreeMap<KeyframeId, Kept>,
    known: BTreeMap<KeyframeId, Isometry2<f64>>,
    visits: Visits,
}

impl KnownMap<'_> {
    /// A view measured from the nearest keyframe; none if there is none around.
    fn measure(
        &mut self,
        scan: &KeyframeScan,
        t_map_base: &Isometry2<f64>,
        strictness: &Strictness,
    ) -> Option<(KeyframeId, Result<Measurement, Refused>)> {
        let cost = |t: &Isometry2<f64>| length(&(t.inverse() * t_map_base));
        let nearest = self.known.iter().min_by(|a, b| cost(a.1).total_cmp(&cost(b.1)));
        let (&keyframe, t) = nearest.filter(|p| cost(p.1) < 2.0 * NEAR_M)?;
        let visit = visit(self.kept, keyframe, KeyframeId(u64::MAX), &self.known);
        let guess = t.inverse() * t_map_base;
        Some((keyframe, self.visits.measure(&visit, scan, &guess, WINDOW, strictness)))
    }
}

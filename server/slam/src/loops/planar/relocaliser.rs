//! A robot that may be anywhere: what it has seen since it was lost is searched for in all of the map.
//!
//! Rooms resemble each other, and one view of them all the more. So the query is a local map of some metres; every place
//! in which it fits nearly as well as in the best one is looked at; what was seen on the way has to agree with each place,
//! view by view, and only if it does in the best one and in no other is that claimed.
//!
//! That takes too long for one question: it is done in steps of counted work, one a question. The search is made for a view
//! from the way; where it finds that view, the robot is as far from there as odometry says, and the newest view has to agree.

use super::known_map::{KnownMap, MAX_PLACES, NODES_A_VIEW, POINTS_A_NODE};
use super::measure::{FAR, LOST, Refused, Visits};
use super::{Kept, QUERY_M, ends};
use crate::loops::lost::{Around, CELL_M, MIN_SCORE, Strictness, WITNESSES, spread_out, way_m};
use crate::loops::{KeyframePoses, Relocalisation};
use crate::matching::branch_and_bound::{Fit, Outcome, Pyramid, RIVAL, Search};
use crate::odometry::lidar2d::planar;
use nalgebra::Isometry2;
use percept_geometry::{KeyframeId, KeyframeScan, Pose, Timestamp};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A robot that has driven less since it was lost is found only by a view that is sure alone, metres. Halved as it is,
/// doubled 105 and 35.3, with 0.90 instead of 0.91 of the frames placed at once ([`super`]).
const SURE_AFTER_M: f64 = 1.5;
/// Only a view with returns from so much of a full turn can be sure alone. What sees half a turn cannot: with its lidar cut to 5 m,
/// Intel's robot came into an office that was not mapped, stood there as in another one, and was believed to be in that
/// (`planar_log lidar2d-intel --max-range 5 --no-odometry`: relations off by 5.5 m in the mean).
const ALL_AROUND: f64 = 0.6;
/// Work for one question, in nodes of the search: a node is a microsecond or two, so this is some 40 ms.
const WORK: usize = 24_000;
/// Questions after which a search is given up, and begun anew with what has been seen by then; of them so many at least
/// beyond those that the coarsest nodes take, which there are more of in a larger map. Both halved and doubled as it is
/// ([`super`]).
const MOST_STEPS: usize = 16;
const STEPS_BEYOND: usize = 8;

/// A view from the way, and where its base is seen from the base of the view that is searched for.
type Seen = (Isometry2<f64>, Arc<KeyframeScan>);

/// Finds a robot that is lost.
pub(super) struct Relocaliser {
    max_range_m: f64,
    visits: Visits,
    /// The map as it was drawn for keyframes at these poses, by their hash.
    drawn: Option<(u64, Pyramid)>,
    attempt: Option<Attempt>,
}

/// A search that goes on from question to question, in the map as it was when it began: where that has been moved since, views
/// do not fit where they are expected.
struct Attempt {
    /// When the view was taken that is searched for.
    stamp: Timestamp,
    /// What was seen on the way, oldest first, that view included.
    seen: Vec<Seen>,
    /// What the view has to bring.
    strictness: Strictness,
    steps: usize,
    stage: Stage,
}

enum Stage {
    Searching(Search),
    Verifying(Verifying),
}

/// Places that are looked at, best first.
struct Verifying {
    places: Vec<Fit>,
    /// The place that is looked at, and where it was measured to be.
    place: usize,
    measured: Option<Isometry2<f64>>,
    /// Views that were measured there, and what they said.
    views: usize,
    agree: usize,
    against: usize,
    /// Where the best place was verified.
    best: Option<Isometry2<f64>>,
}

impl Relocaliser {
    pub(super) fn new(max_range_m: f64) -> Self {
        Self { max_range_m, visits: Visits::new(max_range_m), drawn: None, attempt: None }
    }

    /// Bytes, about: the map as it is drawn, and the memory of measuring.
    pub(super) fn memory_bytes(&self) -> usize {
        self.visits.memory_bytes() + self.drawn.as_ref().map_or(0, |(_, pyramid)| pyramid.memory_bytes())
    }

    /// Whether a search has begun and not ended.
    pub(super) fn is_unfinished(&self) -> bool {
        self.attempt.is_some()
    }

    /// Where a single view fits, and nowhere else. Takes as long as it takes.
    pub(super) fn find_view(
        mut self,
        scan: &KeyframeScan,
        kept: &BTreeMap<KeyframeId, Kept>,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        if !sees_all_around(scan, self.max_range_m) {
            return None;
        }
        self.draw(&KnownMap::of(kept, poses))?;
        self.begin(scan.stamp, vec![(Isometry2::identity(), Arc::new(scan.clone()))], Strictness::ALONE);
        loop {
            let found = self.find(&[], scan, kept, poses);
            if found.is_some() || !self.is_unfinished() {
                return found;
            }
        }
    }

    /// The only place among the keyframes where all fits that was seen since the robot was lost, `before` with base then seen
    /// from base now, oldest first, and now. None where that is not certain, or not known yet.
    pub(super) fn find(
        &mut self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        kept: &BTreeMap<KeyframeId, Kept>,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        let map = KnownMap::of(kept, poses);
        let anchor = |stamp: Timestamp| match before.iter().rev().find(|(_, s)| s.stamp == stamp) {
            Some((t, _)) => Some(planar(t)),
            None => (scan.stamp == stamp).then(Isometry2::identity),
        };
        // Odometry that begins anew forgets what was before.
        self.attempt.take_if(|attempt| anchor(attempt.stamp).is_none());
        let mut work = WORK;
        if self.attempt.is_none() {
            // The newest view that is kept, so that it is known when the search ends: the first of all is kept itself.
            let newest = before.last().map_or((Isometry2::identity(), scan), |(t, s)| (planar(t), s));
            let is_far = way_m(before) >= SURE_AFTER_M;
            if !is_far && !sees_all_around(newest.1, self.max_range_m) {
                return None;
            }
            let t_newest_now = newest.0.inverse();
            let way = before.iter().map(|(t, s)| (t_newest_now * planar(t), Arc::clone(s)));
            let seen = way.chain([(t_newest_now, Arc::new(scan.clone()))]).collect();
            work = work.saturating_sub(self.draw(&map)? / POINTS_A_NODE);
            self.begin(newest.1.stamp, seen, if is_far { LOST } else { Strictness::ALONE });
        }
        let attempt = self.attempt.as_mut()?;
        let t_now_anchor = anchor(attempt.stamp)?;
        let (_, pyramid) = self.drawn.as_ref()?;
        let t_map_anchor = match attempt.go_on(pyramid, &map, &mut self.visits, work) {
            Progress::Unfinished => return None,
            Progress::Nowhere => {
                self.attempt = None;
                return None;
            }
            Progress::At(t) => t,
        };
        self.attempt = None;
        self.drawn = None;
        let t_map_base = t_map_anchor * t_now_anchor.inverse();
        let (keyframe, found) = map.measure(&mut self.visits, scan, &t_map_base, &LOST)?;
        let found = found.ok()?;
        Some(Relocalisation {
            keyframe,
            t_keyframe_base: found.t_from_to,
            covariance: found.covariance,
            inlier_ratio: found.inlier_ratio,
        })
    }

    /// Draws the map, if it is not drawn as it is; of how many points. None if there is nothing.
    fn draw(&mut self, map: &KnownMap<'_>) -> Option<usize> {
        let hash = map.hash();
        if self.drawn.as_ref().is_some_and(|(of, _)| *of == hash) {
            return Some(0);
        }
        let ends_of = |(id, t): (&KeyframeId, &Isometry2<f64>)| {
            let scan = map.kept[id].scan.get();
            scan.map_or(vec![], |scan| ends(&scan, self.max_range_m).map(|p| t * p).collect())
        };
        let points: Vec<_> = map.known.iter().flat_map(ends_of).collect();
        self.drawn = Pyramid::new(CELL_M, &points).map(|pyramid| (hash, pyramid));
        self.drawn.as_ref().map(|_| points.len())
    }

    /// Begins a search for the view of this stamp by what was seen around it.
    fn begin(&mut self, stamp: Timestamp, seen: Vec<Seen>, strictness: Strictness) {
        let Some((_, pyramid)) = &self.drawn else { return };
        let near = seen.iter().rev().filter(|(t, _)| t.translation.vector.norm() < QUERY_M);
        let query = spread_out(near.flat_map(|(t, s)| ends(s, self.max_range_m).map(move |p| t * p)));
        let search = pyramid.begin(&query, &pyramid.everywhere(), MIN_SCORE, (RIVAL, MAX_PLACES));
        self.attempt = Some(Attempt { stamp, seen, strictness, steps: 0, stage: Stage::Searching(search) });
    }
}

/// Whether a scan has returns from enough directions around the lidar.
fn sees_all_around(scan: &KeyframeScan, max_range_m: f64) -> bool {
    let origin = scan.t_base_sensor.translation.vector.xy();
    let mut seen = Around::default();
    ends(scan, max_range_m).map(|p| p.coords - origin).for_each(|d| seen.add(d.y.atan2(d.x)));
    seen.covers(ALL_AROUND)
}

/// What a search has come to.
enum Progress {
    Unfinished,
    /// There is no place that is certain.
    Nowhere,
    /// Base at the view that is searched for, in the map.
    At(Isometry2<f64>),
}

impl Attempt {
    /// Goes on for so much work.
    fn go_on(&mut self, pyramid: &Pyramid, map: &KnownMap<'_>, visits: &mut Visits, mut work: usize) -> Progress {
        self.steps += 1;
        if let Stage::Searching(search) = &mut self.stage {
            match pyramid.go_on(search, &mut work) {
                Some(Outcome::Found(places)) => self.stage = Stage::Verifying(Verifying::of(places)),
                Some(Outcome::Undecided) => return Progress::Nowhere,
                None if self.steps >= MOST_STEPS.max(search.num_roots() / WORK + STEPS_BEYOND) => {
                    return Progress::Nowhere;
                }
                None => {}
            }
        }
        if let Stage::Verifying(verifying) = &mut self.stage {
            for _ in 0..work.div_ceil(NODES_A_VIEW) {
                let progress = verifying.step(self.stamp, (&self.seen, &self.strictness), map, visits);
                if !matches!(progress, Progress::Unfinished) {
                    return progress;
                }
            }
        }
        Progress::Unfinished
    }
}

impl Verifying {
    fn of(places: Vec<Fit>) -> Self {
        Self { places, place: 0, measured: None, views: 0, agree: 0, against: 0, best: None }
    }

    /// Measures one view.
    fn step(
        &mut self,
        stamp: Timestamp,
        (seen, strictness): (&[Seen], &Strictness),
        map: &KnownMap<'_>,
        visits: &mut Visits,
    ) -> Progress {
        let Some(fit) = self.places.get(self.place) else {
            return self.best.map_or(Progress::Nowhere, Progress::At);
        };
        let Some(t_map_anchor) = self.measured else {
            let Some((_, scan)) = seen.iter().find(|(_, s)| s.stamp == stamp) else { return Progress::Nowhere };
            // Another place need not be as sure to leave it open which.
            let strictness = if self.place == 0 { strictness } else { &LOST };
            return match map.measure(visits, scan, &fit.t, strictness) {
                Some((keyframe, Ok(found))) => {
                    self.measured = Some(map.known[&keyframe] * planar(&found.t_from_to));
                    Progress::Unfinished
                }
                _ => self.decided(None),
            };
        };
        let witnesses = seen.iter().filter(|(_, s)| s.stamp != stamp);
        let every = (seen.len() - 1).div_ceil(WITNESSES).max(1);
        let Some((t, scan)) = witnesses.step_by(every).nth(self.views) else {
            let agrees = 3 * self.against <= self.agree;
            return self.decided(agrees.then_some(t_map_anchor));
        };
        self.views += 1;
        let t_map_then = t_map_anchor * t;
        match map.measure(visits, scan, &t_map_then, &FAR) {
            Some((_, Ok(_))) => self.agree += 1,
            Some((_, Err(Refused::Contradicted(_)))) => return self.decided(None),
            // A view that leaves something open says nothing, and neither does one that shows what nobody has seen.
            Some((_, Err(Refused::Open(..)))) | None => {}
            // Of another place that is enough for it not to be one.
            Some((_, Err(_))) if self.place > 0 || map.contradicts(visits, scan, &t_map_then) => self.against += 1,
            Some((_, Err(_))) => {}
        }
        Progress::Unfinished
    }

    /// Goes on to the next place. The best one has to be verified, and no other may be.
    fn decided(&mut self, measured: Option<Isometry2<f64>>) -> Progress {
        if measured.is_some() != (self.place == 0) {
            return Progress::Nowhere;
        }
        self.best = self.best.or(measured);
        self.place += 1;
        (self.measured, self.views, self.agree, self.against) = (None, 0, 0, 0);
        Progress::Unfinished
    }
}

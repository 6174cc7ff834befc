//! The newest keyframes together, searched for in a window that drift has made wide, or in all of the map.
//!
//! Every place where they fit nearly as well as in the best one is looked at by views from along the way. Only if they agree
//! there and at no other is it claimed, by a loop for each view that was measured.
//!
//! Where rooms resemble each other such a search takes half a second and more. It is done in steps of counted work, one a
//! keyframe, so that none waits for it: meanwhile the robot drives on.

use super::known_map::{KnownMap, MAX_PLACES, NODES_A_VIEW, POINTS_A_NODE};
use super::measure::{FAR, Refused, Visits};
use super::{Kept, MIN_SCORE, closure};
use crate::loops::LoopClosure;
use crate::loops::lost::{self, CELL_M};
use crate::matching::branch_and_bound::{Fit, Outcome, Pyramid, RIVAL, Region, Search};
use nalgebra::{Isometry2, Point2};
use percept_geometry::{KeyframeId, KeyframeScan};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Work for one keyframe, in nodes of the search: a node is a microsecond or two, so this is some 60 ms. Keyframes of a
/// robot that drives quickly are a third of a second apart. Halved 102 and 35.2, doubled 105 and 35.2 ([`super`]).
const WORK: usize = 40_000;
/// What fetching a scan whose points are drawn takes, in nodes. Halved and doubled as it is ([`super`]).
const NODES_A_SCAN: usize = 50;

/// How far is searched.
#[derive(Debug, Clone)]
pub(super) enum Extent {
    /// In the first of these windows in which something is found.
    Windows(Vec<Region>),
    Everywhere,
}

/// A keyframe of the way, and its base seen from that of the newest one.
pub(super) struct View {
    pub(super) id: KeyframeId,
    pub(super) t_anchor_base: Isometry2<f64>,
    pub(super) scan: Arc<KeyframeScan>,
}

/// A search that goes on from keyframe to keyframe, in the map as it was when it began.
pub(super) struct GlobalSearch {
    /// Newest first.
    views: Vec<View>,
    /// Points around the newest view, in its base.
    query: Vec<Point2<f64>>,
    /// Where keyframes lie among which is searched, base to map.
    known: BTreeMap<KeyframeId, Isometry2<f64>>,
    everywhere: bool,
    /// Windows that are left, in order.
    regions: VecDeque<Region>,
    stage: Stage,
}

enum Stage {
    /// Keyframes left to be drawn, and the points of the others, in the map.
    Drawing {
        left: VecDeque<KeyframeId>,
        points: Vec<Point2<f64>>,
    },
    Searching {
        pyramid: Pyramid,
        current: Option<(Search, usize)>,
    },
    Verifying(Verifying),
}

/// Places that are looked at, best first.
struct Verifying {
    places: VecDeque<Fit>,
    /// Views that were measured at the first of them, how many were against it, and what the others say.
    views: usize,
    against: usize,
    agree: Vec<LoopClosure>,
    /// What was measured at the best place; none before it was looked at.
    best: Option<Vec<LoopClosure>>,
}

/// What a search has come to.
pub(super) enum Progress {
    Unfinished,
    /// Loops at the only place that is certain; none if there is no such place.
    Ended(Vec<LoopClosure>),
}

impl GlobalSearch {
    /// A search for what `views` saw together, `query` seen from the newest one's base, among keyframes with base to map.
    pub(super) fn new(
        views: Vec<View>,
        query: Vec<Point2<f64>>,
        known: BTreeMap<KeyframeId, Isometry2<f64>>,
        extent: Extent,
    ) -> Self {
        let stage = Stage::Drawing { left: known.keys().copied().collect(), points: vec![] };
        let (everywhere, regions) = match extent {
            Extent::Windows(regions) => (false, regions.into()),
            Extent::Everywhere => (true, VecDeque::new()),
        };
        Self { views, query, known, everywhere, regions, stage }
    }

    /// Whether all of the map is searched.
    pub(super) fn is_everywhere(&self) -> bool {
        self.everywhere
    }

    /// Bytes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        let known = self.known.len() * size_of::<(KeyframeId, Isometry2<f64>)>();
        known
            + match &self.stage {
                Stage::Drawing { points, .. } => points.capacity() * size_of::<Point2<f64>>(),
                Stage::Searching { pyramid, current } => {
                    pyramid.memory_bytes() + current.as_ref().map_or(0, |(search, _)| search.memory_bytes())
                }
                Stage::Verifying(_) => 0,
            }
    }

    /// Goes on for one keyframe's work.
    pub(super) fn go_on(
        &mut self,
        kept: &BTreeMap<KeyframeId, Kept>,
        visits: &mut Visits,
        max_range_m: f64,
    ) -> Progress {
        let mut work = WORK;
        if let Stage::Drawing { left, points } = &mut self.stage {
            while let Some(id) = left.pop_front() {
                let (before, t) = (points.len(), self.known[&id]);
                points.extend(kept.get(&id).into_iter().flat_map(|k| k.ends(max_range_m)).map(|p| t * p));
                work = work.saturating_sub((points.len() - before) / POINTS_A_NODE + NODES_A_SCAN);
                if work == 0 {
                    return Progress::Unfinished;
                }
            }
            let Some(pyramid) = Pyramid::new(CELL_M, points) else { return Progress::Ended(vec![]) };
            self.regions.extend(self.everywhere.then(|| pyramid.everywhere()));
            self.stage = Stage::Searching { pyramid, current: None };
        }
        if let Stage::Searching { pyramid, current } = &mut self.stage {
            let min_score = if self.everywhere { lost::MIN_SCORE } else { MIN_SCORE };
            let places = loop {
                let (search, patience) = match current {
                    Some(current) => current,
                    None => {
                        let Some(region) = self.regions.pop_front() else { return Progress::Ended(vec![]) };
                        let search = pyramid.begin(&self.query, &region, min_score, (RIVAL, MAX_PLACES));
                        let patience = search.patience();
                        current.insert((search, patience))
                    }
                };
                let (allowed, is_last) = (work.min(*patience), *patience <= work);
                let mut left = allowed;
                let outcome = pyramid.go_on(search, &mut left);
                work -= allowed - left;
                *patience -= allowed - left;
                match outcome {
                    Some(Outcome::Found(places)) if !places.is_empty() => break places,
                    None if !is_last => return Progress::Unfinished,
                    Some(Outcome::Found(_) | Outcome::Undecided) | None => *current = None,
                }
            };
            self.stage = Stage::Verifying(Verifying::of(places));
        }
        let Stage::Verifying(verifying) = &mut self.stage else { return Progress::Unfinished };
        let map = KnownMap::as_then(kept, &self.known);
        for _ in 0..work.div_ceil(NODES_A_VIEW) {
            if let Some(loops) = verifying.step(&self.views, &map, visits) {
                return Progress::Ended(loops);
            }
        }
        Progress::Unfinished
    }
}

impl Verifying {
    fn of(places: Vec<Fit>) -> Self {
        Self { places: places.into(), views: 0, against: 0, agree: vec![], best: None }
    }

    /// Measures one view; the loops, once all is measured.
    fn step(&mut self, views: &[View], map: &KnownMap<'_>, visits: &mut Visits) -> Option<Vec<LoopClosure>> {
        let Some(fit) = self.places.front() else { return Some(self.best.take().unwrap_or_default()) };
        let Some(view) = views.get(self.views) else {
            let agrees = 3 * self.against <= self.agree.len();
            return self.decided(agrees);
        };
        self.views += 1;
        match map.measure(visits, &view.scan, &(fit.t * view.t_anchor_base), &FAR) {
            Some((candidate, Ok(found))) => self.agree.push(closure(candidate, view.id, &found)),
            Some((_, Err(Refused::Contradicted(_)))) => return self.decided(false),
            // A view that leaves something open says nothing.
            Some((_, Err(Refused::Open(..)))) | None => {}
            Some((_, Err(_))) => self.against += 1,
        }
        None
    }

    /// Goes on to the next place. Views have to agree at the best one, and may not at any other.
    fn decided(&mut self, agrees: bool) -> Option<Vec<LoopClosure>> {
        let loops = std::mem::take(&mut self.agree);
        let is_place = agrees && !loops.is_empty();
        match self.best {
            None if is_place => self.best = Some(loops),
            Some(_) if !is_place => {}
            _ => return Some(vec![]),
        }
        self.places.pop_front();
        (self.views, self.against) = (0, 0);
        None
    }
}

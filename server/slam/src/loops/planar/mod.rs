//! Places of planar lidars: keyframes tied to earlier ones of the same place, near and far, and scans found with no guess.
//!
//! A visit is a run of neighbouring keyframes; its points make a local map. While drift is small, a keyframe is measured
//! against the visits around it: a search of the cells in reach, then point-to-line refinement ([`measure`]). Once drift
//! is large, the newest keyframes together are searched for in all that was seen in reach ([`global_search`], by
//! [`crate::matching::branch_and_bound`]), and a pose counts only if no other one fits nearly as well; now and then all of the map is searched. A robot that is lost is found by all
//! that it has seen since ([`relocaliser`]). Every match has to explain what was seen, and nothing that one view shows may stand
//! where the other looked through ([`crate::matching::sight`]).
//!
//! Where a constant says "halved" and "doubled", these are the loops, and the mean error of checked relations, millimetres, of
//! `planar_log lidar2d-intel --no-odometry --first 3000 --max-range 6`, where a scan sees little: 104 and 35.2 with the
//! constants as they are when they were swept; the command gives 108 and 27.0 now. That mean hangs on a few relations:
//! where it is 27 the largest is off by 0.8 m instead of 1.8.
//! The log with wheels is the same without `--no-odometry`: 95 and 24.9.

mod global_search;
mod known_map;
mod links;
mod measure;
mod relocaliser;

#[cfg(test)]
mod tests;

use crate::loops::lost::{Strictness, spread_out};
use crate::loops::{Evidence, KeyframePoses, LoopClosure, PlaceRecognition, Relocalisation};
use crate::matching::branch_and_bound::Region;
use crate::odometry::lidar2d::planar;
use crate::odometry::{OdometryKind, OdometryNoise, way_m};
use global_search::{Extent, GlobalSearch, Progress, View};
use known_map::KnownMap;
use links::Links;
use measure::{Measurement, NEAR, Visits};
use nalgebra::{Isometry2, Point2};
use percept_geometry::{Covariance6, KeptScan, KeyframeId, KeyframeScan, Pose, se3};
use relocaliser::Relocaliser;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes of the last metres are what odometry was measured against. Halved 113 and 27.3, doubled 116 and 35.2
/// ([`self`]).
const RECENT_M: f64 = 10.0;
/// Keyframes farther than this from the believed place see other surfaces, metres. Halved 26.2 mm and 100 loops,
/// doubled 26.4 and 108, of 26.2 and 102 on the log with a short range (see [`crate::odometry::lidar2d`]).
const NEAR_M: f64 = 3.0;
/// Visits that one keyframe is measured against, at most. Halved and doubled as it is ([`self`]).
const MAX_VISITS: usize = 3;
/// Windows reach so many standard deviations of drift; a place that is not found where it should be widens them ([`DOUBT_M`]). With
/// six, a lidar that sees 5.5 or 6 m closes a tenth or two thirds of the loops (`planar_log lidar2d-intel --max-range`): in
/// a window that wide too much fits.
const SIGMAS: f64 = 3.0;
/// And so much farther, metres and radians: keyframes are not where their neighbours are. Halved 101 and 35.3, doubled
/// 107 and 35.1 ([`self`]).
const MARGIN: (f64, f64) = (0.2, 0.03);
/// A window this small is searched in one visit's map, metres. Halved 108 and 34.9, doubled 101 and 35.2 ([`self`]).
const SMALL_M: f64 = 1.2;
/// Windows are not larger than this, metres. A search of so much is what the nodes that a search may visit last for
/// (see `PATIENCE` in `branch_and_bound`).
const LARGEST_M: f64 = 15.0;
/// Driving past known places without a tie that doubles the uncertainty, metres: they are not where they are believed.
/// Halved and doubled as it is ([`self`]).
const DOUBT_M: f64 = 3.0;
/// A closed loop is as unsure as so much driving, metres. Halved and doubled as it is ([`self`]).
const TIE_M: f64 = 0.3;
/// Driving between searches of a large window, metres: at first, and at most, as it doubles with each that finds
/// nothing; and between those of all the map. The first two halved 115 and 35.1, doubled 101 and 27.3; the last halved
/// and doubled as it is ([`self`]).
const SEARCH_EVERY_M: (f64, f64) = (1.5, 6.0);
const SEARCH_ALL_EVERY_M: f64 = 10.0;
/// Keyframes of the last metres make the query of a large search. Halved 117 and 34.7, doubled 106 and 27.4 ([`self`]).
const QUERY_M: f64 = 5.0;
/// Keyframes of the query so far apart are measured where it was found: nearer ones see the same. Halved 112 and 35.3,
/// doubled 101 and 35.2 ([`self`]).
const VIEWS_EVERY_M: f64 = 1.5;
/// Least score of a large search. Times 0.7 as it is, times 1.4 102 and 27.3 ([`self`]).
const MIN_SCORE: f64 = 0.55;
/// A keyframe taken in.
struct Kept {
    scan: KeptScan,
    /// Driven until here, metres.
    travelled_m: f64,
}

impl Kept {
    /// Ends of its beams in its base, up to a range in metres.
    fn ends(&self, max_range_m: f64) -> Vec<Point2<f64>> {
        self.scan.get().map_or(vec![], |scan| ends(&scan, max_range_m).collect())
    }
}

/// Places seen by a planar lidar.
pub(crate) struct PlanarPlaces {
    /// Farther hits are not used, metres.
    max_range_m: f64,
    noise: OdometryNoise,
    kept: BTreeMap<KeyframeId, Kept>,
    links: Links,
    visits: Visits,
    /// The search for a robot that is lost, which goes on from question to question.
    relocaliser: Relocaliser,
    /// The search of a large window, which goes on from keyframe to keyframe.
    global_search: Option<GlobalSearch>,
    /// Where the robot had driven to at the last search of a large window, and of all the map.
    searched_m: f64,
    /// Driving from there to the next.
    search_every_m: f64,
    searched_all_m: f64,
    last_drift: (f64, f64),
    /// Driven past known places since the last tie, metres.
    missed_m: f64,
    travelled_m: f64,
}

impl PlanarPlaces {
    /// Nothing seen yet. Hits farther than `max_range_m` are not used.
    pub(crate) fn new(max_range_m: f64) -> Self {
        Self {
            max_range_m,
            noise: OdometryNoise::of(OdometryKind::Lidar2d),
            kept: BTreeMap::new(),
            links: Links::default(),
            visits: Visits::new(max_range_m),
            relocaliser: Relocaliser::new(max_range_m),
            global_search: None,
            searched_m: 0.0,
            search_every_m: SEARCH_EVERY_M.0,
            searched_all_m: 0.0,
            last_drift: (0.0, 0.0),
            missed_m: 0.0,
            travelled_m: 0.0,
        }
    }

    /// Takes the keyframe in; how far the robot has driven.
    fn keep(&mut self, id: KeyframeId, scan: &KeptScan, drift: &Covariance6, poses: &KeyframePoses) -> f64 {
        let spread = |c: &Covariance6| (c[(0, 0)].max(c[(1, 1)]).max(0.0).sqrt(), c[(5, 5)].max(0.0).sqrt());
        let drift = spread(drift);
        let mut travelled_m = 0.0;
        if let Some((&last, kept)) = self.kept.last_key_value() {
            let step = match (poses.get(&last), poses.get(&id)) {
                (Some(a), Some(b)) => length(&(planar(a).inverse() * planar(b))),
                _ => 0.0,
            };
            // A lost stretch adds more than its length.
            let sudden = (drift.0 - self.last_drift.0 - 0.05 * step - 0.05).max(0.0);
            self.links.tie(last, id, step + self.noise.position.way_of(sudden).min(1e4));
            travelled_m = kept.travelled_m + step;
        }
        self.last_drift = drift;
        self.kept.insert(id, Kept { scan: scan.clone(), travelled_m });
        travelled_m
    }

    /// Ties to the visits around the believed place, nearest first.
    fn local_search(&mut self, id: KeyframeId, here: &Isometry2<f64>, reach: &Reach) -> Vec<LoopClosure> {
        let mut candidates: Vec<(f64, KeyframeId)> = reach
            .old
            .iter()
            .filter(|o| o.window_m <= SMALL_M)
            .map(|o| (length(&(o.t_map_base.inverse() * here)), o.id))
            .filter(|c| c.0 < NEAR_M)
            .collect();
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut tried: Vec<f64> = vec![];
        let mut closures = vec![];
        for (_, candidate) in candidates {
            let at = self.kept[&candidate].travelled_m;
            if tried.iter().any(|t| (t - at).abs() < RECENT_M) {
                continue;
            }
            if tried.len() == MAX_VISITS {
                break;
            }
            tried.push(at);
            let window = reach.window(candidate);
            let found = self.measure(id, candidate, here, window, &NEAR, &reach.poses);
            closures.extend(found.map(|m| closure(candidate, id, &m)));
        }
        closures
    }

    fn measure(
        &mut self,
        id: KeyframeId,
        candidate: KeyframeId,
        t_map_base: &Isometry2<f64>,
        window: (f64, f64),
        strictness: &Strictness,
        poses: &BTreeMap<KeyframeId, Isometry2<f64>>,
    ) -> Option<Measurement> {
        let scan = self.kept.get(&id)?.scan.get()?;
        let visit = visit(&self.kept, candidate, id, poses);
        let t_map_candidate = poses.get(&candidate)?;
        let guess = t_map_candidate.inverse() * t_map_base;
        self.visits.measure(&visit, &scan, &guess, window, strictness).ok()
    }

    /// Begins the search of a large window where it is time for one, and goes on with it: the loops that it ends with.
    fn global_search(
        &mut self,
        id: KeyframeId,
        here: &Isometry2<f64>,
        reach: &Reach,
        travelled_m: f64,
    ) -> Vec<LoopClosure> {
        if self.global_search.is_none() && travelled_m - self.searched_m >= self.search_every_m && reach.is_far(here) {
            self.searched_m = travelled_m;
            // What was not found is hardly found a step farther; the views have to become others.
            self.search_every_m = (2.0 * self.search_every_m).min(SEARCH_EVERY_M.1);
            self.global_search = Some(self.begin_global_search(id, here, reach, false));
        }
        let Some(search) = &mut self.global_search else { return vec![] };
        let Progress::Ended(loops) = search.go_on(&self.kept, &mut self.visits, self.max_range_m) else {
            return vec![];
        };
        let is_next =
            loops.is_empty() && !search.is_everywhere() && travelled_m - self.searched_all_m >= SEARCH_ALL_EVERY_M;
        self.global_search = None;
        if is_next {
            self.searched_all_m = travelled_m;
            self.global_search = Some(self.begin_global_search(id, here, reach, true));
        }
        loops.into_iter().filter(|l| self.kept.contains_key(&l.to)).collect()
    }

    /// A search for the newest keyframes together in what was seen within the window, or everywhere.
    fn begin_global_search(
        &self,
        id: KeyframeId,
        here: &Isometry2<f64>,
        reach: &Reach,
        everywhere: bool,
    ) -> GlobalSearch {
        let (translation, rotation) = reach.largest(here, true);
        let is_there =
            |o: &&Old| (o.t_map_base.translation.vector - here.translation.vector).norm() < translation + 5.0;
        let known = reach.old.iter().filter(|o| everywhere || is_there(o)).map(|o| (o.id, o.t_map_base)).collect();
        let extent = match everywhere {
            true => Extent::Everywhere,
            false => {
                // As far as drift leads first: in a window that doubt has widened, too much may fit for a search to decide.
                let mut windows = vec![reach.largest(here, false), (translation, rotation)];
                windows.dedup();
                let region = |(translation, rotation)| Region { center: *here, translation, rotation };
                Extent::Windows(windows.into_iter().map(region).collect())
            }
        };
        GlobalSearch::new(self.views(id, here, reach), self.query(id, reach), known, extent)
    }

    /// Keyframes of the query that loops are measured by, newest first.
    fn views(&self, id: KeyframeId, here: &Isometry2<f64>, reach: &Reach) -> Vec<View> {
        let travelled_m = self.kept[&id].travelled_m;
        let mut views: Vec<View> = vec![];
        let mut next_m = 0.0;
        for (id, kept) in self.kept.range(..=id).rev() {
            let back_m = travelled_m - kept.travelled_m;
            if back_m >= QUERY_M {
                break;
            }
            if back_m < next_m {
                continue;
            }
            if let (Some(t), Some(scan)) = (reach.poses.get(id), kept.scan.get()) {
                views.push(View { id: *id, t_anchor_base: here.inverse() * t, scan });
                next_m = back_m + VIEWS_EVERY_M;
            }
        }
        views
    }

    /// Points of the newest keyframes in the newest one's base.
    fn query(&self, id: KeyframeId, reach: &Reach) -> Vec<Point2<f64>> {
        let travelled_m = self.kept[&id].travelled_m;
        let Some(here) = reach.poses.get(&id) else { return vec![] };
        let recent = self.kept.iter().rev().take_while(|(_, k)| travelled_m - k.travelled_m < QUERY_M);
        let points = recent.filter_map(|(id, k)| Some((reach.poses.get(id)?, k))).flat_map(|(t, k)| {
            let t_here_then = here.inverse() * t;
            k.ends(self.max_range_m).into_iter().map(move |p| t_here_then * p)
        });
        spread_out(points)
    }
}

impl PlaceRecognition for PlanarPlaces {
    fn insert(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
    ) -> Vec<LoopClosure> {
        let travelled_m = self.keep(id, scan, drift, poses);
        let Some(here) = poses.get(&id).map(planar) else { return vec![] };
        let doubt = 1.0 + self.missed_m / DOUBT_M;
        let reach = Reach::of(id, &self.kept, &self.links, (&self.noise, doubt), poses);
        let mut closures = self.local_search(id, &here, &reach);
        let step = travelled_m - self.travelled_m;
        self.travelled_m = travelled_m;
        if reach.is_known(&here) {
            self.missed_m += step;
        }
        if closures.is_empty() {
            closures.extend(self.global_search(id, &here, &reach, travelled_m));
        } else {
            self.global_search = None;
        }
        for c in &closures {
            self.links.tie(c.from, c.to, TIE_M);
        }
        if !closures.is_empty() {
            self.searched_all_m = travelled_m;
            self.search_every_m = SEARCH_EVERY_M.0;
            self.missed_m = 0.0;
        }
        closures
    }

    fn restore(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
        ties: &[KeyframeId],
    ) {
        self.travelled_m = self.keep(id, scan, drift, poses);
        ties.iter().for_each(|&from| self.links.tie(from, id, TIE_M));
    }

    fn relocalise(&self, scan: &KeyframeScan, poses: &KeyframePoses) -> Option<Relocalisation> {
        Relocaliser::new(self.max_range_m).find_view(scan, &self.kept, poses)
    }

    fn relocalise_driven(
        &mut self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        self.relocaliser.find(before, scan, &self.kept, poses)
    }

    fn is_unfinished(&self) -> bool {
        self.relocaliser.is_unfinished()
    }

    fn check(&mut self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence {
        KnownMap::of(&self.kept, poses).check(&mut self.visits, scan, &planar(t_map_base))
    }

    fn relocalises_in_steps(&self) -> bool {
        true
    }

    fn forget(&mut self, id: KeyframeId) {
        self.kept.remove(&id);
        self.links.remove(id);
    }

    fn memory_bytes(&self) -> usize {
        let kept = self.kept.len() * size_of::<(KeyframeId, Kept)>();
        let searches =
            self.relocaliser.memory_bytes() + self.global_search.as_ref().map_or(0, GlobalSearch::memory_bytes);
        kept + self.links.memory_bytes() + self.visits.memory_bytes() + searches
    }
}

/// An older keyframe, where it is believed to be and how well that is known from the newest one.
struct Old {
    id: KeyframeId,
    t_map_base: Isometry2<f64>,
    window_m: f64,
    window_rad: f64,
    /// The same as drift alone has it, without doubt.
    drift_m: f64,
    drift_rad: f64,
}

/// What there is to be found again from a keyframe.
struct Reach {
    old: Vec<Old>,
    poses: BTreeMap<KeyframeId, Isometry2<f64>>,
}

impl Reach {
    fn of(
        id: KeyframeId,
        kept: &BTreeMap<KeyframeId, Kept>,
        links: &Links,
        (noise, doubt): (&OdometryNoise, f64),
        poses: &KeyframePoses,
    ) -> Self {
        let poses: BTreeMap<KeyframeId, Isometry2<f64>> =
            poses.iter().filter(|(id, _)| kept.contains_key(id)).map(|(id, t)| (*id, planar(t))).collect();
        let distances = links.distances(id);
        let travelled_m = kept[&id].travelled_m;
        let old = poses
            .iter()
            .filter(|(other, _)| **other != id && travelled_m - kept[other].travelled_m > RECENT_M)
            .map(|(other, t)| {
                let d = distances.get(other).copied().unwrap_or(1e4);
                let (sigma_m, sigma_rad) = noise.after(d);
                let window_m = |doubt: f64| (MARGIN.0 + SIGMAS * doubt * sigma_m).min(LARGEST_M);
                let window_rad = |doubt: f64| (MARGIN.1 + SIGMAS * doubt * sigma_rad).min(std::f64::consts::PI);
                Old {
                    id: *other,
                    t_map_base: *t,
                    window_m: window_m(doubt),
                    window_rad: window_rad(doubt),
                    drift_m: window_m(1.0),
                    drift_rad: window_rad(1.0),
                }
            })
            .collect();
        Self { old, poses }
    }

    fn window(&self, id: KeyframeId) -> (f64, f64) {
        self.old.iter().find(|o| o.id == id).map_or((SMALL_M, 0.1), |o| (o.window_m, o.window_rad))
    }

    /// Older keyframes that may be around.
    fn around<'a>(&'a self, here: &'a Isometry2<f64>) -> impl Iterator<Item = &'a Old> {
        let distance = |o: &Old| (o.t_map_base.translation.vector - here.translation.vector).norm();
        self.old.iter().filter(move |o| distance(o) < o.window_m + NEAR_M)
    }

    /// The widest of their windows, metres and radians.
    fn largest(&self, here: &Isometry2<f64>, with_doubt: bool) -> (f64, f64) {
        let window = |o: &Old| if with_doubt { (o.window_m, o.window_rad) } else { (o.drift_m, o.drift_rad) };
        self.around(here).map(window).fold((0.0, 0.0), |(m, rad), (o_m, o_rad)| (o_m.max(m), o_rad.max(rad)))
    }

    /// Whether one of them is not surely where it is believed to be.
    fn is_far(&self, here: &Isometry2<f64>) -> bool {
        self.around(here).any(|o| o.window_m > SMALL_M)
    }

    /// Whether the robot is believed to pass through a known place.
    fn is_known(&self, here: &Isometry2<f64>) -> bool {
        self.old.iter().any(|o| length(&(o.t_map_base.inverse() * here)) < NEAR_M)
    }
}

/// Keyframes around a candidate in time, with their poses in the candidate's base.
fn visit(
    kept: &BTreeMap<KeyframeId, Kept>,
    candidate: KeyframeId,
    newest: KeyframeId,
    poses: &BTreeMap<KeyframeId, Isometry2<f64>>,
) -> Vec<(Isometry2<f64>, Arc<KeyframeScan>)> {
    const HALF_M: f64 = 4.0;
    let (Some(t_map_candidate), Some(at)) = (poses.get(&candidate), kept.get(&candidate)) else { return vec![] };
    let end = kept.get(&newest).map_or(f64::INFINITY, |k| k.travelled_m - 0.5 * RECENT_M);
    let belongs = |k: &Kept| (k.travelled_m - at.travelled_m).abs() < HALF_M && k.travelled_m < end;
    let before = kept.range(..candidate).rev().take_while(|(_, k)| belongs(k));
    let after = kept.range(candidate..).take_while(|(_, k)| belongs(k));
    before
        .chain(after)
        .filter_map(|(id, k)| Some((t_map_candidate.inverse() * poses.get(id)?, k.scan.get()?)))
        .collect()
}

/// Ends of a keyframe's beams in base, up to a range in metres.
fn ends(scan: &KeyframeScan, max_range: f64) -> impl Iterator<Item = Point2<f64>> + '_ {
    let origin = scan.t_base_sensor.translation.vector.xy();
    scan.hits.positions.iter().map(|p| p.cast::<f64>().xy()).filter(move |p| (p.coords - origin).norm() < max_range)
}

/// Metres, with a radian for half a metre.
fn length(t: &Isometry2<f64>) -> f64 {
    way_m(t.translation.vector.norm(), t.rotation.angle())
}

fn closure(from: KeyframeId, to: KeyframeId, m: &Measurement) -> LoopClosure {
    LoopClosure { from, to, t_from_to: m.t_from_to, covariance: m.covariance, inlier_ratio: m.inlier_ratio }
}

/// A planar pose in space.
fn spatial(t: &Isometry2<f64>) -> Pose {
    se3::from_xy_yaw(t.translation.x, t.translation.y, t.rotation.angle())
}

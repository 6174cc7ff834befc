//! Places of a camera, found again by what they look like and verified by their shape.
//!
//! Candidates by binary features, ORB's or SIFT's ([`index`], [`alike`]), the motion by their points ([`rigid`]), then
//! the whole surface ([`crate::odometry::rgbd::place`]): enough of it fits and none of it contradicts. Without colour
//! there are no features: see [`super::depth`]. A camera without depth has the points of its features alone: so many more of
//! these have to agree. A robot that may be anywhere is placed by several views ([`relocalise`]).
//!
//! Where a constant says "halved" and "doubled", these are the views that are found in a map of every eighth one, of 35, and
//! the loops, of `evaluate looks-places rgbd-7scenes-a`: 34 and 26 with the constants as they are, one of the loops off by
//! more than 0.1 m or 0.05 rad.

mod alike;
mod index;
mod relocalise;
mod rigid;

use super::{Evidence, KeyframePoses, LoopClosure, PlaceRecognition, Relocalisation};
use crate::keyframe::FULL_WIDTH;
use crate::odometry::rgbd::place::{Placed, place};
use alike::Alike;
use index::Index;
use percept_geometry::{Covariance6, FeatureMethod, KeptScan, KeyframeFeature, KeyframeId, KeyframeScan, Pose};
use percept_perception::features2d::{Descriptors, MatchParams, match_features};
use rigid::{Pair, most_agree};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Odometry ties a keyframe to so many before it better than a loop could. Halved 44 loops, one wrong, doubled 24
/// ([`self`]).
const RECENT: u64 = 8;
/// Keyframes that are looked at closely for each new one: bounds the time. Halved 19 loops, doubled 27 ([`self`]).
const MAX_CANDIDATES: usize = 3;
/// Features of a keyframe that are indexed. Half of what a keyframe keeps.
const MAX_INDEXED: usize = 250;
const _: () = assert!(MAX_INDEXED <= index::MOST_FEATURES);
/// Fewest features alike of a candidate. Halved and doubled as it is ([`self`]).
const MIN_VOTES: u32 = 12;
/// Fewest pairs of features that agree on a motion, in images that are [`FULL_WIDTH`] wide and more; see [`min_pairs`].
/// Halved 35 views and 40 loops, 3 wrong, doubled 32 and 7 ([`self`]).
const MIN_PAIRS: usize = 12;
/// The same, and their share of all that were paired, where there is no surface to verify by: loops and ATE of
/// `percept eval slam --sensor camera --rooms 1 --minutes 1 --once`, 47 and 45 mm, none false. The first halved 57 and 45, doubled 21 and
/// 39, none false; the second halved as it is, times 1.5 32 and 43.
const SPARSE_PAIRS: usize = 30;
const SPARSE_SHARE: f64 = 0.4;
/// Least share of the scan's points on surfaces of the place, and most share that contradicts. The first halved as it
/// is, doubled 25 views and no loop; the second halved and doubled as it is; the third halved 25 loops, doubled as it
/// is ([`self`]).
const MIN_INLIERS: f64 = 0.3;
const MAX_SEEN_THROUGH: f64 = 0.1;
const MAX_IN_FRONT: f64 = 0.25;

/// A keyframe that can be recognised.
struct Known {
    scan: KeptScan,
    method: FeatureMethod,
    indexed: Vec<[u64; 4]>,
}

/// A scan placed by a keyframe, by features and surfaces.
struct Verified {
    placed: Placed,
    features: Agreement,
}

impl Verified {
    fn relocalisation(&self, keyframe: KeyframeId) -> Relocalisation {
        Relocalisation {
            keyframe,
            t_keyframe_base: self.placed.t_place_base,
            covariance: self.placed.covariance,
            inlier_ratio: self.placed.inlier_ratio,
        }
    }
}

/// Place recognition by features and depth.
pub(crate) struct VisualPlaces {
    /// At most so many keyframes are known.
    max_keyframes: usize,
    known: BTreeMap<KeyframeId, Known>,
    index: Index,
    /// Whether scans hold the features' points alone, no surfaces.
    is_sparse: bool,
}

impl PlaceRecognition for VisualPlaces {
    fn insert(
        &mut self,
        id: KeyframeId,
        kept: &KeptScan,
        _drift: &Covariance6,
        poses: &KeyframePoses,
    ) -> Vec<LoopClosure> {
        let Some(scan) = kept.get() else { return vec![] };
        let newest_old = id.0.saturating_sub(RECENT);
        let loops = self
            .candidates(&scan, MAX_CANDIDATES, |k| k.0 < newest_old)
            .into_iter()
            .filter_map(|from| {
                let Verified { placed, .. } = self.verify(from, &scan, poses)?;
                Some(LoopClosure {
                    from,
                    to: id,
                    t_from_to: placed.t_place_base,
                    covariance: placed.covariance,
                    inlier_ratio: placed.inlier_ratio,
                })
            })
            .collect();
        self.remember(id, kept);
        loops
    }

    fn restore(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        _drift: &Covariance6,
        _poses: &KeyframePoses,
        _ties: &[KeyframeId],
    ) {
        self.remember(id, scan);
    }

    fn relocalise(&self, scan: &KeyframeScan, poses: &KeyframePoses) -> Option<Relocalisation> {
        self.candidates(scan, MAX_CANDIDATES, |k| poses.contains_key(&k))
            .into_iter()
            .filter_map(|keyframe| Some(self.verify(keyframe, scan, poses)?.relocalisation(keyframe)))
            .max_by(|a, b| a.inlier_ratio.total_cmp(&b.inlier_ratio))
    }

    fn relocalise_driven(
        &mut self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        // Without surfaces nothing but features could agree, and those are asked for more.
        if self.is_sparse { self.relocalise(scan, poses) } else { self.find_driven(before, scan, poses) }
    }

    fn check(&mut self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence {
        if self.is_sparse { Evidence::Nothing } else { self.check_surfaces(scan, t_map_base, poses) }
    }

    fn forget(&mut self, id: KeyframeId) {
        if let Some(known) = self.known.remove(&id) {
            self.index.remove(id, &known.indexed);
        }
    }

    fn memory_bytes(&self) -> usize {
        let indexed: usize = self.known.values().map(|k| k.indexed.capacity()).sum();
        let known = self.known.len() * size_of::<(KeyframeId, Known)>() + indexed * size_of::<[u64; 4]>();
        known + self.index.memory_bytes()
    }
}

impl VisualPlaces {
    /// Nothing seen yet. At most so many keyframes are known.
    pub(crate) fn new(max_keyframes: usize) -> Self {
        Self { max_keyframes, known: BTreeMap::new(), index: Index::default(), is_sparse: false }
    }

    /// For a camera without depth, whose scans hold the points of its own map.
    pub(crate) fn of_sparse_points(max_keyframes: usize) -> Self {
        Self { is_sparse: true, ..Self::new(max_keyframes) }
    }

    fn remember(&mut self, id: KeyframeId, kept: &KeptScan) {
        let Some(scan) = kept.get() else { return };
        let (Some(method), indexed) = (method(&scan), descriptors(&scan, MAX_INDEXED)) else { return };
        if indexed.is_empty() {
            return;
        }
        self.forget(id);
        self.index.insert(id, &indexed);
        self.known.insert(id, Known { scan: kept.clone(), method, indexed });
        // Of very many, every second of the older half goes: places stay covered, more thinly.
        if self.known.len() > self.max_keyframes {
            let old: Vec<KeyframeId> = self.known.keys().copied().take(self.max_keyframes / 2).step_by(2).collect();
            old.into_iter().for_each(|k| self.forget(k));
        }
    }

    /// At most so many keyframes that look most alike, not next to each other; best first.
    fn candidates(&self, scan: &KeyframeScan, most: usize, allowed: impl Fn(KeyframeId) -> bool) -> Vec<KeyframeId> {
        let Some(method) = method(scan) else { return vec![] };
        let same = |id: KeyframeId| self.known.get(&id).filter(|k| k.method == method);
        let entry = |id: KeyframeId, i: usize| same(id)?.indexed.get(i);
        let votes = self.index.votes(&descriptors(scan, MAX_INDEXED), Alike::of(method).vote, entry);
        let mut ranked: Vec<(u32, KeyframeId)> =
            votes.into_iter().filter(|v| v.1 >= MIN_VOTES && allowed(v.0)).map(|(id, n)| (n, id)).collect();
        ranked.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut out: Vec<KeyframeId> = vec![];
        for (_, id) in ranked {
            if out.len() < most && out.iter().all(|o| o.0.abs_diff(id.0) > 1) {
                out.push(id);
            }
        }
        out
    }

    /// Where base of the scan is, seen from base at keyframe `from`; none unless features and surfaces agree.
    fn verify(&self, from: KeyframeId, scan: &KeyframeScan, poses: &KeyframePoses) -> Option<Verified> {
        let known = self.known.get(&from)?.scan.get()?;
        let features = by_features(&known, scan)?;
        let Agreement { t_from_to, covariance, pairs, share, .. } = features;
        if self.is_sparse {
            let placed =
                Placed { t_place_base: t_from_to, covariance, inlier_ratio: share, seen_through: 0.0, in_front: 0.0 };
            return (pairs >= SPARSE_PAIRS && share >= SPARSE_SHARE).then_some(Verified { placed, features });
        }
        // Its neighbours on the way have seen more of the place, if odometry ties them to it.
        let neighbours = [from.0.wrapping_sub(1), from.0.wrapping_add(1)].map(KeyframeId);
        let around = neighbours.iter().filter_map(|k| {
            let t_from_other = poses.get(&from)?.inverse() * poses.get(k)?;
            let near = t_from_other.translation.vector.norm() < 1.0 && t_from_other.rotation.angle() < 1.0;
            if near { Some((t_from_other, self.known.get(k)?.scan.get()?)) } else { None }
        });
        let others: Vec<(Pose, Arc<KeyframeScan>)> =
            std::iter::once((Pose::identity(), Arc::clone(&known))).chain(around).collect();
        let others: Vec<(Pose, &KeyframeScan)> = others.iter().map(|(t, s)| (*t, s.as_ref())).collect();
        let placed = place(&others, scan, &t_from_to, &covariance).filter(|p| {
            p.inlier_ratio >= MIN_INLIERS && p.seen_through <= MAX_SEEN_THROUGH && p.in_front <= MAX_IN_FRONT
        })?;
        Some(Verified { placed, features })
    }
}

/// What features of two views agree on.
struct Agreement {
    t_from_to: Pose,
    /// Right perturbation in `to`'s base.
    covariance: Covariance6,
    /// Features that agree, and their share of those that were paired.
    pairs: usize,
    share: f64,
    /// Directions, ten degrees wide and high, in which the later view has some of them.
    directions: usize,
}

/// Width and height of a direction. Ten degrees.
const DIRECTION_RAD: f64 = 0.17;

/// The motion that features agree on.
fn by_features(from: &KeyframeScan, to: &KeyframeScan) -> Option<Agreement> {
    let (a, b) = (from.features.as_ref()?, to.features.as_ref()?);
    if a.method != b.method {
        return None;
    }
    let set = |f: &[KeyframeFeature]| Descriptors::Binary(f.iter().map(|f| f.descriptor).collect());
    let params = MatchParams { ratio: 0.85, mutual: true, max_distance: Some(f64::from(Alike::of(a.method).pair)) };
    let matches = match_features(&set(&b.features), &set(&a.features), &params).ok()?;
    let pairs: Vec<Pair> = matches
        .iter()
        .filter_map(|m| {
            let (f, t) = (a.features.get(m.train_index as usize)?, b.features.get(m.query_index as usize)?);
            let range = (f.p_base.cast::<f64>() - from.t_base_sensor.translation.vector)
                .coords
                .norm()
                .max((t.p_base.cast::<f64>() - to.t_base_sensor.translation.vector).coords.norm());
            // Depth of both, and a few pixels across: see `odometry::rgbd::noise`.
            let tolerance = 0.02 + 0.01 * range + 0.01 * range * range;
            (range <= 6.0).then(|| Pair { from: f.p_base.cast(), to: t.p_base.cast(), tolerance })
        })
        .collect();
    let (t_from_to, inliers) = most_agree(&pairs, min_pairs(a.camera.width.min(b.camera.width)))?;
    let t_sensor_base = to.t_base_sensor.inverse();
    let directions: BTreeSet<(i32, i32)> = inliers
        .iter()
        .map(|&i| {
            let p = t_sensor_base * pairs[i].to;
            let cell = |v: f64| (v.atan2(p.z) / DIRECTION_RAD).floor() as i32;
            (cell(p.x), cell(p.y))
        })
        .collect();
    Some(Agreement {
        t_from_to,
        covariance: uncertainty(&pairs, &inliers),
        pairs: inliers.len(),
        share: inliers.len() as f64 / pairs.len() as f64,
        directions: directions.len(),
    })
}

/// Fewest pairs that agree, by the narrower image. A feature looks at as many pixels in a small image as in a large one, so
/// those of a small one overlap more, and as many of them have seen less: twice as many are asked for where it is half as wide.
fn min_pairs(width: usize) -> usize {
    (MIN_PAIRS * FULL_WIDTH).div_ceil(width.max(1)).clamp(MIN_PAIRS, 2 * MIN_PAIRS)
}

/// Of points that err independently by half their tolerance; never surer than 1 cm and 10 mrad.
fn uncertainty(pairs: &[Pair], inliers: &[usize]) -> Covariance6 {
    let mut information = Covariance6::zeros();
    for p in inliers.iter().map(|&i| &pairs[i]) {
        let mut j = nalgebra::Matrix3x6::zeros();
        j.fixed_columns_mut::<3>(0).fill_with_identity();
        j.fixed_columns_mut::<3>(3).copy_from(&-p.to.coords.cross_matrix());
        information += j.transpose() * j * (4.0 / (p.tolerance * p.tolerance));
    }
    let floor = crate::covariance::diagonal(0.01, 0.01);
    information.try_inverse().unwrap_or_else(|| Covariance6::identity() * 0.01) + floor
}

fn method(scan: &KeyframeScan) -> Option<FeatureMethod> {
    scan.features.as_ref().map(|f| f.method)
}

/// At most `most`. ORB's are the most distinct of each size, so they are taken evenly over the list. SIFT's are the most
/// distinct first, whatever their size, and those of two views are the same ones the more distinct they are.
fn descriptors(scan: &KeyframeScan, most: usize) -> Vec<[u64; 4]> {
    let Some(features) = &scan.features else { return vec![] };
    let step = match features.method {
        FeatureMethod::Orb => features.features.len().div_ceil(most).max(1),
        FeatureMethod::Sift => 1,
    };
    features.features.iter().step_by(step).take(most).map(|f| f.descriptor).collect()
}

//! A robot that may be anywhere: one view proposes where it is, what it saw on the way has to agree.
//!
//! Rooms resemble each other, and one view of a corner with a picture on the wall all the more. So a place that a view was
//! found in counts only if the views from the way, put where odometry says that they were then, lie on the surfaces that
//! the map has there and look through none of them; and only if no other place does as well. One view alone counts where it
//! shows far more than a picture on a wall: see [`is_sure_alone`].
//!
//! Where a constant says "as it is", `evaluate rgbd-sizes 160x120 1` finds the same, none of it wrong: 42 of 45 lost robots that
//! drove before, 130 of 139 views alone, none of another world.

use super::{MAX_IN_FRONT, MAX_SEEN_THROUGH, MIN_INLIERS, Verified, VisualPlaces};
use crate::covariance::diagonal;
use crate::loops::{Evidence, KeyframePoses, Relocalisation};
use crate::odometry::rgbd::place::place;
use crate::odometry::rgbd::window::NEAR;
use crate::odometry::{OdometryKind, OdometryNoise, way_m};
use percept_geometry::{KeptScan, KeyframeId, KeyframeScan, Pose};
use std::sync::Arc;

/// Places that are looked at: where there are more, nothing tells them apart. Halved and doubled as it is
/// ([`self`]).
const MAX_PLACES: usize = 6;
/// Places nearer than this are one, and a view from the way so near to the newest one tells nothing of its own:
/// metres and radians. Halved and doubled as it is ([`self`]).
const SAME: (f64, f64) = (0.3, 0.2);
/// Views from the way that are looked at, and how many of them have to agree. The first halved and doubled as it is
/// ([`self`]), where all that is found is sure alone: the second is not asked there.
const WITNESSES: usize = 6;
const MIN_AGREE: usize = 2;
/// So many of the keyframes that show what a view may see. Halved and doubled as it is ([`self`]).
const MAX_NEAR: usize = 3;
/// What a view from the way may be off by, metres and radians. Halved and doubled as it is ([`self`]).
const WINDOW: (f64, f64) = (0.2, 0.1);

/// A view that is checked is expected where odometry has it after so many metres since the one before that agreed: keyframes are half a
/// metre apart, and some of them say nothing.
const CHECKED_AFTER_M: f64 = 2.0;

/// One view is enough if so many features agree on its place, in so many directions, as no single thing on a wall has, and
/// hardly any surface contradicts. Views of a real room from 0.3 m and 20 degrees aside have 26 to 55 such features in 9 to 12
/// directions; of another simulated house none has 12.
const ALONE_PAIRS: usize = 25;
const ALONE_DIRECTIONS: usize = 9;
const ALONE_CONTRADICTS: f64 = 0.06;

/// Whether a view needs no other to say where it was seen from.
fn is_sure_alone(view: &Verified) -> bool {
    let placed = &view.placed;
    view.features.pairs >= ALONE_PAIRS
        && view.features.directions >= ALONE_DIRECTIONS
        && placed.seen_through.max(placed.in_front) <= ALONE_CONTRADICTS
}

/// A place where a view was found.
struct Place {
    t_map_base: Pose,
    keyframe: KeyframeId,
    verified: Verified,
}

impl Place {
    fn relocalisation(&self) -> Relocalisation {
        self.verified.relocalisation(self.keyframe)
    }
}

/// What a view from the way says of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Word {
    Agrees,
    /// The map has seen that view, and it does not lie there.
    Against,
    /// It looks through what the map has there, or sees what the map looked through.
    Contradicts,
    /// The map has not seen it.
    Nothing,
}

/// Larger of both shares: below 1 is nearer than the limits.
fn share(t: &Pose, (m, rad): (f64, f64)) -> f64 {
    (t.translation.vector.norm() / m).max(t.rotation.angle() / rad)
}

impl VisualPlaces {
    /// The only place where the newest view was found and the views from the way agree; see
    /// [`crate::loops::PlaceRecognition::relocalise_driven`].
    pub(super) fn find_driven(
        &self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        let places = self.places(scan, poses);
        let witnesses: Vec<_> = before.iter().rev().filter(|(t, _)| share(t, SAME) >= 1.0).take(WITNESSES).collect();
        // Views from the way that agree, and that are against it; none if one contradicts.
        let words = |t_map_base: &Pose| {
            let (mut agree, mut against) = (0, 0);
            for (t_now_then, then) in &witnesses {
                match self.ask(then, (t_map_base, t_now_then), poses) {
                    Word::Agrees => agree += 1,
                    Word::Against => against += 1,
                    Word::Contradicts => return None,
                    Word::Nothing => {}
                }
            }
            Some((agree, against))
        };
        if let [only] = &places[..]
            && is_sure_alone(&only.verified)
        {
            return words(&only.t_map_base).filter(|(_, against)| *against == 0).map(|_| only.relocalisation());
        }
        let agrees = |p: &&Place| {
            words(&p.t_map_base).is_some_and(|(agree, against)| agree >= MIN_AGREE && 3 * against <= agree)
        };
        let mut found = places.iter().filter(agrees);
        let first = found.next()?;
        found.next().is_none().then(|| first.relocalisation())
    }

    /// Every place where a view is found, best first, with base to map.
    fn places(&self, scan: &KeyframeScan, poses: &KeyframePoses) -> Vec<Place> {
        let candidates = self.candidates(scan, MAX_PLACES, |k| poses.contains_key(&k));
        let mut found: Vec<Place> = candidates
            .into_iter()
            .filter_map(|keyframe| {
                let verified = self.verify(keyframe, scan, poses)?;
                let t_map_base = poses.get(&keyframe)? * verified.placed.t_place_base;
                Some(Place { t_map_base, keyframe, verified })
            })
            .collect();
        found.sort_by(|a, b| b.verified.placed.inlier_ratio.total_cmp(&a.verified.placed.inlier_ratio));
        let mut out: Vec<Place> = vec![];
        for place in found {
            if out.iter().all(|o| share(&o.t_map_base.inv_mul(&place.t_map_base), SAME) >= 1.0) {
                out.push(place);
            }
        }
        out
    }

    /// What a view says that was taken at `t_now_then`, if base is at `t_map_base`.
    fn ask(&self, then: &KeyframeScan, (t_map_base, t_now_then): (&Pose, &Pose), poses: &KeyframePoses) -> Word {
        let way_m = way_m(t_now_then.translation.vector.norm(), t_now_then.rotation.angle());
        self.place_near(then, &(t_map_base * t_now_then), way_m, poses).0
    }

    /// What a view says of where it is believed to have been taken ([`crate::loops::PlaceRecognition::check`]).
    pub(super) fn check_surfaces(&self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence {
        match self.place_near(scan, t_map_base, CHECKED_AFTER_M, poses) {
            (Word::Agrees, Some(found)) => Evidence::Agrees(found),
            (Word::Contradicts, _) => Evidence::Contradicts,
            // Few surfaces of two views with a narrow field lie over each other.
            (Word::Agrees | Word::Against | Word::Nothing, _) => Evidence::Nothing,
        }
    }

    /// What a view says that is expected at a place after so many metres of odometry; and where it is, if it agrees.
    fn place_near(
        &self,
        scan: &KeyframeScan,
        t_map_base: &Pose,
        way_m: f64,
        poses: &KeyframePoses,
    ) -> (Word, Option<Relocalisation>) {
        let around = self.around(t_map_base, poses);
        let others: Vec<(Pose, &KeyframeScan)> = around.iter().map(|(_, t, s)| (*t, s.as_ref())).collect();
        let Some((keyframe, t_base_keyframe, _)) = around.first() else { return (Word::Nothing, None) };
        let (sigma_m, sigma_rad) = OdometryNoise::of(OdometryKind::Rgbd).after(way_m);
        let uncertain = diagonal(sigma_m, sigma_rad);
        let Some(placed) = place(&others, scan, &Pose::identity(), &uncertain) else { return (Word::Against, None) };
        if placed.seen_through > MAX_SEEN_THROUGH || placed.in_front > MAX_IN_FRONT {
            return (Word::Contradicts, None);
        }
        let stays = share(&placed.t_place_base, WINDOW) < 1.0;
        if !stays || placed.inlier_ratio < MIN_INLIERS {
            return (Word::Against, None);
        }
        let found = Relocalisation {
            keyframe: *keyframe,
            t_keyframe_base: t_base_keyframe.inv_mul(&placed.t_place_base),
            covariance: placed.covariance,
            inlier_ratio: placed.inlier_ratio,
        };
        (Word::Agrees, Some(found))
    }

    /// Keyframes that look from near a place, with their base seen from there, nearest first.
    fn around(&self, t_map_base: &Pose, poses: &KeyframePoses) -> Vec<(KeyframeId, Pose, Arc<KeyframeScan>)> {
        let mut near: Vec<(f64, KeyframeId, Pose, &KeptScan)> = self
            .known
            .iter()
            .filter_map(|(id, known)| {
                let t_base_other = t_map_base.inv_mul(poses.get(id)?);
                let far = share(&t_base_other, NEAR);
                (far < 1.0).then_some((far, *id, t_base_other, &known.scan))
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter().take(MAX_NEAR).filter_map(|(_, id, t, scan)| Some((id, t, scan.get()?))).collect()
    }
}

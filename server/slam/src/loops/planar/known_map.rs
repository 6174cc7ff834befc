//! Keyframes where they are believed to be, and a view measured among them.

use super::measure::{FAR, Measurement, Refused, Visits};
use super::{Kept, NEAR_M, length, visit};
use crate::loops::lost::Strictness;
use crate::loops::{Evidence, KeyframePoses, Relocalisation};
use crate::odometry::lidar2d::planar;
use nalgebra::Isometry2;
use percept_geometry::{KeyframeId, KeyframeScan};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

/// What drawing a point of the map takes, and measuring a view, in nodes of a search. The first halved and doubled as
/// it is, the second 104 and 35.2, and 104 and 35.1 ([`super`]).
pub(super) const POINTS_A_NODE: usize = 16;
pub(super) const NODES_A_VIEW: usize = 4_000;
/// Places that may fit nearly alike: where there are more, nothing tells them apart. Halved and doubled as it is
/// ([`super`]).
pub(super) const MAX_PLACES: usize = 4;
/// Where a view is expected, it is measured to be: metres and radians. Halved and doubled as it is ([`super`]).
const WINDOW: (f64, f64) = (0.3, 0.06);

/// Keyframes where they are believed to be, base to map.
pub(super) struct KnownMap<'a> {
    pub(super) kept: &'a BTreeMap<KeyframeId, Kept>,
    pub(super) known: Cow<'a, BTreeMap<KeyframeId, Isometry2<f64>>>,
}

impl<'a> KnownMap<'a> {
    /// All that are kept.
    pub(super) fn of(kept: &'a BTreeMap<KeyframeId, Kept>, poses: &KeyframePoses) -> Self {
        let known = poses.iter().filter(|(id, _)| kept.contains_key(id)).map(|(id, t)| (*id, planar(t))).collect();
        Self { kept, known: Cow::Owned(known) }
    }

    /// Those of a time before: some may have gone since.
    pub(super) fn as_then(
        kept: &'a BTreeMap<KeyframeId, Kept>,
        known: &'a BTreeMap<KeyframeId, Isometry2<f64>>,
    ) -> Self {
        Self { kept, known: Cow::Borrowed(known) }
    }

    /// Differs where the keyframes or their poses differ.
    pub(super) fn hash(&self) -> u64 {
        let mut hasher = rustc_hash::FxHasher::default();
        for (id, t) in self.known.iter() {
            let v = [t.translation.x, t.translation.y, t.rotation.angle()];
            (id.0, v.map(f64::to_bits)).hash(&mut hasher);
        }
        hasher.finish()
    }

    /// A view measured from the nearest keyframe; none if there is none around.
    pub(super) fn measure(
        &self,
        visits: &mut Visits,
        scan: &KeyframeScan,
        t_map_base: &Isometry2<f64>,
        strictness: &Strictness,
    ) -> Option<(KeyframeId, Result<Measurement, Refused>)> {
        let (keyframe, guess) = self.nearest(t_map_base)?;
        let visit = visit(self.kept, keyframe, KeyframeId(u64::MAX), &self.known);
        Some((keyframe, visits.measure(&visit, scan, &guess, WINDOW, strictness)))
    }

    /// What a view says of the place where it is believed to have been taken.
    pub(super) fn check(&self, visits: &mut Visits, scan: &KeyframeScan, t_map_base: &Isometry2<f64>) -> Evidence {
        let Some((keyframe, measured)) = self.measure(visits, scan, t_map_base, &FAR) else { return Evidence::Nothing };
        match measured {
            Ok(m) => Evidence::Agrees(Relocalisation {
                keyframe,
                t_keyframe_base: m.t_from_to,
                covariance: m.covariance,
                inlier_ratio: m.inlier_ratio,
            }),
            Err(Refused::Contradicted(_)) => Evidence::Contradicts,
            Err(Refused::NotRefined(_) | Refused::AtBorder) if self.contradicts(visits, scan, t_map_base) => {
                Evidence::Contradicts
            }
            Err(_) => Evidence::Nothing,
        }
    }

    /// Whether a view that does not fit where it is believed to have been taken contradicts what is known there, rather than that
    /// most of it lies where nobody has been.
    pub(super) fn contradicts(&self, visits: &mut Visits, scan: &KeyframeScan, t_map_base: &Isometry2<f64>) -> bool {
        let Some((keyframe, guess)) = self.nearest(t_map_base) else { return false };
        let visit = visit(self.kept, keyframe, KeyframeId(u64::MAX), &self.known);
        visits.contradicted(&visit, scan, &guess) > FAR.max_contradicted
    }

    /// The nearest keyframe, if one is around, and the place seen from there.
    fn nearest(&self, t_map_base: &Isometry2<f64>) -> Option<(KeyframeId, Isometry2<f64>)> {
        let cost = |t: &Isometry2<f64>| length(&(t.inverse() * t_map_base));
        let there = self.known.iter().filter(|(id, _)| self.kept.contains_key(id));
        let nearest = there.min_by(|a, b| cost(a.1).total_cmp(&cost(b.1)));
        let (&keyframe, t) = nearest.filter(|p| cost(p.1) < 2.0 * NEAR_M)?;
        Some((keyframe, t.inverse() * t_map_base))
    }
}

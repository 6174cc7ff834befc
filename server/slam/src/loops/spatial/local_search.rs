//! Loops where the map is believed to be known: a keyframe measured in what an earlier visit to the place saw.

use super::submap::range;
use super::target::{Target, reach};
use super::{APART, SpatialRecognition};
use crate::loops::lost::Strictness;
use crate::loops::{KeyframePoses, LoopClosure};
use percept_geometry::{Covariance6, KeyframeId, Pose};
use std::collections::BTreeMap;

/// Earlier keyframes within so many lengths of a submap are the same place. Halved 27 and 105, doubled 26 and 105
/// ([`super`]).
const NEAR: f64 = 0.5;
/// The drift that such a measurement can bridge, standard deviations: beyond it another place may fit.
const BRIDGED: f64 = 2.0;
/// A visit that merging has left fewer keyframes of shows too little of its surroundings to measure in. Halved and
/// doubled as it is ([`super`]).
const FEWEST: usize = 3;
/// What a scan has to bring. The first at 0.7 and 1.4 times this, the second halved and doubled, as it is
/// ([`super`]).
const STRICTNESS: Strictness = Strictness { min_inlier_ratio: 0.6, max_contradicted: 0.05 };

impl SpatialRecognition {
    /// The newest keyframe measured in one of the earlier visits to where it is believed to be, in turn.
    pub(super) fn near(&mut self, id: KeyframeId, drift: &Covariance6, poses: &KeyframePoses) -> Option<LoopClosure> {
        let t_map_base = *poses.get(&id)?;
        let length_m = self.submap_length_m();
        let travel = self.seen.kept.get(&id)?.travel;
        let sigma = (0..3).map(|k| drift[(k, k)].max(0.0)).fold(0.0, f64::max).sqrt();
        let turning = (3..6).map(|k| drift[(k, k)].max(0.0)).fold(0.0, f64::max).sqrt();
        let reach = reach(range(&*self.seen.kept.get(&id)?.scan.get()?));
        if BRIDGED * sigma > reach.0 || BRIDGED * turning > reach.1 {
            return None;
        }
        let away = |t: &Pose| (t.translation.vector - t_map_base.translation.vector).norm();
        let mut visits: Vec<(f64, KeyframeId)> = vec![];
        for (other, kept) in &self.seen.kept {
            if travel - kept.travel < APART * length_m {
                break;
            }
            let Some(distance) = poses.get(other).map(away).filter(|d| *d < NEAR * length_m) else { continue };
            match visits.last_mut() {
                Some((nearest, last)) if kept.travel - self.seen.kept[last].travel < length_m => {
                    if distance < *nearest {
                        (*nearest, *last) = (distance, *other);
                    }
                }
                _ => visits.push((distance, *other)),
            }
        }
        visits.retain(|(_, other)| self.visit(*other, id, poses).is_some_and(|visit| visit.len() >= FEWEST));
        let (_, chosen) = *visits.get(id.0 as usize % visits.len().max(1))?;
        self.measure(id, chosen, &t_map_base, poses)
    }

    /// A keyframe measured from those around an earlier one in time, where it is expected at `t_map_base`.
    pub(super) fn measure(
        &self,
        id: KeyframeId,
        earlier: KeyframeId,
        t_map_base: &Pose,
        poses: &KeyframePoses,
    ) -> Option<LoopClosure> {
        let scan = self.seen.kept.get(&id)?.scan.get()?;
        let visit = self.visit(earlier, id, poses)?;
        let place = Target::new(&self.seen.kept, &visit, &[*t_map_base]);
        let found = place.measure(&scan, t_map_base, &STRICTNESS).ok()?;
        let (from, t_from_to) = place.seen_from(&found.t_odom_base)?;
        Some(LoopClosure { from, to: id, t_from_to, covariance: found.covariance, inlier_ratio: found.inlier_ratio })
    }

    /// Keyframes around an earlier one in time, without those that odometry ties a later one to; base to map.
    pub(super) fn visit(
        &self,
        earlier: KeyframeId,
        later: KeyframeId,
        poses: &KeyframePoses,
    ) -> Option<BTreeMap<KeyframeId, Pose>> {
        let (at, end) = (self.seen.kept.get(&earlier)?.travel, self.seen.kept.get(&later)?.travel);
        let length_m = self.submap_length_m();
        // The way grows from keyframe to keyframe.
        let kept = &self.seen.kept;
        let first = kept.range(..earlier).rev().take_while(|(_, k)| at - k.travel < length_m).last();
        let around = kept
            .range(first.map_or(earlier, |(id, _)| *id)..)
            .take_while(|(_, k)| k.travel - at < length_m && end - k.travel > 0.5 * APART * length_m);
        Some(around.filter_map(|(id, _)| Some((*id, *poses.get(id)?))).collect())
    }
}

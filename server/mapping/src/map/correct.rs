//! Corrections: keyframes get other poses, submaps follow as a whole.

use super::Map;
use super::rebuild::Fit;
use crate::error::check_pose;
use crate::submap::best_fit;
use crate::submap_id::SubmapId;
use crate::{MappingError, Submap};
use percept_geometry::{Correction, KeyframeId, Pose};
use std::collections::BTreeSet;

/// What a correction did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CorrectionReport {
    /// Keyframes that have another pose now.
    pub num_moved: usize,
    /// Keyframes named by the correction that this map does not hold.
    pub num_unknown: usize,
    /// Submaps that lie elsewhere now.
    pub num_submaps_moved: usize,
    /// Submaps whose layers do not show what their keyframes saw any more, because these moved relative to each other or were
    /// taken out: they are the first to be built anew.
    pub num_bent: usize,
}

impl Map {
    /// Moves keyframes to their corrected poses and takes others out; their submaps follow at once, each as a whole, and
    /// [`Map::advance`] builds them anew. Numbers that the map does not hold are left out. Nothing changes, nor does the
    /// version, if no keyframe of this map gets another pose or goes.
    ///
    /// # Errors
    /// `PoseNotFinite`; the map is unchanged then.
    pub fn correct(&mut self, correction: &Correction, gone: &[KeyframeId]) -> Result<CorrectionReport, MappingError> {
        correction.t_map_base.iter().try_for_each(|(_, pose)| check_pose(pose))?;
        let mut report = CorrectionReport::default();
        let mut concerned: BTreeSet<SubmapId> = BTreeSet::new();
        for (id, pose) in &correction.t_map_base {
            match self.keyframes.get_mut(id) {
                None => report.num_unknown += 1,
                Some(keyframe) if keyframe.t_map_base != *pose => {
                    keyframe.t_map_base = *pose;
                    concerned.insert(keyframe.submap);
                    report.num_moved += 1;
                }
                Some(_) => {}
            }
        }
        for keyframe in gone.iter().filter_map(|id| self.keyframes.remove(id)) {
            self.scan_bytes -= keyframe.scan.memory_bytes();
            concerned.insert(keyframe.submap);
        }
        if concerned.is_empty() {
            return Ok(report);
        }
        let version = self.shown.version + 1;
        for k in concerned.into_iter().filter_map(|id| self.position(id)).rev().collect::<Vec<_>>() {
            self.move_submap(k, version, &mut report);
        }
        self.show(version);
        self.hold_to_budget();
        Ok(report)
    }

    /// Puts a submap where its keyframes are; it goes with the last of them.
    fn move_submap(&mut self, k: usize, version: u64, report: &mut CorrectionReport) {
        let (submap, margin) = (&self.submaps[k], self.params.margin_m());
        let (id, is_active, before) = (submap.id, !submap.is_frozen, submap.t_map_submap);
        self.shown.touch(version, &submap.boxes_in_map(margin), is_active);
        if submap.keyframes().keys().all(|id| !self.keyframes.contains_key(id)) {
            self.submaps.remove(k);
            self.rebuild.forget(id);
            if is_active {
                self.active = None;
            }
            return;
        }
        report.num_bent += usize::from(self.lay(k) == Fit::Bent);
        report.num_submaps_moved += usize::from(self.submaps[k].t_map_submap != before);
        self.shown.touch(version, &self.submaps[k].boxes_in_map(margin), is_active);
    }

    /// Lays a submap where that fits its keyframes best. It is built anew if its layers are not what these gave there.
    pub(super) fn lay(&mut self, k: usize) -> Fit {
        let living = |(id, t): (&KeyframeId, &Pose)| Some((self.keyframes.get(id)?.t_map_base, *t));
        let pairs: Vec<(Pose, Pose)> = self.submaps[k].keyframes().iter().filter_map(living).collect();
        self.submaps[k].t_map_submap = best_fit(&pairs);
        let submap = &self.submaps[k];
        let fit = if pairs.len() < submap.keyframes().len() || self.is_off(submap) {
            Fit::Bent
        } else if pairs.iter().any(|(t_map_base, t_submap_base)| t_map_base != t_submap_base) {
            Fit::Near
        } else {
            Fit::Exact
        };
        self.rebuild.heed(submap.id, fit, submap.is_loaded());
        fit
    }

    /// Whether a keyframe's beams end farther than the tolerance from where the submap's layers have that.
    fn is_off(&self, submap: &Submap) -> bool {
        submap.keyframes().iter().any(|(id, t_submap_base)| {
            let Some(keyframe) = self.keyframes.get(id) else { return true };
            let off = (submap.t_map_submap * t_submap_base).inv_mul(&keyframe.t_map_base);
            let (shift, turn) = (off.translation.vector.norm(), off.rotation.angle());
            shift + turn * keyframe.reach_m > self.params.tolerance_m()
        })
    }
}

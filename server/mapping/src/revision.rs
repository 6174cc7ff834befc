//! Another state of a map, built beside the one that is shown, a little at a time.

use crate::error::{check_keyframe, check_pose};
use crate::{CorrectionReport, MapKeyframe, MapLayers, MapParams, MappingError};
use percept_geometry::{Correction, KeyframeId, KeyframeScan, Pose};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;
use std::sync::Arc;

/// Keyframes prepared at once: bounds the memory that takes.
const CHUNK: usize = 8;

/// A map with some keyframes at other poses and others gone, while its layers are being built. What comes of it does not
/// depend on the steps that it was built in.
#[derive(Debug, Clone)]
pub struct Revision {
    params: MapParams,
    keyframes: BTreeMap<KeyframeId, MapKeyframe>,
    gone: BTreeSet<KeyframeId>,
    report: CorrectionReport,
    layers: MapLayers,
    /// The newest keyframe that is in the layers.
    newest_built: Option<KeyframeId>,
}

impl Revision {
    pub(crate) fn new(
        params: MapParams,
        mut keyframes: BTreeMap<KeyframeId, MapKeyframe>,
        correction: &Correction,
        gone: &[KeyframeId],
    ) -> Result<Self, MappingError> {
        correction.t_map_base.iter().try_for_each(|(_, pose)| check_pose(pose))?;
        let mut report = CorrectionReport::default();
        for (id, pose) in &correction.t_map_base {
            match keyframes.get_mut(id) {
                None => report.num_unknown += 1,
                Some(keyframe) if keyframe.t_map_base != *pose => {
                    keyframe.t_map_base = *pose;
                    report.num_moved += 1;
                }
                Some(_) => {}
            }
        }
        let gone = gone.iter().copied().filter(|id| keyframes.remove(id).is_some()).collect();
        Ok(Self { layers: MapLayers::empty(&params)?, params, keyframes, gone, report, newest_built: None })
    }

    /// What the correction moves.
    pub fn report(&self) -> &CorrectionReport {
        &self.report
    }

    /// Whether the map will be another one.
    pub fn changes_anything(&self) -> bool {
        self.report.num_moved > 0 || !self.gone.is_empty()
    }

    /// Adds a keyframe that came since this was begun, at its pose in this state of the map.
    ///
    /// # Errors
    /// `DuplicateKeyframe`, `PoseNotFinite`, `Scan`; nothing is changed then.
    pub fn insert(&mut self, id: KeyframeId, t_map_base: Pose, scan: Arc<KeyframeScan>) -> Result<(), MappingError> {
        check_keyframe(&t_map_base, &scan)?;
        if self.keyframes.contains_key(&id) {
            return Err(MappingError::DuplicateKeyframe { id });
        }
        self.put(id, MapKeyframe { t_map_base, scan })
    }

    fn put(&mut self, id: KeyframeId, keyframe: MapKeyframe) -> Result<(), MappingError> {
        self.keyframes.insert(id, keyframe);
        if self.newest_built.is_some_and(|built| id < built) {
            // Keyframes are integrated in the order of their numbers.
            self.layers = MapLayers::empty(&self.params)?;
            self.newest_built = None;
        }
        Ok(())
    }

    /// Points and misses of all keyframes.
    pub fn num_points(&self) -> usize {
        self.keyframes.values().map(size).sum()
    }

    /// Builds on by keyframes of about so many points and misses together, by one at least; whether all are in.
    pub fn advance(&mut self, num_points: usize) -> bool {
        let mut left = num_points.max(1);
        let rest = (self.newest_built.map_or(Bound::Unbounded, Bound::Excluded), Bound::Unbounded);
        let mut is_due = |k: &MapKeyframe| {
            let is_due = left > 0;
            left = left.saturating_sub(size(k).max(1));
            is_due
        };
        let due = self.keyframes.range(rest).take_while(|(_, k)| is_due(k));
        let due: Vec<(KeyframeId, MapKeyframe)> = due.map(|(id, k)| (*id, k.clone())).collect();
        for chunk in due.chunks(CHUNK) {
            let updates: Vec<_> = chunk.par_iter().map(|(_, k)| self.layers.prepare(&self.params, k)).collect();
            updates.iter().for_each(|update| self.layers.add(update));
        }
        if let Some((last, _)) = due.last() {
            self.newest_built = Some(*last);
        }
        self.newest_built == self.keyframes.last_key_value().map(|(id, _)| *id)
    }

    /// Keyframes of the map that this neither holds nor took out.
    pub(crate) fn carry_over(&mut self, of_map: &BTreeMap<KeyframeId, MapKeyframe>) {
        for (id, keyframe) in of_map {
            if !self.keyframes.contains_key(id) && !self.gone.contains(id) {
                let kept = self.put(*id, keyframe.clone());
                debug_assert!(kept.is_ok(), "parameters were valid when this was begun");
            }
        }
    }

    pub(crate) fn finish(mut self) -> (BTreeMap<KeyframeId, MapKeyframe>, MapLayers) {
        while !self.advance(usize::MAX) {}
        (self.keyframes, self.layers)
    }
}

fn size(keyframe: &MapKeyframe) -> usize {
    keyframe.scan.hits.len() + keyframe.scan.misses.len()
}

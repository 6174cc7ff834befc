//! Submaps whose layers are built anew beside what is shown, one after the other, a little at a time, on any thread.

use super::{Map, MapKeyframe};
use crate::keyframe_view::KeyframeView;
use crate::layers::{LayerBoxes, LayerSlots, LayersUpdate};
use crate::submap_id::SubmapId;
use crate::{MapParams, Submap, SubmapLayers};
use percept_geometry::{KeptScan, KeyframeId, Pose};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Keyframes prepared at once: bounds the memory that takes.
const CHUNK: usize = 8;

/// How well a submap's layers show what its keyframes saw where these are now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    /// As if they had been there when it was filled.
    Exact,
    /// To within the tolerance, but for lying askew on the map's cells.
    Near,
    /// Not even that, or some of its keyframes are gone.
    Bent,
}

/// What is to be built anew.
#[derive(Debug, Default)]
pub(super) struct Rebuild {
    bent: BTreeSet<SubmapId>,
    /// These can wait.
    near: BTreeSet<SubmapId>,
    under_way: Option<UnderWay>,
}

/// A submap that is being built.
#[derive(Debug)]
struct UnderWay {
    id: SubmapId,
    /// Still to be integrated, at the poses that they had in the map when this was begun.
    left: Vec<(KeyframeId, Pose)>,
    /// None while a step is worked on.
    built: Option<Built>,
}

/// What is built of a submap.
#[derive(Debug)]
struct Built {
    /// Integrated: base to the submap's new frame.
    keyframes: BTreeMap<KeyframeId, Pose>,
    boxes: LayerBoxes,
    layers: SubmapLayers,
}

/// Some keyframes by which a submap is built on: work for any thread, whatever becomes of the map meanwhile.
#[derive(Debug)]
pub struct RebuildStep {
    params: MapParams,
    id: SubmapId,
    due: Vec<Due>,
    built: Built,
}

/// A keyframe that is due.
#[derive(Debug)]
struct Due {
    id: KeyframeId,
    t_submap_base: Pose,
    t_base_before: Option<Pose>,
    scan: KeptScan,
}

impl Due {
    /// None if its scan cannot be had any more.
    fn prepare(&self, params: &MapParams) -> Option<LayersUpdate> {
        let scan = self.scan.get()?;
        let view = KeyframeView::new(&self.t_submap_base, &scan).coming_from(self.t_base_before);
        Some(LayersUpdate::new(params, &view))
    }
}

/// A step that was worked on.
#[derive(Debug)]
pub struct RebuildStepDone {
    id: SubmapId,
    /// None if a scan cannot be had any more: what is built would miss it, so the submap stays as it is.
    built: Option<Built>,
}

impl RebuildStep {
    /// Works on it. Parallel work runs on the current rayon pool.
    pub fn run(self) -> RebuildStepDone {
        let Self { params, id, due, mut built } = self;
        let updates: Option<Vec<LayersUpdate>> = due.par_iter().map(|d| d.prepare(&params)).collect();
        let built = updates.map(|updates| {
            for (Due { id, t_submap_base, .. }, update) in due.iter().zip(updates) {
                built.boxes = built.boxes.joined(&update.touched(&params));
                built.layers.add(&update);
                built.keyframes.insert(*id, *t_submap_base);
            }
            built
        });
        RebuildStepDone { id, built }
    }
}

impl Rebuild {
    /// A submap lies elsewhere now, or its keyframes do. One that fits well enough is not fetched from where it was stored to.
    pub(super) fn heed(&mut self, id: SubmapId, fit: Fit, is_loaded: bool) {
        if fit == Fit::Exact {
            return self.forget(id);
        }
        self.unqueue(id);
        // One that is under way is looked at again when it is built: so it gets built, however often it is moved meanwhile.
        if self.under_way.as_ref().is_some_and(|u| u.id == id) {
            return;
        }
        match fit {
            Fit::Bent => self.bent.insert(id),
            _ => is_loaded && self.near.insert(id),
        };
    }

    /// The submap that is being filled takes in a keyframe.
    pub(super) fn take_in(&mut self, submap: SubmapId, id: KeyframeId, t_map_base: &Pose) {
        if let Some(under_way) = self.under_way.as_mut().filter(|u| u.id == submap) {
            under_way.left.push((id, *t_map_base));
        }
    }

    fn unqueue(&mut self, id: SubmapId) {
        self.bent.remove(&id);
        self.near.remove(&id);
    }

    pub(super) fn forget(&mut self, id: SubmapId) {
        self.unqueue(id);
        self.under_way.take_if(|u| u.id == id);
    }

    /// The newest first: the robot is there.
    fn next(&mut self) -> Option<SubmapId> {
        self.bent.pop_last().or_else(|| self.near.pop_last())
    }

    /// Submaps that wait, those under way left out.
    fn waiting(&self) -> impl Iterator<Item = &SubmapId> {
        self.bent.iter().chain(&self.near)
    }

    fn is_idle(&self) -> bool {
        self.bent.is_empty() && self.near.is_empty() && self.under_way.is_none()
    }
}

impl Map {
    /// Whether submaps are waiting to be built anew: until then they are shown as they were, where that fits best.
    pub fn is_rebuilding(&self) -> bool {
        !self.rebuild.is_idle()
    }

    /// Keyframes that submaps are still to be built anew from.
    pub fn num_to_rebuild(&self) -> usize {
        let of = |id: &SubmapId| self.position(*id).map_or(0, |k| self.submaps[k].keyframes().len());
        let under_way = self.rebuild.under_way.as_ref().map_or(0, |u| u.left.len());
        self.rebuild.waiting().map(of).sum::<usize>() + under_way
    }

    /// Builds on by keyframes of about so many points and misses together, by one at least; whether nothing is left to do. A
    /// submap is shown once it is whole. What comes of it does not depend on the steps.
    pub fn advance(&mut self, num_points: usize) -> bool {
        let mut left = num_points.max(1);
        while let Some(step) = self.step(&mut left) {
            self.take_step(step.run());
        }
        self.rebuild.is_idle()
    }

    /// The next step, of keyframes of about so many points and misses together, of one at least; none if nothing is left to do, or
    /// the step before was not taken in. Nothing else is built on until this one is ([`Map::take_step`]).
    pub fn next_step(&mut self, num_points: usize) -> Option<RebuildStep> {
        self.step(&mut num_points.max(1))
    }

    /// A step of at most so many points and misses, which are then left out of that number.
    fn step(&mut self, left: &mut usize) -> Option<RebuildStep> {
        if *left == 0 || !self.begin_next() {
            return None;
        }
        let under_way = self.rebuild.under_way.as_mut()?;
        let built = under_way.built.take()?;
        let mut num_due = 0;
        while num_due < CHUNK.min(under_way.left.len()) && *left > 0 {
            let size = self.keyframes.get(&under_way.left[num_due].0).map_or(1, |k| k.size.max(1));
            *left = left.saturating_sub(size);
            num_due += 1;
        }
        // Those that have left the map meanwhile are left out.
        let living = |(id, t_submap_base)| {
            let MapKeyframe { t_base_before, scan, .. } = self.keyframes.get(&id)?;
            Some(Due { id, t_submap_base, t_base_before: *t_base_before, scan: scan.clone() })
        };
        let due = under_way.left.drain(..num_due).filter_map(living).collect();
        Some(RebuildStep { params: self.params, id: under_way.id, due, built })
    }

    /// Takes in what came of a step. A submap that is whole by it is shown.
    pub fn take_step(&mut self, done: RebuildStepDone) {
        let Some(mut under_way) = self.rebuild.under_way.take_if(|u| u.id == done.id && u.built.is_none()) else {
            return;
        };
        match done.built {
            Some(built) if under_way.left.is_empty() => self.replace(done.id, built),
            Some(built) => {
                under_way.built = Some(built);
                self.rebuild.under_way = Some(under_way);
            }
            None => {}
        }
    }

    /// Whether there is one under way.
    fn begin_next(&mut self) -> bool {
        while self.rebuild.under_way.is_none() {
            let Some(id) = self.rebuild.next() else { return false };
            let Some(submap) = self.position(id).map(|k| &self.submaps[k]) else { continue };
            let living = |id: &KeyframeId| Some((*id, self.keyframes.get(id)?.t_map_base));
            let left: Vec<_> = submap.keyframes().keys().filter_map(living).collect();
            let (boxes, layers) = (LayerBoxes::empty(), SubmapLayers::new(&self.params));
            let built = Some(Built { keyframes: BTreeMap::new(), boxes, layers });
            self.rebuild.under_way = Some(UnderWay { id, left, built });
        }
        true
    }

    /// Shows a submap that was built anew: its frame is the map's again.
    fn replace(&mut self, id: SubmapId, built: Built) {
        let Built { keyframes, boxes, mut layers } = built;
        let Some(k) = self.position(id).filter(|_| !keyframes.is_empty()) else { return };
        let is_active = !self.submaps[k].is_frozen;
        if !is_active {
            layers.freeze();
        }
        let layers = Arc::new(layers);
        if is_active {
            self.active = Some(Arc::clone(&layers));
        }
        let (version, margin) = (self.shown.version + 1, self.params.margin_m());
        self.shown.touch(version, &self.submaps[k].boxes_in_map(margin), is_active);
        let mut submap = Submap::new(id, &self.params);
        (submap.boxes, submap.is_frozen) = (boxes, !is_active);
        let slots = if is_active { LayerSlots::new } else { LayerSlots::frozen };
        submap.slots = Arc::new(slots(&self.params, &layers));
        for (id, t_map_base) in keyframes {
            submap.add_keyframe(id, t_map_base, self.keyframes.get(&id).and_then(|k| k.seen));
        }
        submap.is_expired = self.submaps[k].is_expired;
        self.submaps[k] = submap;
        // Its keyframes may have moved since this was begun.
        self.lay(k);
        self.shown.touch(version, &self.submaps[k].boxes_in_map(margin), is_active);
        self.show(version);
        self.hold_to_budget();
    }
}

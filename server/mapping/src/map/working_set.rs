//! What of a map is in memory: submaps that are far from where the robot is go to the store when there is no room.

use super::{Map, MapKeyframe};
use crate::MappingError;
use crate::layer_slot::Fetched;
use crate::store::{MapMemory, MapStore};
use crate::stored_scan::store_scan;
use crate::submap::Submap;
use crate::submap_id::SubmapId;
use std::sync::Arc;

/// What composed tiles may take of a budget, and what submaps may that readers have fetched: a quarter each. The rest is for
/// the submaps around the robot and the scans of their keyframes.
fn share(max_bytes: usize) -> usize {
    max_bytes / 4
}

impl Map {
    /// Sets where submaps go that are not in memory, which says how many bytes the map may take before they do.
    pub fn set_store(&mut self, store: Arc<dyn MapStore>) {
        self.fetched = Arc::new(Fetched::new(share(store.max_bytes())));
        self.store = Some(store);
        self.hold_to_budget();
    }

    /// Bytes that the caller keeps beside the map, and that count towards its budget.
    pub fn set_beside(&mut self, bytes: usize) {
        self.beside_bytes = bytes;
    }

    /// Bytes that the map may take.
    fn room(&self) -> usize {
        let most = self.store.as_ref().map_or(usize::MAX, |store| store.max_bytes());
        most.saturating_sub(self.beside_bytes)
    }

    /// What the map takes in memory.
    pub fn memory(&self) -> MapMemory {
        MapMemory {
            scans: self.scan_bytes + self.keyframes.len() * size_of::<MapKeyframe>(),
            layers: self.submaps.iter().map(|s| s.slots.memory_bytes()).sum(),
            tiles: self.shown.kept_bytes(),
        }
    }

    /// Takes a frozen submap's layers out of memory, and its keyframes' scans. Whether the
    /// layers are out: not if it is being filled, nor if the store does not take them. The map stays whole.
    ///
    /// # Errors
    /// `NoSubmap`.
    pub fn evict(&mut self, id: SubmapId) -> Result<bool, MappingError> {
        let k = self.position(id).ok_or(MappingError::NoSubmap { id })?;
        self.evict_at(k);
        Ok(!self.submaps[k].is_loaded())
    }

    /// Takes a submap's layers into memory again. What of the map could not be read without them can be afterwards.
    ///
    /// # Errors
    /// `NoSubmap`; `SubmapLost` if they are gone or damaged: the rest of the map works without.
    pub fn load(&mut self, id: SubmapId) -> Result<(), MappingError> {
        let k = self.position(id).ok_or(MappingError::NoSubmap { id })?;
        let was_lost = self.submaps[k].slots.is_lost();
        if !self.submaps[k].slots.load() {
            return Err(MappingError::SubmapLost { id });
        }
        if was_lost {
            let version = self.shown.version + 1;
            self.shown.touch(version, &self.submaps[k].boxes_in_map(self.params.margin_m()), false);
            self.show(version);
        }
        Ok(())
    }

    /// Gives up composed tiles beyond their share, then evicts the submaps that are farthest from the newest keyframe, until the
    /// map takes no more than it may.
    pub(super) fn hold_to_budget(&mut self) {
        if self.store.is_none() {
            return;
        }
        let Some(here) = self.keyframes.values().next_back().map(|k| k.t_map_base.translation.vector) else { return };
        let room = self.room();
        self.shown.forget_beyond(here.xy().into(), share(room));
        let mut taken = self.memory().total();
        if taken <= room {
            return;
        }
        let distance = |s: &Submap| {
            let first = s.keyframes().values().next().map(|t| (s.t_map_submap * t).translation.vector - here);
            first.map_or(0.0, |off| off.norm())
        };
        let mut by_distance: Vec<(f64, usize)> =
            (0..self.submaps.len()).map(|k| (distance(&self.submaps[k]), k)).collect();
        by_distance.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, k) in by_distance {
            taken = taken.saturating_sub(self.evict_at(k));
            if taken <= room {
                return;
            }
        }
    }

    /// What of a submap goes out of memory, bytes: nothing if it is being filled, nor what the store does not take.
    fn evict_at(&mut self, k: usize) -> usize {
        let (Some(store), submap) = (self.store.clone(), &self.submaps[k]) else { return 0 };
        if !submap.is_frozen {
            return 0;
        }
        let mut freed = submap.slots.evict(&store, &self.fetched);
        for id in submap.keyframes().keys() {
            let Some(keyframe) = self.keyframes.get(id) else { continue };
            let bytes = keyframe.scan.evict(|scan| store_scan(&store, scan));
            self.scan_bytes -= bytes;
            freed += bytes;
        }
        freed
    }
}

//! What of a map is in memory: submaps that are far from where the robot is go to the store when there is no room.

use super::{Map, MapKeyframe};
use crate::MappingError;
use crate::layer_slot::Fetched;
use crate::layers::LayerSlots;
use crate::store::{BlobId, MapMemory, MapStore};
use crate::stored_scan::store_scan;
use crate::submap::Submap;
use crate::submap_id::SubmapId;
use percept_geometry::KeptScan;
use std::sync::Arc;

/// What composed tiles may take of a budget, and what submaps may that readers have fetched: a quarter each. The rest is for
/// the submaps around the robot and the scans of their keyframes.
fn share(max_bytes: usize) -> usize {
    max_bytes / 4
}

/// From this share of the budget on, what will have to go is stored before it has to: encoding a submap of all layers takes 4 to 40 ms,
/// which a frame that has no room for its keyframe waited for.
const STORE_AHEAD: f64 = 0.75;
/// What is stored goes when so small a part of the budget is left.
const STORED_GO_SOONER: usize = 8;

/// A submap that is to be stored before there is no room for it. Dropped, nothing is lost: it is stored when it has to go.
pub struct StoreAhead {
    slots: Arc<LayerSlots>,
    scans: Vec<KeptScan>,
    store: Arc<dyn MapStore>,
    fetched: Arc<Fetched>,
    _under_way: Arc<()>,
}

/// A store for what has room in memory still.
#[derive(Debug)]
struct Ahead(Arc<dyn MapStore>);

impl MapStore for Ahead {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        self.0.put_ahead(bytes)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        self.0.get(id)
    }

    fn max_bytes(&self) -> usize {
        self.0.max_bytes()
    }
}

impl StoreAhead {
    /// Stores it; it stays in memory.
    pub fn run(self) {
        self.slots.store(&self.store, &self.fetched);
        for scan in &self.scans {
            scan.put(|scan| store_scan(&self.store, scan));
        }
    }
}

impl Map {
    /// What can be stored beside frames now, so that none waits for it later: the frozen submap that would have to go next of those that
    /// are not stored; none while there is plenty of room, or while one is under way.
    pub fn store_ahead(&mut self) -> Option<StoreAhead> {
        let store = self.store.as_ref().filter(|store| store.takes_ahead())?;
        if self.storing.strong_count() > 0 || (self.memory().total() as f64) < STORE_AHEAD * self.room() as f64 {
            return None;
        }
        let submap =
            self.by_distance().into_iter().map(|k| &self.submaps[k]).find(|s| s.is_frozen && s.slots.is_unstored())?;
        let scans = submap.keyframes().keys().filter_map(|id| Some(self.keyframes.get(id)?.scan.clone())).collect();
        let under_way = Arc::new(());
        self.storing = Arc::downgrade(&under_way);
        let (slots, fetched) = (Arc::clone(&submap.slots), Arc::clone(&self.fetched));
        let store = Arc::new(Ahead(Arc::clone(store)));
        Some(StoreAhead { slots, scans, store, fetched, _under_way: under_way })
    }

    /// Numbers of the submaps, those farthest from the newest keyframe first.
    fn by_distance(&self) -> Vec<usize> {
        let Some(here) = self.keyframes.values().next_back().map(|k| k.t_map_base.translation.vector) else {
            return vec![];
        };
        let distance = |s: &Submap| {
            let first = s.keyframes().values().next().map(|t| (s.t_map_submap * t).translation.vector - here);
            first.map_or(0.0, |off| off.norm())
        };
        let mut out: Vec<(f64, usize)> = self.submaps.iter().map(distance).zip(0..).collect();
        out.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        out.into_iter().map(|(_, k)| k).collect()
    }

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
    /// map takes no more than it may. What is stored goes a little sooner, so that nothing has to be stored while a frame waits.
    pub(super) fn hold_to_budget(&mut self) {
        if self.store.is_none() {
            return;
        }
        let Some(here) = self.keyframes.values().next_back().map(|k| k.t_map_base.translation.vector) else { return };
        let room = self.room();
        self.shown.forget_beyond(here.xy().into(), share(room));
        let mut taken = self.memory().total();
        let soon = room - room / STORED_GO_SOONER;
        if taken <= soon {
            return;
        }
        let by_distance = self.by_distance();
        for k in by_distance.iter().filter(|k| !self.submaps[**k].slots.is_unstored()).copied().collect::<Vec<_>>() {
            taken = taken.saturating_sub(self.evict_at(k));
            if taken <= soon {
                return;
            }
        }
        for k in by_distance {
            if taken <= room {
                return;
            }
            taken = taken.saturating_sub(self.evict_at(k));
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

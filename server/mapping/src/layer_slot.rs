//! One layer of a submap, in memory or to be had from the store.

use crate::bytes::{Damaged, Reader};
use crate::layer::{Footprint, Layer};
use crate::store::{BlobId, MapStore};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError, RwLock, Weak};

/// First bytes of a stored layer; the number is that of the layout.
const MAGIC: &[u8; 4] = b"PSL1";

/// What a submap holds of one layer, in memory or to be had from the store. Shared by all moments that show it. Layers are stored
/// apart: who reads the grid does not decode the cloud.
#[derive(Debug)]
pub struct LayerSlot<L: Layer> {
    params: L::Params,
    /// Where it says anything, if nothing is added to it any more.
    footprint: Option<Footprint>,
    held: RwLock<Held<L>>,
}

#[derive(Debug)]
struct Held<L> {
    layer: Option<Arc<L>>,
    bytes: usize,
    stored: Option<Stored>,
    /// Whether it could not be had when it was wanted.
    is_lost: bool,
}

#[derive(Debug, Clone)]
struct Stored {
    id: BlobId,
    store: Arc<dyn MapStore>,
    fetched: Arc<Fetched>,
}

impl<L: Layer> LayerSlot<L> {
    /// Of a layer that is being filled, or of one to which nothing is added any more.
    pub(crate) fn new(params: &L::Params, layer: &L, is_frozen: bool) -> Self {
        let bytes = layer.memory_bytes();
        let held = Held { layer: Some(Arc::new(layer.clone())), bytes, stored: None, is_lost: false };
        Self { params: *params, footprint: is_frozen.then(|| layer.footprint(params)), held: RwLock::new(held) }
    }

    /// Where it says anything, as far as that is settled.
    pub(crate) fn footprint(&self) -> Option<&Footprint> {
        self.footprint.as_ref()
    }

    fn read<T>(&self, look: impl FnOnce(&Held<L>) -> T) -> T {
        look(&self.held.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn write<T>(&self, change: impl FnOnce(&mut Held<L>) -> T) -> T {
        change(&mut self.held.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// The layer, fetched if need be; none if that fails.
    pub(crate) fn get(self: &Arc<Self>) -> Option<Arc<L>> {
        let (layer, stored) = self.read(|held| (held.layer.clone(), held.stored.clone()));
        if layer.is_some() {
            return layer;
        }
        let stored = stored?;
        let bytes = stored.store.get(&stored.id);
        let layer = bytes.and_then(|b| self.decode(&b).ok()).map(Arc::new);
        self.write(|held| {
            held.is_lost = layer.is_none();
            held.bytes = layer.as_ref().map_or(0, |l| l.memory_bytes());
            held.layer.clone_from(&layer);
        });
        if layer.is_some() {
            let slot: Arc<dyn Evictable> = Arc::clone(self) as _;
            stored.fetched.note(&slot);
        }
        layer
    }

    fn encode(layer: &L) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        layer.encode(&mut out);
        out
    }

    fn decode(&self, bytes: &[u8]) -> Result<L, Damaged> {
        let mut from = Reader::new(bytes.strip_prefix(MAGIC).ok_or(Damaged)?);
        let layer = L::decode(&self.params, &mut from)?;
        if from.is_at_end() { Ok(layer) } else { Err(Damaged) }
    }

    pub(crate) fn is_lost(&self) -> bool {
        self.read(|held| held.is_lost)
    }

    /// Stores what it holds, if it is not stored. A layer that holds nothing is not: there is nothing to store of it, and nothing
    /// that could be lost. Whether there is nothing left to store.
    pub(crate) fn store(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) -> bool {
        let layer = self.read(|held| held.layer.clone().filter(|_| held.bytes > 0 && held.stored.is_none()));
        let Some(layer) = layer else { return true };
        let Some(id) = store.put(&Self::encode(&layer)) else { return false };
        let stored = Stored { id, store: Arc::clone(store), fetched: Arc::clone(fetched) };
        self.write(|held| held.stored = held.stored.take().or(Some(stored)));
        true
    }

    /// Whether it holds anything that is not stored.
    pub(crate) fn is_unstored(&self) -> bool {
        self.read(|held| held.layer.is_some() && held.bytes > 0 && held.stored.is_none())
    }

    /// Stores what it holds, if it is not stored, and gives up the memory: how many bytes, none if the store does not take it.
    pub(crate) fn evict(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) -> usize {
        if self.store(store, fetched) { self.release() } else { 0 }
    }
}

/// What can go out of memory and be fetched again.
pub(crate) trait Evictable: Send + Sync {
    fn is_loaded(&self) -> bool;
    /// What it takes in memory, bytes.
    fn memory_bytes(&self) -> usize;
    /// Gives up the memory of what is stored: how many bytes.
    fn release(&self) -> usize;
}

impl<L: Layer> Evictable for LayerSlot<L> {
    fn is_loaded(&self) -> bool {
        self.read(|held| held.layer.is_some())
    }

    fn memory_bytes(&self) -> usize {
        let footprint = self.footprint.as_ref().map_or(0, Footprint::memory_bytes);
        footprint + self.read(|held| if held.layer.is_some() { held.bytes } else { 0 })
    }

    fn release(&self) -> usize {
        self.write(|held| if held.stored.is_some() && held.layer.take().is_some() { held.bytes } else { 0 })
    }
}

/// Layers that readers have fetched from the store, in that order: beyond so many bytes the earliest goes, so that a look at
/// the whole map does not take the whole map into memory.
#[derive(Default)]
pub(crate) struct Fetched {
    max_bytes: usize,
    slots: Mutex<VecDeque<Weak<dyn Evictable>>>,
}

impl std::fmt::Debug for Fetched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Fetched").field("max_bytes", &self.max_bytes).finish_non_exhaustive()
    }
}

impl Fetched {
    pub(crate) fn new(max_bytes: usize) -> Self {
        Self { max_bytes, slots: Mutex::default() }
    }

    fn note(&self, slot: &Arc<dyn Evictable>) {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        let is_other = |s: &Arc<dyn Evictable>| s.is_loaded() && !std::ptr::addr_eq(Arc::as_ptr(s), Arc::as_ptr(slot));
        slots.retain(|s| s.upgrade().as_ref().is_some_and(is_other));
        slots.push_back(Arc::downgrade(slot));
        let mut bytes: usize = slots.iter().filter_map(Weak::upgrade).map(|s| s.memory_bytes()).sum();
        while bytes > self.max_bytes && slots.len() > 1 {
            bytes -= slots.pop_front().and_then(|s| s.upgrade()).map_or(0, |s| s.release());
        }
    }
}

//! A submap: keyframes that belong together, and what they have seen, in a frame of its own.

use crate::MapParams;
use crate::composed::Part;
use crate::layer::{Placement, moved};
use crate::layers::{LayerBoxes, LayerFootprints, SubmapLayers};
use crate::store::{BlobId, MapStore};
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{KeyframeId, Pose, se3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError, RwLock, Weak};

/// Which submap, among those of all robots and all their runs. Says neither where nor when it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct SubmapId {
    /// Whose it is.
    pub robot: u32,
    /// Of which run.
    pub run: u32,
    /// Which of that.
    pub number: u32,
}

/// Keyframes that belong together, and what they have seen, in a frame of its own: that of the map when it was begun, so
/// that its cells are the map's until a correction moves it.
///
/// The newest submap of a map is filled; the others are frozen: a correction moves them as a whole.
#[derive(Debug, Clone)]
pub struct Submap {
    pub(crate) id: SubmapId,
    pub(crate) t_map_submap: Pose,
    /// Where its layers have each keyframe: base to submap.
    keyframes: BTreeMap<KeyframeId, Pose>,
    /// Mean height of these, submap's frame, metres.
    height_m: f64,
    /// Of its layers, submap's frame.
    pub(crate) boxes: LayerBoxes,
    pub(crate) is_frozen: bool,
    pub(crate) slot: Arc<Slot>,
}

impl Submap {
    pub(crate) fn new(id: SubmapId) -> Self {
        Self {
            id,
            t_map_submap: Pose::identity(),
            keyframes: BTreeMap::new(),
            height_m: 0.0,
            boxes: LayerBoxes::empty(),
            is_frozen: false,
            slot: Arc::default(),
        }
    }

    /// Which it is.
    pub fn id(&self) -> SubmapId {
        self.id
    }

    /// Submap to map.
    pub fn t_map_submap(&self) -> &Pose {
        &self.t_map_submap
    }

    /// Where its layers have each of its keyframes: base to submap.
    pub fn keyframes(&self) -> &BTreeMap<KeyframeId, Pose> {
        &self.keyframes
    }

    /// Whether nothing is added to it any more.
    pub fn is_frozen(&self) -> bool {
        self.is_frozen
    }

    /// Whether its layers are in memory.
    pub fn is_loaded(&self) -> bool {
        self.slot.is_loaded()
    }

    /// Its layers hold a further keyframe.
    pub(crate) fn add_keyframe(&mut self, id: KeyframeId, t_submap_base: Pose) {
        self.keyframes.insert(id, t_submap_base);
        let heights = self.keyframes.values().map(|t| t.translation.vector.z);
        self.height_m = heights.sum::<f64>() / self.keyframes.len() as f64;
    }

    /// Where it lies.
    pub(crate) fn place(&self) -> Placement {
        let floor_z_m = self.height_m + self.t_map_submap.translation.vector.z;
        Placement { t_map_submap: self.t_map_submap, floor_z_m }
    }

    /// Boxes of its layers in the map.
    pub(crate) fn boxes_in_map(&self, margin_m: f64) -> LayerBoxes {
        self.in_map(&self.boxes, margin_m)
    }

    /// Boxes in its frame as boxes in the map; a margin makes up for cells that do not lie on the map's.
    pub(crate) fn in_map(&self, boxes: &LayerBoxes, margin_m: f64) -> LayerBoxes {
        let place = self.place();
        if place.is_aligned() {
            return boxes.clone();
        }
        let margin = Vector3::repeat(margin_m);
        boxes.map(|b| {
            let mut out = moved(&place.t_map_submap, b);
            (out.min, out.max) = (out.min - margin, out.max + margin);
            out
        })
    }

    pub(crate) fn part(&self, margin_m: f64) -> Part {
        let (place, boxes) = (self.place(), self.boxes_in_map(margin_m));
        Part { id: self.id, place, boxes, slot: Arc::clone(&self.slot), is_frozen: self.is_frozen }
    }
}

/// The motion that takes poses in one frame nearest to those in another, and so takes what hangs on them along: the mean of
/// what each pair says of the turn, then of the shift.
///
/// Pairs are (in a, in b); the identity without any.
pub(crate) fn best_fit(pairs: &[(Pose, Pose)]) -> Pose {
    let Some((first_a, first_b)) = pairs.first() else { return Pose::identity() };
    let n = pairs.len() as f64;
    let first = first_a.rotation * first_b.rotation.inverse();
    let off = |(a, b): &(Pose, Pose)| (first.inverse() * a.rotation * b.rotation.inverse()).scaled_axis();
    // Turns within a submap differ little, so that their logarithms may be averaged.
    let rotation = first * UnitQuaternion::from_scaled_axis(pairs.iter().map(off).sum::<Vector3<f64>>() / n);
    let shift = |(a, b): &(Pose, Pose)| a.translation.vector - rotation * b.translation.vector;
    let translation = pairs.iter().map(shift).sum::<Vector3<f64>>() / n;
    let t_a_b = Pose::from_parts(translation.into(), rotation);
    // Rounding alone moves nothing: aligned frames stay aligned.
    if se3::log(&t_a_b).norm() < 1e-9 { Pose::identity() } else { t_a_b }
}

/// What a submap holds, in memory or to be had from the store. Shared by all moments that show it.
#[derive(Debug, Default)]
pub(crate) struct Slot {
    params: MapParams,
    /// Where the layers say anything, if nothing is added to them any more.
    footprints: Option<LayerFootprints>,
    held: RwLock<Held>,
}

#[derive(Debug, Default, Clone)]
struct Held {
    layers: Option<Arc<SubmapLayers>>,
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

impl Slot {
    pub(crate) fn new(params: &MapParams, layers: Arc<SubmapLayers>) -> Self {
        let bytes = layers.memory_bytes();
        let held = Held { layers: Some(layers), bytes, ..Held::default() };
        Self { params: *params, footprints: None, held: RwLock::new(held) }
    }

    /// Of layers to which nothing is added any more.
    pub(crate) fn frozen(params: &MapParams, layers: Arc<SubmapLayers>) -> Self {
        Self { footprints: Some(layers.footprints(params)), ..Self::new(params, layers) }
    }

    /// Where the layers say anything, as far as that is settled.
    pub(crate) fn footprints(&self) -> Option<&LayerFootprints> {
        self.footprints.as_ref()
    }

    fn read<T>(&self, look: impl FnOnce(&Held) -> T) -> T {
        look(&self.held.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn write<T>(&self, change: impl FnOnce(&mut Held) -> T) -> T {
        change(&mut self.held.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// What the submap holds, fetched if need be; none if that fails.
    pub(crate) fn get(self: &Arc<Self>) -> Option<Arc<SubmapLayers>> {
        let held = self.read(Held::clone);
        if held.layers.is_some() {
            return held.layers;
        }
        let stored = held.stored?;
        let bytes = stored.store.get(&stored.id);
        let layers = bytes.and_then(|b| SubmapLayers::decode(&self.params, &b).ok()).map(Arc::new);
        self.write(|held| {
            held.is_lost = layers.is_none();
            held.bytes = layers.as_ref().map_or(0, |l| l.memory_bytes());
            held.layers.clone_from(&layers);
        });
        if layers.is_some() {
            stored.fetched.note(self);
        }
        layers
    }

    pub(crate) fn is_loaded(&self) -> bool {
        self.read(|held| held.layers.is_some())
    }

    pub(crate) fn is_lost(&self) -> bool {
        self.read(|held| held.is_lost)
    }

    /// What it takes in memory, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        let footprints = self.footprints.as_ref().map_or(0, LayerFootprints::memory_bytes);
        footprints + self.read(|held| if held.layers.is_some() { held.bytes } else { 0 })
    }

    /// Stores what it holds, if it is not stored, and gives up the memory: how many bytes, none if the store does not take it.
    pub(crate) fn evict(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) -> usize {
        let held = self.read(Held::clone);
        let Some(layers) = held.layers else { return 0 };
        let keep = || {
            Some(Stored { id: store.put(&layers.encode())?, store: Arc::clone(store), fetched: Arc::clone(fetched) })
        };
        let Some(stored) = held.stored.or_else(keep) else { return 0 };
        self.write(|held| held.stored = Some(stored));
        self.release()
    }

    /// Gives up the memory of what is stored: how many bytes.
    fn release(&self) -> usize {
        self.write(|held| if held.stored.is_some() && held.layers.take().is_some() { held.bytes } else { 0 })
    }
}

/// Submaps that readers have fetched from the store, in that order: beyond so many bytes the earliest goes, so that a look at
/// the whole map does not take the whole map into memory.
#[derive(Debug, Default)]
pub(crate) struct Fetched {
    max_bytes: usize,
    slots: Mutex<VecDeque<Weak<Slot>>>,
}

impl Fetched {
    pub(crate) fn new(max_bytes: usize) -> Self {
        Self { max_bytes, slots: Mutex::default() }
    }

    fn note(&self, slot: &Arc<Slot>) {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|s| s.upgrade().is_some_and(|s| s.is_loaded() && !Arc::ptr_eq(&s, slot)));
        slots.push_back(Arc::downgrade(slot));
        let mut bytes: usize = slots.iter().filter_map(Weak::upgrade).map(|s| s.memory_bytes()).sum();
        while bytes > self.max_bytes && slots.len() > 1 {
            bytes -= slots.pop_front().and_then(|s| s.upgrade()).map_or(0, |s| s.release());
        }
    }
}

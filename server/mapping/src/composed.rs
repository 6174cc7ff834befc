//! A layer of the whole map, composed of the submaps' parts where and when it is read.

use crate::layer::{Footprint, Layer, Placement, TileKey, tiles_of};
use crate::layer_slot::LayerSlot;
use crate::submap_id::SubmapId;
use nalgebra::Point2;
use percept_geometry::Aabb3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What a submap says of one layer, as readers see it.
pub(crate) struct Part<L: Layer> {
    pub(crate) id: SubmapId,
    pub(crate) place: Placement,
    /// Around what it says, map frame.
    pub(crate) bounds: Aabb3,
    pub(crate) slot: Arc<LayerSlot<L>>,
    pub(crate) is_frozen: bool,
}

/// What is laid over all submaps.
struct Top<L: Layer> {
    layer: L,
    /// By which it is laid over them.
    params: L::Params,
    footprint: Footprint,
}

/// When a tile changed last: versions of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Changed {
    at_all: u64,
    /// By anything but the submap that is being filled.
    under_active: u64,
}

/// A layer of the map at one moment, immutable; cloning costs some references.
///
/// Nothing is composed before it is read. Composed tiles are kept, and shared with the moments before and after as long
/// as no submap under them has changed or moved: also while those submaps are out of memory.
#[derive(Clone)]
pub struct Composed<L: Layer> {
    params: L::Params,
    version: u64,
    parts: Arc<Vec<Part<L>>>,
    changed: Arc<BTreeMap<TileKey, Changed>>,
    kept: Arc<Kept<L>>,
    top: Option<Arc<Top<L>>>,
}

/// Composed tiles, shared by all moments of a map.
struct Kept<L: Layer> {
    tiles: Mutex<BTreeMap<TileKey, KeptTile<L>>>,
}

struct KeptTile<L: Layer> {
    version: u64,
    tile: Option<Arc<L::Tile>>,
    /// What lies under the submap that is being filled, and its version.
    under: Option<(u64, Arc<L::Under>)>,
}

/// Tiles that are composed together lie within a square of so many along an edge: a submap that reaches over several of them is
/// fetched once for all. What they hold until they are done is in memory beside the budget.
const TOGETHER: i32 = 8;

/// A tile that is wanted.
enum Begun<L: Layer> {
    /// It is kept; none if nothing is known of it.
    Kept(Option<Arc<L::Tile>>),
    Open(Composing<L>),
}

/// A tile that is being composed.
struct Composing<L: Layer> {
    /// Which one of those that are wanted.
    at: usize,
    key: TileKey,
    changed: Changed,
    /// What lies under the submap that is being filled, if that is kept.
    under: Option<Arc<L::Under>>,
    /// The same while it is gathered.
    frozen: L::Under,
    /// Whether no part is missing.
    is_whole: bool,
}

impl<L: Layer> Clone for KeptTile<L> {
    fn clone(&self) -> Self {
        Self { version: self.version, tile: self.tile.clone(), under: self.under.clone() }
    }
}

impl<L: Layer> KeptTile<L> {
    fn bytes(&self) -> usize {
        let (tile, under) =
            (self.tile.as_ref().map(|t| L::tile_bytes(t)), self.under.as_ref().map(|u| L::under_bytes(&u.1)));
        size_of::<Self>() + tile.unwrap_or(0) + under.unwrap_or(0)
    }
}

impl<L: Layer> Kept<L> {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<TileKey, KeptTile<L>>> {
        // Each entry is whole whoever stopped where.
        self.tiles.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<L: Layer> Composed<L> {
    pub(crate) fn new(params: &L::Params) -> Self {
        let kept = Arc::new(Kept { tiles: Mutex::default() });
        Self { params: *params, version: 0, parts: Arc::default(), changed: Arc::default(), kept, top: None }
    }

    /// The map's version.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Parameters.
    pub fn params(&self) -> &L::Params {
        &self.params
    }

    /// The version at which a tile changed last; 0 if nothing was ever known of it.
    pub fn changed_at(&self, key: TileKey) -> u64 {
        self.changed.get(&key).map_or(0, |c| c.at_all)
    }

    /// Tiles that may be other ones than at an earlier version, in order.
    pub fn changed_since(&self, version: u64) -> impl Iterator<Item = TileKey> {
        self.changed.iter().filter(move |(_, c)| c.at_all > version).map(|(key, _)| *key)
    }

    /// Tiles in which something may be known, in order.
    pub fn tile_keys(&self) -> impl Iterator<Item = TileKey> {
        self.changed_since(0)
    }

    /// Those of them from `low` to `high`, both included.
    pub fn tile_keys_within(&self, low: TileKey, high: TileKey) -> impl Iterator<Item = TileKey> {
        let columns = if low <= high { Some(self.changed.range(low..=high)) } else { None };
        columns.into_iter().flatten().map(|(key, _)| *key).filter(move |key| (low.1..=high.1).contains(&key.1))
    }

    /// A composed tile; none if nothing is known of it.
    pub fn tile(&self, key: TileKey) -> Option<Arc<L::Tile>> {
        self.compose(&[key]).pop().flatten()
    }

    /// Composed tiles of some keys in the given order, those of which nothing is known left out. Work runs on the current
    /// rayon pool.
    pub fn tiles(&self, keys: impl Iterator<Item = TileKey>) -> Vec<(TileKey, Arc<L::Tile>)> {
        let mut keys: Vec<(usize, TileKey)> = keys.enumerate().collect();
        let square = |key: &(usize, TileKey)| (key.1.0.div_euclid(TOGETHER), key.1.1.div_euclid(TOGETHER));
        keys.sort_by_key(square);
        let mut found = Vec::with_capacity(keys.len());
        for together in keys.chunk_by(|a, b| square(a) == square(b)) {
            let wanted: Vec<TileKey> = together.iter().map(|(_, key)| *key).collect();
            let tiles = together.iter().zip(self.compose(&wanted));
            found.extend(tiles.filter_map(|(at, tile)| Some((*at, tile?))));
        }
        found.sort_by_key(|((at, _), _)| *at);
        found.into_iter().map(|((_, key), tile)| (key, tile)).collect()
    }

    /// Tiles of some keys, one a key. Those that are not kept are composed submap by submap, so that each is fetched once.
    fn compose(&self, keys: &[TileKey]) -> Vec<Option<Arc<L::Tile>>> {
        let begun: Vec<Begun<L>> = keys.iter().map(|key| self.begin(*key)).collect();
        let mut composing: Vec<Composing<L>> = vec![];
        let mut tiles = vec![None; keys.len()];
        for (at, begun) in begun.into_iter().enumerate() {
            match begun {
                Begun::Kept(tile) => tiles[at] = tile,
                Begun::Open(tile) => composing.push(Composing { at, ..tile }),
            }
        }
        for part in self.parts.iter().filter(|p| p.is_frozen) {
            let is_under = |t: &&mut Composing<L>| t.under.is_none() && self.is_over(part, t.key);
            let over: Vec<_> = composing.iter_mut().filter(is_under).collect();
            if over.is_empty() {
                continue;
            }
            let layer = part.slot.get();
            over.into_par_iter().for_each(|tile| match &layer {
                Some(layer) => layer.overlay(&self.params, &part.place, tile.key, &mut tile.frozen),
                None => tile.is_whole = false,
            });
        }
        let finished: Vec<_> = composing.into_par_iter().map(|tile| (tile.at, self.finish(tile))).collect();
        finished.into_iter().for_each(|(at, tile)| tiles[at] = tile);
        tiles
    }

    /// A tile as it is kept, or what is kept of it.
    fn begin(&self, key: TileKey) -> Begun<L> {
        let Some(&changed) = self.changed.get(&key) else { return Begun::Kept(None) };
        let mut under = None;
        if let Some(kept) = self.kept.lock().get(&key) {
            if kept.version == changed.at_all {
                return Begun::Kept(kept.tile.clone());
            }
            under = kept.under.clone().filter(|u| u.0 == changed.under_active).map(|u| u.1);
        }
        let frozen = L::unknown(&self.params, key);
        Begun::Open(Composing { at: 0, key, changed, under, frozen, is_whole: true })
    }

    /// Whether a part may say anything in a tile.
    fn is_over(&self, part: &Part<L>, key: TileKey) -> bool {
        let edge = L::tile_edge_m(&self.params);
        let is_within =
            |(low, high): (TileKey, TileKey)| (low.0..=high.0).contains(&key.0) && (low.1..=high.1).contains(&key.1);
        let footprint = part.slot.footprint();
        tiles_of(edge, &part.bounds).is_some_and(is_within)
            && footprint.is_none_or(|footprint| footprint.reaches(edge, &part.place, &part.bounds, key))
    }

    /// Lays the submap that is being filled over a tile, and keeps it.
    fn finish(&self, tile: Composing<L>) -> Option<Arc<L::Tile>> {
        let Composing { key, changed, under, frozen, mut is_whole, .. } = tile;
        let under = under.unwrap_or_else(|| Arc::new(frozen));
        let active = self.parts.last().filter(|p| !p.is_frozen && self.is_over(p, key));
        let top = self.top.as_ref().filter(|top| top.footprint.holds(key));
        let tile = if active.is_none() && top.is_none() {
            L::finish(&self.params, key, &under)
        } else {
            let mut all = L::Under::clone(&under);
            match active.map(|active| (active.slot.get(), active)) {
                Some((Some(layer), active)) => layer.overlay(&self.params, &active.place, key, &mut all),
                Some((None, _)) => is_whole = false,
                None => {}
            }
            if let Some(top) = top {
                top.layer.overlay(&top.params, &Placement::of_map(), key, &mut all);
            }
            L::finish(&self.params, key, &all)
        };
        let tile = tile.map(Arc::new);
        let mut tiles = self.kept.lock();
        // What is missing may be had the next time.
        if is_whole && tiles.get(&key).is_none_or(|k| k.version < changed.at_all) {
            let under = active.map(|_| (changed.under_active, under));
            tiles.insert(key, KeptTile { version: changed.at_all, tile: tile.clone(), under });
        }
        tile
    }

    /// Submaps that could not be read when they were needed: what they hold is missing here.
    pub fn missing(&self) -> Vec<SubmapId> {
        self.parts.iter().filter(|p| p.slot.is_lost()).map(|p| p.id).collect()
    }

    /// What the kept tiles take, bytes.
    pub(crate) fn kept_bytes(&self) -> usize {
        self.kept.lock().values().map(KeptTile::bytes).sum()
    }

    /// Gives up kept tiles until the rest takes no more than so many bytes, those that are farthest from a place first.
    pub(crate) fn forget_beyond(&self, here: Point2<f64>, max_bytes: usize) {
        let edge = L::tile_edge_m(&self.params);
        let distance = |key: &TileKey| {
            let center = Point2::new(f64::from(key.0) + 0.5, f64::from(key.1) + 0.5) * edge;
            (center - here).norm()
        };
        let mut tiles = self.kept.lock();
        let mut by_distance: Vec<(f64, TileKey, usize)> =
            tiles.iter().map(|(key, kept)| (distance(key), *key, kept.bytes())).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut bytes: usize = by_distance.iter().map(|b| b.2).sum();
        while let Some((_, key, of_tile)) = by_distance.pop().filter(|_| bytes > max_bytes) {
            tiles.remove(&key);
            bytes -= of_tile;
        }
    }

    /// Notes that something changed within a box of the map.
    pub(crate) fn touch(&mut self, version: u64, b: &Aabb3, by_active: bool) {
        let Some((low, high)) = tiles_of(L::tile_edge_m(&self.params), b) else { return };
        let changed = Arc::make_mut(&mut self.changed);
        for key in (low.0..=high.0).flat_map(|x| (low.1..=high.1).map(move |y| (x, y))) {
            let entry = changed.entry(key).or_default();
            entry.at_all = version;
            if !by_active {
                entry.under_active = version;
            }
        }
    }

    /// Notes that what was being filled within a box of the map lies under what is filled from now on: tiles stay as they
    /// are.
    pub(crate) fn lay_under(&mut self, version: u64, b: &Aabb3) {
        let Some((low, high)) = tiles_of(L::tile_edge_m(&self.params), b) else { return };
        let mut tiles = self.kept.lock();
        let changed = Arc::make_mut(&mut self.changed);
        for key in (low.0..=high.0).flat_map(|x| (low.1..=high.1).map(move |y| (x, y))) {
            changed.entry(key).or_default().under_active = version;
            tiles.entry(key).and_modify(|k| k.under = None);
        }
    }

    /// This moment with something laid over it that is in no submap: a part of the map's own frame, laid over it by
    /// parameters of its own. `touched` is where it says anything.
    pub(crate) fn under(&self, layer: L, params: L::Params, touched: &Aabb3) -> Self {
        let tiles = self.kept.lock().clone();
        let kept = Arc::new(Kept { tiles: Mutex::new(tiles) });
        let footprint = layer.footprint(&self.params);
        let mut out = Self { kept, top: Some(Arc::new(Top { layer, params, footprint })), ..self.clone() };
        out.touch(self.version + 1, touched, true);
        out
    }

    /// The next moment.
    pub(crate) fn set(&mut self, version: u64, parts: Vec<Part<L>>) {
        (self.version, self.parts) = (version, Arc::new(parts));
    }
}

/// The same tiles.
impl<L: Layer> PartialEq for Composed<L> {
    fn eq(&self, other: &Self) -> bool {
        let known = |c: &Self| c.tiles(c.tile_keys());
        let (a, b) = (known(self), known(other));
        a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| a.0 == b.0 && *a.1 == *b.1)
    }
}

impl<L: Layer> std::fmt::Debug for Composed<L> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (version, submaps, tiles) = (self.version, self.parts.len(), self.changed.len());
        write!(f, "Composed {{ version: {version}, submaps: {submaps}, tiles: {tiles} }}")
    }
}

//! Which layers a map has: a further one is a line in each list here.

use crate::composed::Part;
use crate::distance::DistanceCache;
use crate::layer::Layer;
use crate::layer_slot::{Evictable, Fetched, LayerSlot};
use crate::store::MapStore;
use crate::{CloudMap, FusedCloud, MapParams, OccupancyGrid, OccupancyMap, SubmapId, VoxelGrid, VoxelMap};
use nalgebra::Point2;
use percept_geometry::{Aabb3, KeyframeScan, Pose};
use std::sync::Arc;

/// The layers of the whole map at one moment, immutable; cloning costs a few references.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLayers {
    /// Rises with every change of the map; never falls, not even when a correction is undone.
    pub version: u64,
    /// Free, occupied, unknown.
    pub occupancy: OccupancyMap,
    /// Coloured points.
    pub cloud: CloudMap,
    /// Free, occupied, unknown in three dimensions; of nothing unless it is enabled.
    pub voxels: VoxelMap,
    pub(crate) grid_distances: DistanceCache,
    pub(crate) voxel_distances: DistanceCache,
}

/// What a submap holds of each layer, in its own frame.
#[derive(Debug, Clone)]
pub struct SubmapLayers {
    pub(crate) occupancy: OccupancyGrid,
    pub(crate) cloud: FusedCloud,
    pub(crate) voxels: VoxelGrid,
}

/// A box for each layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerBoxes {
    pub(crate) occupancy: Aabb3,
    pub(crate) cloud: Aabb3,
    pub(crate) voxels: Aabb3,
}

/// The layers of a submap, each in memory or to be had from the store.
#[derive(Debug)]
pub struct LayerSlots {
    pub(crate) occupancy: Arc<LayerSlot<OccupancyGrid>>,
    pub(crate) cloud: Arc<LayerSlot<FusedCloud>>,
    pub(crate) voxels: Arc<LayerSlot<VoxelGrid>>,
}

impl LayerSlots {
    /// Of layers that are being filled.
    pub(crate) fn new(params: &MapParams, layers: &SubmapLayers) -> Self {
        Self::of(params, layers, false)
    }

    /// Of layers to which nothing is added any more.
    pub(crate) fn frozen(params: &MapParams, layers: &SubmapLayers) -> Self {
        Self::of(params, layers, true)
    }

    fn of(params: &MapParams, layers: &SubmapLayers, is_frozen: bool) -> Self {
        Self {
            occupancy: Arc::new(LayerSlot::new(&params.occupancy, &layers.occupancy, is_frozen)),
            cloud: Arc::new(LayerSlot::new(&params.cloud, &layers.cloud, is_frozen)),
            voxels: Arc::new(LayerSlot::new(&params.voxels, &layers.voxels, is_frozen)),
        }
    }

    fn all(&self) -> [&dyn Evictable; 3] {
        [&*self.occupancy, &*self.cloud, &*self.voxels]
    }

    /// Fetches what is out of memory; whether all is there then.
    pub(crate) fn load(&self) -> bool {
        let (occupancy, cloud, voxels) = (self.occupancy.get(), self.cloud.get(), self.voxels.get());
        occupancy.is_some() && cloud.is_some() && voxels.is_some()
    }

    pub(crate) fn is_loaded(&self) -> bool {
        self.all().iter().all(|slot| slot.is_loaded())
    }

    /// Whether one of them could not be had when it was wanted.
    pub(crate) fn is_lost(&self) -> bool {
        self.occupancy.is_lost() || self.cloud.is_lost() || self.voxels.is_lost()
    }

    /// What they take in memory, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.all().iter().map(|slot| slot.memory_bytes()).sum()
    }

    /// Stores what is not stored, and gives up the memory: how many bytes, none of what the store does not take.
    pub(crate) fn evict(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) -> usize {
        self.occupancy.evict(store, fetched) + self.cloud.evict(store, fetched) + self.voxels.evict(store, fetched)
    }
}

/// What one keyframe says about every layer.
pub(crate) struct LayersUpdate {
    occupancy: <OccupancyGrid as Layer>::Update,
    cloud: <FusedCloud as Layer>::Update,
    voxels: <VoxelGrid as Layer>::Update,
}

impl LayersUpdate {
    pub(crate) fn new(params: &MapParams, t_submap_base: &Pose, scan: &KeyframeScan) -> Self {
        let (occupancy, cloud) = rayon::join(
            || OccupancyGrid::prepare(&params.occupancy, t_submap_base, scan),
            || <FusedCloud as Layer>::prepare(&params.cloud, t_submap_base, scan),
        );
        let voxels = VoxelGrid::prepare(&params.voxels, t_submap_base, scan);
        Self { occupancy, cloud, voxels }
    }

    pub(crate) fn touched(&self, params: &MapParams) -> LayerBoxes {
        LayerBoxes {
            occupancy: OccupancyGrid::touched(&params.occupancy, &self.occupancy),
            cloud: FusedCloud::touched(&params.cloud, &self.cloud),
            voxels: VoxelGrid::touched(&params.voxels, &self.voxels),
        }
    }
}

impl SubmapLayers {
    pub(crate) fn new(params: &MapParams) -> Self {
        Self {
            occupancy: Layer::new(&params.occupancy),
            cloud: Layer::new(&params.cloud),
            voxels: Layer::new(&params.voxels),
        }
    }

    pub(crate) fn add(&mut self, update: &LayersUpdate) {
        rayon::join(|| self.occupancy.add(&update.occupancy), || self.cloud.add(&update.cloud));
        self.voxels.add(&update.voxels);
    }

    pub(crate) fn freeze(&mut self) {
        self.occupancy.freeze();
        self.cloud.freeze();
        self.voxels.freeze();
    }
}

impl LayerBoxes {
    pub(crate) fn empty() -> Self {
        Self { occupancy: Aabb3::empty(), cloud: Aabb3::empty(), voxels: Aabb3::empty() }
    }

    pub(crate) fn map(&self, f: impl Fn(&Aabb3) -> Aabb3) -> Self {
        Self { occupancy: f(&self.occupancy), cloud: f(&self.cloud), voxels: f(&self.voxels) }
    }

    pub(crate) fn joined(&self, other: &Self) -> Self {
        use crate::layer::joined;
        Self {
            occupancy: joined(&self.occupancy, &other.occupancy),
            cloud: joined(&self.cloud, &other.cloud),
            voxels: joined(&self.voxels, &other.voxels),
        }
    }
}

impl MapLayers {
    pub(crate) fn empty(params: &MapParams) -> Self {
        Self {
            version: 0,
            occupancy: OccupancyMap::new(&params.occupancy),
            cloud: CloudMap::new(&params.cloud),
            voxels: VoxelMap::new(&params.voxels),
            grid_distances: DistanceCache::default(),
            voxel_distances: DistanceCache::default(),
        }
    }

    /// Notes a change within boxes of the map.
    pub(crate) fn touch(&mut self, version: u64, boxes: &LayerBoxes, by_active: bool) {
        self.occupancy.touch(version, &boxes.occupancy, by_active);
        self.cloud.touch(version, &boxes.cloud, by_active);
        self.voxels.touch(version, &boxes.voxels, by_active);
    }

    /// Notes that what was being filled within boxes of the map lies under what is filled from now on.
    pub(crate) fn lay_under(&mut self, version: u64, boxes: &LayerBoxes) {
        self.occupancy.lay_under(version, &boxes.occupancy);
        self.cloud.lay_under(version, &boxes.cloud);
        self.voxels.lay_under(version, &boxes.voxels);
    }

    /// The next moment.
    pub(crate) fn set(&mut self, version: u64, parts: &Arc<Vec<Part>>) {
        self.version = version;
        self.occupancy.set(version, parts);
        self.cloud.set(version, parts);
        self.voxels.set(version, parts);
    }

    /// Gives up composed tiles until the rest takes no more than so many bytes, those that are farthest from a place first: they
    /// are composed anew when they are read.
    pub(crate) fn forget_beyond(&self, here: Point2<f64>, max_bytes: usize) {
        if self.kept_bytes() > max_bytes {
            self.grid_distances.forget();
            self.voxel_distances.forget();
        }
        let (all, occupancy) = (self.kept_bytes(), self.occupancy.kept_bytes());
        let (cloud, voxels) = (self.cloud.kept_bytes(), self.voxels.kept_bytes());
        let share = |bytes: usize| (max_bytes as f64 * bytes as f64 / all.max(1) as f64) as usize;
        if all > max_bytes {
            self.occupancy.forget_beyond(here, share(occupancy));
            self.cloud.forget_beyond(here, share(cloud));
            self.voxels.forget_beyond(here, share(voxels));
        }
    }

    pub(crate) fn kept_bytes(&self) -> usize {
        let layers = self.occupancy.kept_bytes() + self.cloud.kept_bytes() + self.voxels.kept_bytes();
        layers + self.grid_distances.kept_bytes() + self.voxel_distances.kept_bytes()
    }

    /// Submaps that could not be read when they were needed: what they hold is missing.
    pub fn missing(&self) -> Vec<SubmapId> {
        let mut missing = [self.occupancy.missing(), self.cloud.missing(), self.voxels.missing()].concat();
        missing.sort_unstable();
        missing.dedup();
        missing
    }
}

//! Which layers a map has: a further one is a line in the list at the end of this file, and a field of [`MapParams`].

use crate::composed::{self, Composed};
use crate::distance::DistanceCache;
use crate::error::check;
use crate::keyframe_view::KeyframeView;
use crate::layer::{Layer, Placement, joined};
use crate::layer_slot::{Evictable, Fetched, LayerSlot};
use crate::params::MapParams;
use crate::store::MapStore;
use crate::submap_id::SubmapId;
use crate::{FusedCloud, HeightGrid, MappingError, OccupancyGrid, SurfaceGrid, VoxelGrid};
use nalgebra::Point2;
use percept_geometry::Aabb3;
use std::sync::Arc;

/// What is done with each layer of the list, in its order.
macro_rules! layers {
    ($($(#[$doc:meta])* $name:ident: $layer:ty,)*) => {
        /// The layers of the whole map at one moment, immutable; cloning costs a few references.
        #[derive(Debug, Clone, PartialEq)]
        pub struct MapLayers {
            /// Rises with every change of the map; never falls, not even when a correction is undone.
            pub version: u64,
            $($(#[$doc])* pub $name: Composed<$layer>,)*
            pub(crate) grid_distances: DistanceCache,
            pub(crate) voxel_distances: DistanceCache,
        }

        /// What a submap holds of each layer, in its own frame.
        #[derive(Debug, Clone)]
        pub struct SubmapLayers {
            $(pub(crate) $name: $layer,)*
        }

        /// A box for each layer.
        #[derive(Debug, Clone, PartialEq)]
        pub struct LayerBoxes {
            $(pub(crate) $name: Aabb3,)*
        }

        /// The layers of a submap, each in memory or to be had from the store.
        #[derive(Debug)]
        pub struct LayerSlots {
            $(pub(crate) $name: Arc<LayerSlot<$layer>>,)*
        }

        impl LayerSlots {
            fn of(params: &MapParams, layers: &SubmapLayers, is_frozen: bool) -> Self {
                Self { $($name: Arc::new(LayerSlot::new(&params.$name, &layers.$name, is_frozen)),)* }
            }

            fn all(&self) -> impl Iterator<Item = &dyn Evictable> {
                [$(&*self.$name as &dyn Evictable),*].into_iter()
            }

            /// Fetches what is out of memory; whether all is there then.
            pub(crate) fn load(&self) -> bool {
                // All, also after one that cannot be had.
                [$(self.$name.get().is_some()),*].iter().all(|is_there| *is_there)
            }

            /// Whether one of them could not be had when it was wanted.
            pub(crate) fn is_lost(&self) -> bool {
                [$(self.$name.is_lost()),*].iter().any(|is_lost| *is_lost)
            }

            /// Stores what is not stored; all stays in memory.
            pub(crate) fn store(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) {
                $(self.$name.store(store, fetched);)*
            }

            /// Whether they hold anything that is not stored.
            pub(crate) fn is_unstored(&self) -> bool {
                [$(self.$name.is_unstored()),*].iter().any(|is_unstored| *is_unstored)
            }

            /// Stores what is not stored, and gives up the memory: how many bytes, none of what the store does not take.
            pub(crate) fn evict(&self, store: &Arc<dyn MapStore>, fetched: &Arc<Fetched>) -> usize {
                [$(self.$name.evict(store, fetched)),*].iter().sum()
            }
        }

        /// What one keyframe says about every layer.
        #[derive(Default)]
        pub(crate) struct LayersUpdate {
            // None while it is being prepared.
            $($name: Option<<$layer as Layer>::Update>,)*
        }

        impl LayersUpdate {
            /// Of a keyframe; layers are worked on side by side.
            pub(crate) fn new(params: &MapParams, view: &KeyframeView<'_>) -> Self {
                let mut out = Self::default();
                rayon::scope(|scope| {
                    $(
                        let slot = &mut out.$name;
                        scope.spawn(move |_| {
                            *slot = Some(<$layer as Layer>::prepare(&params.$name, view));
                        });
                    )*
                });
                out
            }

            pub(crate) fn touched(&self, params: &MapParams) -> LayerBoxes {
                let mut out = LayerBoxes::empty();
                $(if let Some(update) = &self.$name {
                    out.$name = <$layer as Layer>::touched(&params.$name, update);
                })*
                out
            }
        }

        impl SubmapLayers {
            pub(crate) fn new(params: &MapParams) -> Self {
                Self { $($name: <$layer as Layer>::new(&params.$name),)* }
            }

            /// Adds an update, to the layers side by side.
            pub(crate) fn add(&mut self, update: &LayersUpdate) {
                rayon::scope(|scope| {
                    $(if let Some(update) = &update.$name {
                        let layer = &mut self.$name;
                        scope.spawn(move |_| Layer::add(layer, update));
                    })*
                });
            }

            pub(crate) fn freeze(&mut self) {
                $(Layer::freeze(&mut self.$name);)*
            }
        }

        impl LayerBoxes {
            pub(crate) fn empty() -> Self {
                Self { $($name: Aabb3::empty(),)* }
            }

            pub(crate) fn map(&self, f: impl Fn(&Aabb3) -> Aabb3) -> Self {
                Self { $($name: f(&self.$name),)* }
            }

            pub(crate) fn joined(&self, other: &Self) -> Self {
                Self { $($name: joined(&self.$name, &other.$name),)* }
            }
        }

        impl MapParams {
            /// Checks every field.
            ///
            /// # Errors
            /// `InvalidParam` naming field, value and remedy.
            pub fn validate(&self) -> Result<(), MappingError> {
                $(self.$name.validate()?;)*
                check("time_to_live_s", self.time_to_live_s, 0.0, 1e9, "choose 0 to 1e9")
            }

            /// What cells and voxels that do not lie on the map's may reach beyond their submap's box, metres.
            pub(crate) fn margin_m(&self) -> f64 {
                [$(<$layer as Layer>::cell_m(&self.$name)),*].into_iter().fold(0.0, f64::max)
            }

            /// How far from a sensor any layer keeps what was seen, metres.
            pub(crate) fn range_max_m(&self) -> f64 {
                [$(<$layer as Layer>::range_max_m(&self.$name)),*].into_iter().fold(0.0, f64::max)
            }
        }

        impl MapLayers {
            pub(crate) fn empty(params: &MapParams) -> Self {
                Self {
                    version: 0,
                    $($name: Composed::new(&params.$name),)*
                    grid_distances: DistanceCache::default(),
                    voxel_distances: DistanceCache::default(),
                }
            }

            /// Notes a change within boxes of the map.
            pub(crate) fn touch(&mut self, version: u64, boxes: &LayerBoxes, by_active: bool) {
                $(self.$name.touch(version, &boxes.$name, by_active);)*
            }

            /// Notes that what was being filled within boxes of the map lies under what is filled from now on.
            pub(crate) fn lay_under(&mut self, version: u64, boxes: &LayerBoxes) {
                $(self.$name.lay_under(version, &boxes.$name);)*
            }

            /// The next moment.
            pub(crate) fn set(&mut self, version: u64, parts: &[Part]) {
                self.version = version;
                $({
                    let of_layer = parts.iter().map(|p| composed::Part {
                        id: p.id,
                        place: p.place,
                        bounds: p.boxes.$name,
                        slot: Arc::clone(&p.slots.$name),
                        is_frozen: p.is_frozen,
                    });
                    self.$name.set(version, of_layer.collect());
                })*
            }

            fn composed_bytes(&self) -> usize {
                [$(self.$name.kept_bytes()),*].iter().sum()
            }

            /// Gives up composed tiles until the rest takes no more than so many bytes, those that are farthest from a place
            /// first: they are composed anew when they are read.
            pub(crate) fn forget_beyond(&self, here: Point2<f64>, max_bytes: usize) {
                if self.kept_bytes() > max_bytes {
                    self.grid_distances.forget();
                    self.voxel_distances.forget();
                }
                let all = self.composed_bytes();
                if all > max_bytes {
                    let share = |bytes: usize| (max_bytes as f64 * bytes as f64 / all as f64) as usize;
                    $(self.$name.forget_beyond(here, share(self.$name.kept_bytes()));)*
                }
            }

            /// Submaps that could not be read when they were needed: what they hold is missing.
            pub fn missing(&self) -> Vec<SubmapId> {
                let mut missing = [$(self.$name.missing()),*].concat();
                missing.sort_unstable();
                missing.dedup();
                missing
            }
        }
    };
}

/// A submap as readers see it.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) id: SubmapId,
    pub(crate) place: Placement,
    /// Map frame.
    pub(crate) boxes: LayerBoxes,
    pub(crate) slots: Arc<LayerSlots>,
    pub(crate) is_frozen: bool,
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

    pub(crate) fn is_loaded(&self) -> bool {
        self.all().all(|slot| slot.is_loaded())
    }

    /// What they take in memory, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.all().map(|slot| slot.memory_bytes()).sum()
    }
}

impl MapLayers {
    pub(crate) fn kept_bytes(&self) -> usize {
        self.composed_bytes() + self.grid_distances.kept_bytes() + self.voxel_distances.kept_bytes()
    }
}

layers! {
    /// Free, occupied, unknown.
    occupancy: OccupancyGrid,
    /// Coloured points.
    cloud: FusedCloud,
    /// Free, occupied, unknown in three dimensions; of nothing unless it is enabled.
    voxels: VoxelGrid,
    /// Ground, what stands on it, where a robot can drive; of nothing unless it is enabled.
    height: HeightGrid,
    /// Distances to the surface, and its mesh; of nothing unless it is enabled.
    surface: SurfaceGrid,
}

//! Which layers a map has: a further one is a line in each list here.

use crate::bytes::{Damaged, Reader};
use crate::composed::Part;
use crate::layer::{Footprint, Layer};
use crate::{CloudMap, FusedCloud, MapParams, OccupancyGrid, OccupancyMap, SubmapId};
use nalgebra::Point2;
use percept_geometry::{Aabb3, KeyframeScan, Pose};
use std::sync::Arc;

/// First bytes of a stored submap; the number is that of the layout.
const MAGIC: &[u8; 4] = b"PSM1";

/// The layers of the whole map at one moment, immutable; cloning costs a few references.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLayers {
    /// Rises with every change of the map; never falls, not even when a correction is undone.
    pub version: u64,
    /// Free, occupied, unknown.
    pub occupancy: OccupancyMap,
    /// Coloured points.
    pub cloud: CloudMap,
}

/// What a submap holds of each layer, in its own frame.
#[derive(Debug, Clone)]
pub struct SubmapLayers {
    pub(crate) occupancy: OccupancyGrid,
    pub(crate) cloud: FusedCloud,
}

/// A box for each layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerBoxes {
    pub(crate) occupancy: Aabb3,
    pub(crate) cloud: Aabb3,
}

/// Where each layer of a submap says anything.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LayerFootprints {
    pub(crate) occupancy: Footprint,
    pub(crate) cloud: Footprint,
}

impl LayerFootprints {
    pub(crate) fn memory_bytes(&self) -> usize {
        self.occupancy.memory_bytes() + self.cloud.memory_bytes()
    }
}

/// What one keyframe says about every layer.
pub(crate) struct LayersUpdate {
    occupancy: <OccupancyGrid as Layer>::Update,
    cloud: <FusedCloud as Layer>::Update,
}

impl LayersUpdate {
    pub(crate) fn new(params: &MapParams, t_submap_base: &Pose, scan: &KeyframeScan) -> Self {
        Self {
            occupancy: OccupancyGrid::prepare(&params.occupancy, t_submap_base, scan),
            cloud: <FusedCloud as Layer>::prepare(&params.cloud, t_submap_base, scan),
        }
    }

    pub(crate) fn touched(&self, params: &MapParams) -> LayerBoxes {
        LayerBoxes {
            occupancy: OccupancyGrid::touched(&params.occupancy, &self.occupancy),
            cloud: FusedCloud::touched(&params.cloud, &self.cloud),
        }
    }
}

impl SubmapLayers {
    pub(crate) fn new(params: &MapParams) -> Self {
        Self { occupancy: Layer::new(&params.occupancy), cloud: Layer::new(&params.cloud) }
    }

    pub(crate) fn add(&mut self, update: &LayersUpdate) {
        self.occupancy.add(&update.occupancy);
        self.cloud.add(&update.cloud);
    }

    pub(crate) fn freeze(&mut self) {
        self.occupancy.freeze();
        self.cloud.freeze();
    }

    pub(crate) fn footprints(&self, params: &MapParams) -> LayerFootprints {
        LayerFootprints {
            occupancy: self.occupancy.footprint(&params.occupancy),
            cloud: self.cloud.footprint(&params.cloud),
        }
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        Layer::memory_bytes(&self.occupancy) + Layer::memory_bytes(&self.cloud)
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        self.occupancy.encode(&mut out);
        self.cloud.encode(&mut out);
        out
    }

    pub(crate) fn decode(params: &MapParams, bytes: &[u8]) -> Result<Self, Damaged> {
        let mut from = Reader::new(bytes.strip_prefix(MAGIC).ok_or(Damaged)?);
        let occupancy = Layer::decode(&params.occupancy, &mut from)?;
        let cloud = Layer::decode(&params.cloud, &mut from)?;
        if from.is_at_end() { Ok(Self { occupancy, cloud }) } else { Err(Damaged) }
    }
}

impl LayerBoxes {
    pub(crate) fn empty() -> Self {
        Self { occupancy: Aabb3::empty(), cloud: Aabb3::empty() }
    }

    pub(crate) fn map(&self, f: impl Fn(&Aabb3) -> Aabb3) -> Self {
        Self { occupancy: f(&self.occupancy), cloud: f(&self.cloud) }
    }

    pub(crate) fn joined(&self, other: &Self) -> Self {
        use crate::layer::joined;
        Self { occupancy: joined(&self.occupancy, &other.occupancy), cloud: joined(&self.cloud, &other.cloud) }
    }
}

impl MapLayers {
    pub(crate) fn empty(params: &MapParams) -> Self {
        Self { version: 0, occupancy: OccupancyMap::new(&params.occupancy), cloud: CloudMap::new(&params.cloud) }
    }

    /// Notes a change within boxes of the map.
    pub(crate) fn touch(&mut self, version: u64, boxes: &LayerBoxes, by_active: bool) {
        self.occupancy.touch(version, &boxes.occupancy, by_active);
        self.cloud.touch(version, &boxes.cloud, by_active);
    }

    /// Notes that what was being filled within boxes of the map lies under what is filled from now on.
    pub(crate) fn lay_under(&mut self, version: u64, boxes: &LayerBoxes) {
        self.occupancy.lay_under(version, &boxes.occupancy);
        self.cloud.lay_under(version, &boxes.cloud);
    }

    /// The next moment.
    pub(crate) fn set(&mut self, version: u64, parts: &Arc<Vec<Part>>) {
        self.version = version;
        self.occupancy.set(version, parts);
        self.cloud.set(version, parts);
    }

    /// Gives up composed tiles until the rest takes no more than so many bytes, those that are farthest from a place first: they
    /// are composed anew when they are read.
    pub(crate) fn forget_beyond(&self, here: Point2<f64>, max_bytes: usize) {
        let (occupancy, cloud) = (self.occupancy.kept_bytes(), self.cloud.kept_bytes());
        let share = |bytes: usize| (max_bytes as f64 * bytes as f64 / (occupancy + cloud).max(1) as f64) as usize;
        if occupancy + cloud > max_bytes {
            self.occupancy.forget_beyond(here, share(occupancy));
            self.cloud.forget_beyond(here, share(cloud));
        }
    }

    pub(crate) fn kept_bytes(&self) -> usize {
        self.occupancy.kept_bytes() + self.cloud.kept_bytes()
    }

    /// Submaps that could not be read when they were needed: what they hold is missing.
    pub fn missing(&self) -> Vec<SubmapId> {
        self.occupancy.missing()
    }
}

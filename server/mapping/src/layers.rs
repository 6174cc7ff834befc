//! What a map is made of besides its keyframes.

use crate::cloud::CloudUpdate;
use crate::occupancy::ScanUpdate;
use crate::{FusedCloud, MapKeyframe, MapParams, MappingError, OccupancyGrid};

/// An immutable picture of the layers; cloning costs two references.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLayers {
    /// Rises with every change of the map; never falls, not even when a correction is undone.
    pub version: u64,
    /// Free, occupied, unknown.
    pub occupancy: OccupancyGrid,
    /// Coloured points.
    pub cloud: FusedCloud,
}

/// What one keyframe says about every layer.
pub(crate) type LayersUpdate = (ScanUpdate, CloudUpdate);

impl MapLayers {
    pub(crate) fn empty(params: &MapParams) -> Result<Self, MappingError> {
        let (occupancy, cloud) = (OccupancyGrid::new(params.occupancy)?, FusedCloud::new(params.cloud)?);
        Ok(Self { version: 0, occupancy, cloud })
    }

    /// What a keyframe says, whatever the layers hold: many can be prepared at once.
    pub(crate) fn prepare(&self, params: &MapParams, keyframe: &MapKeyframe) -> LayersUpdate {
        let MapKeyframe { t_map_base, scan } = keyframe;
        (
            ScanUpdate::new(&params.occupancy, self.occupancy.geometry(), t_map_base, scan),
            CloudUpdate::new(&params.cloud, t_map_base, scan),
        )
    }

    pub(crate) fn add(&mut self, (occupancy, cloud): &LayersUpdate) {
        self.occupancy.apply(occupancy);
        self.cloud.apply(cloud);
    }
}

//! The rooms of a map, kept until map or objects change.

use crate::PipelineParams;
use nalgebra::Point2;
use percept_geometry::{KeyframeId, ObjectClass, Pose};
use percept_mapping::{MappingError, Occupancy, OccupancyMap};
use percept_scene::rooms::{Floor, Rooms, find_rooms};
use percept_scene::{Object, ObjectState};
use std::sync::{Arc, Mutex, PoisonError};

/// The rooms that were found last. All snapshots of a session share it.
#[derive(Debug, Clone, Default)]
pub(crate) struct DividedMap(Arc<Mutex<Option<Divided>>>);

#[derive(Debug)]
struct Divided {
    map_version: u64,
    objects: Arc<Vec<Object>>,
    params: Arc<PipelineParams>,
    rooms: Arc<Rooms>,
}

/// What rooms follow from.
pub(crate) struct Basis<'a> {
    /// Two of one session with the same have the same grid and keyframes.
    pub(crate) map_version: u64,
    pub(crate) occupancy: &'a OccupancyMap,
    pub(crate) objects: &'a Arc<Vec<Object>>,
    pub(crate) params: &'a Arc<PipelineParams>,
}

impl Divided {
    fn is_of(&self, basis: &Basis<'_>) -> bool {
        let same_objects = Arc::ptr_eq(&self.objects, basis.objects) || self.objects == *basis.objects;
        self.map_version == basis.map_version && same_objects && self.params.rooms == basis.params.rooms
    }
}

impl DividedMap {
    /// The rooms of a map with these keyframes (base to map). Who asks for the same state meanwhile waits for them.
    pub(crate) fn of<'k>(
        &self,
        basis: &Basis<'_>,
        keyframes: impl Iterator<Item = (KeyframeId, &'k Pose)>,
        max_cells: usize,
    ) -> Result<Arc<Rooms>, MappingError> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(divided) = kept.as_ref().filter(|divided| divided.is_of(basis)) {
            return Ok(Arc::clone(&divided.rooms));
        }
        let rooms = Arc::new(divided(basis, keyframes, max_cells)?);
        *kept = Some(Divided {
            map_version: basis.map_version,
            objects: Arc::clone(basis.objects),
            params: Arc::clone(basis.params),
            rooms: Arc::clone(&rooms),
        });
        Ok(rooms)
    }
}

fn divided<'k>(
    basis: &Basis<'_>,
    keyframes: impl Iterator<Item = (KeyframeId, &'k Pose)>,
    max_cells: usize,
) -> Result<Rooms, MappingError> {
    let grid = basis.occupancy.dense(max_cells)?;
    // What nobody can name may be a piece of wall.
    let is_furniture = |o: &&Object| o.state == ObjectState::Static && o.class != ObjectClass::Unknown;
    let standing = basis.objects.iter().filter(is_furniture);
    let things: Vec<_> = standing.map(|o| o.bbox).collect();
    let keyframes: Vec<_> = keyframes.map(|(id, t)| (id.0, Point2::from(t.translation.vector.xy()))).collect();
    let floor = Floor { geometry: grid.geometry, width: grid.width, height: grid.height, cells: &grid.cells };
    // Parameters were checked when they were set, and a dense grid has the shape that it says.
    Ok(find_rooms(&floor, &things, &keyframes, &basis.params.rooms).unwrap_or_default())
}

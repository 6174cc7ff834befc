//! The rooms of a map, kept until map or objects change.

use crate::PipelineParams;
use nalgebra::Point2;
use percept_geometry::{KeyframeId, ObjectClass, OrientedBox3, Pose};
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
    furniture: Vec<OrientedBox3>,
    params: Arc<PipelineParams>,
    rooms: Arc<Rooms>,
}

/// What rooms follow from.
pub(crate) struct Basis<'a> {
    /// Two of one session with the same have the same grid and keyframes.
    pub(crate) map_version: u64,
    pub(crate) occupancy: &'a OccupancyMap,
    pub(crate) objects: &'a [Object],
    pub(crate) params: &'a Arc<PipelineParams>,
}

impl Basis<'_> {
    /// What stands in rooms. What nobody can name may be a piece of wall.
    fn furniture(&self) -> Vec<OrientedBox3> {
        let is_furniture = |o: &&Object| o.state == ObjectState::Static && o.class != ObjectClass::Unknown;
        self.objects.iter().filter(is_furniture).map(|o| o.bbox).collect()
    }
}

impl Divided {
    /// Who walks by, or is seen once more, divides nothing.
    fn is_of(&self, basis: &Basis<'_>, furniture: &[OrientedBox3]) -> bool {
        let same_things = self.furniture == furniture;
        self.map_version == basis.map_version && same_things && self.params.rooms == basis.params.rooms
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
        let furniture = basis.furniture();
        if let Some(divided) = kept.as_ref().filter(|divided| divided.is_of(basis, &furniture)) {
            return Ok(Arc::clone(&divided.rooms));
        }
        let rooms = Arc::new(divided(basis, &furniture, keyframes, max_cells)?);
        *kept = Some(Divided {
            map_version: basis.map_version,
            furniture,
            params: Arc::clone(basis.params),
            rooms: Arc::clone(&rooms),
        });
        Ok(rooms)
    }
}

fn divided<'k>(
    basis: &Basis<'_>,
    furniture: &[OrientedBox3],
    keyframes: impl Iterator<Item = (KeyframeId, &'k Pose)>,
    max_cells: usize,
) -> Result<Rooms, MappingError> {
    let grid = basis.occupancy.dense(max_cells)?;
    let keyframes: Vec<_> = keyframes.map(|(id, t)| (id.0, Point2::from(t.translation.vector.xy()))).collect();
    let floor = Floor { geometry: grid.geometry, width: grid.width, height: grid.height, cells: &grid.cells };
    // Parameters were checked when they were set, and a dense grid has the shape that it says.
    Ok(find_rooms(&floor, furniture, &keyframes, &basis.params.rooms).unwrap_or_default())
}

//! The rooms of a map, kept until map or objects change.

use crate::{PipelineParams, Snapshot};
use nalgebra::Point2;
use percept_geometry::ObjectClass;
use percept_mapping::{MappingError, Occupancy};
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

impl Divided {
    fn is_of(&self, snapshot: &Snapshot) -> bool {
        let same_objects = Arc::ptr_eq(&self.objects, &snapshot.objects) || self.objects == snapshot.objects;
        self.map_version == snapshot.map_version && same_objects && self.params.rooms == snapshot.params.rooms
    }
}

impl DividedMap {
    /// The rooms of a snapshot. Who asks for the same state meanwhile waits for them.
    pub(crate) fn of(&self, snapshot: &Snapshot, max_cells: usize) -> Result<Arc<Rooms>, MappingError> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(divided) = kept.as_ref().filter(|divided| divided.is_of(snapshot)) {
            return Ok(Arc::clone(&divided.rooms));
        }
        let rooms = Arc::new(divided(snapshot, max_cells)?);
        *kept = Some(Divided {
            map_version: snapshot.map_version,
            objects: Arc::clone(&snapshot.objects),
            params: Arc::clone(&snapshot.params),
            rooms: Arc::clone(&rooms),
        });
        Ok(rooms)
    }
}

fn divided(snapshot: &Snapshot, max_cells: usize) -> Result<Rooms, MappingError> {
    let grid = snapshot.layers.occupancy.dense(max_cells)?;
    // What nobody can name may be a piece of wall.
    let is_furniture = |o: &&Object| o.state == ObjectState::Static && o.class != ObjectClass::Unknown;
    let standing = snapshot.objects.iter().filter(is_furniture);
    let things: Vec<_> = standing.map(|o| o.bbox).collect();
    let position = |t: &percept_geometry::Pose| Point2::from(t.translation.vector.xy());
    let keyframes: Vec<_> = snapshot.keyframes.iter().map(|k| (k.id.0, position(&k.t_map_base))).collect();
    let floor = Floor { geometry: grid.geometry, width: grid.width, height: grid.height, cells: &grid.cells };
    // Parameters were checked when they were set, and a dense grid has the shape that it says.
    Ok(find_rooms(&floor, &things, &keyframes, &snapshot.params.rooms).unwrap_or_default())
}

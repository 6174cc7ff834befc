//! How a scene's things stand to each other, kept until objects or rooms change.

use percept_scene::rooms::Rooms;
use percept_scene::{Object, Related, RelationParams};
use std::sync::{Arc, Mutex, PoisonError};

/// The relations that were found last. All snapshots of a session share it.
#[derive(Debug, Clone, Default)]
pub(crate) struct RelatedThings(Arc<Mutex<Option<Kept>>>);

#[derive(Debug)]
struct Kept {
    objects: Arc<Vec<Object>>,
    rooms: Arc<Rooms>,
    params: RelationParams,
    related: Arc<Related>,
}

impl RelatedThings {
    /// Of these objects in these rooms. Of others in the same rooms, what is otherwise than before is found anew. Who asks for the same
    /// meanwhile waits for it.
    pub(crate) fn of(&self, objects: &Arc<Vec<Object>>, rooms: &Arc<Rooms>, params: &RelationParams) -> Arc<Related> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let before = kept.as_ref().filter(|k| Arc::ptr_eq(&k.rooms, rooms) && k.params == *params);
        if let Some(same) = before.filter(|k| Arc::ptr_eq(&k.objects, objects)) {
            return Arc::clone(&same.related);
        }
        let related = Arc::new(match before {
            Some(before) => before.related.renewed(objects, rooms, params),
            None => Related::of(objects, rooms, params),
        });
        let (objects, rooms, params) = (Arc::clone(objects), Arc::clone(rooms), params.clone());
        *kept = Some(Kept { objects, rooms, params, related: Arc::clone(&related) });
        related
    }
}

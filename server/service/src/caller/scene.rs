//! The scene, in the name of a caller.

use super::Caller;
use crate::{ClassInfo, ObjectQuery, Page, Result, RoomRoute, RoomWanted, SessionRooms};
use nalgebra::Point2;
use percept_geometry::{ObjectClass, Timestamp};
use percept_scene::rooms::RoomId;
use percept_scene::{Correction, Directions, Object, RelationFilter, SceneGraph};

impl Caller {
    /// Objects by id, or by distance, with the version of the map that their boxes refer to.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`, `FILTERS_INVALID`, `ROOM_NOT_FOUND`.
    pub async fn list_objects(
        &self,
        session: &str,
        query: ObjectQuery,
        page_size: u32,
        page_token: &str,
    ) -> Result<(Page<Object>, u64)> {
        self.may_with("SceneService/ListObjects", session).await?;
        self.service.list_objects(session, query, page_size, page_token).await
    }

    /// One object.
    ///
    /// # Errors
    /// `OBJECT_NOT_FOUND`, `SESSION_NOT_FOUND`.
    pub async fn object(&self, session: &str, id: u64) -> Result<Object> {
        self.may_with("SceneService/GetObject", session).await?;
        self.service.object(session, id).await
    }

    /// Does as a person says of an object, and learns from it if that is wanted; the objects that changed, and the version of the map.
    ///
    /// # Errors
    /// `OBJECT_NOT_FOUND`, `CORRECTION_INVALID`, `OBJECT_NOT_IN_MAP`, `TOO_MANY_EXAMPLES`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn correct_object(
        &self,
        session: &str,
        id: u64,
        correction: Correction,
        learn: bool,
    ) -> Result<(Vec<Object>, u64)> {
        self.may_with("SceneService/CorrectObject", session).await?;
        self.service.correct_object(session, id, correction, learn).await
    }

    /// Classes that objects of a session may have, or have.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn object_classes(&self, session: &str) -> Result<Vec<ClassInfo>> {
        self.may_with("SceneService/ListObjectClasses", session).await?;
        self.service.object_classes(session).await
    }

    /// Forgets what was learned of a class: how many examples there were.
    ///
    /// # Errors
    /// `CLASS_NOT_FOUND`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn forget_object_class(&self, session: &str, class: ObjectClass) -> Result<usize> {
        self.may_with("SceneService/ForgetObjectClass", session).await?;
        self.service.forget_object_class(session, class).await
    }

    /// Robot, objects, rooms and their relations, as far as they are asked for; with directions for somebody, if they are; as they were at a time;
    /// with what happened since a time.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `GRID_TOO_LARGE`, `STAMP_BEFORE_TRAJECTORY`, `STAMP_AFTER_TRAJECTORY`, `OUT_OF_RANGE`.
    pub async fn scene_graph(
        &self,
        session: &str,
        whose: Option<Directions>,
        filter: RelationFilter,
        since_at: (Option<Timestamp>, Option<Timestamp>),
    ) -> Result<SceneGraph> {
        self.may_with("SceneService/GetSceneGraph", session).await?;
        self.service.scene_graph(session, whose, filter, since_at).await
    }

    /// The rooms of a session's map.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `GRID_TOO_LARGE`.
    pub async fn rooms(&self, session: &str) -> Result<SessionRooms> {
        self.may_with("SceneService/GetRooms", session).await?;
        self.service.rooms(session).await
    }

    /// Calls a room by a name; an empty one takes its name from it.
    ///
    /// # Errors
    /// As [`Caller::rooms`]; `ROOM_NOT_FOUND`, `DISPLAY_NAME_INVALID`, `TOO_MANY_ROOM_NAMES`.
    pub async fn name_room(&self, session: &str, id: RoomId, name: &str) -> Result<SessionRooms> {
        self.may_with("SceneService/NameRoom", session).await?;
        self.service.name_room(session, id, name).await
    }

    /// The way to a room, from a point of the map or from where the robot is.
    ///
    /// # Errors
    /// As [`Caller::rooms`] and planning; `ROOM_NOT_FOUND`, `ROOM_NAME_AMBIGUOUS`.
    pub async fn route_to_room(&self, session: &str, to: RoomWanted, start: Option<Point2<f64>>) -> Result<RoomRoute> {
        self.may_with("SceneService/RouteToRoom", session).await?;
        self.service.route_to_room(session, to, start).await
    }
}

//! The way to a room.

use super::navigation::planned_to;
use super::rooms::{door_to, point_to};
use crate::v1;
use nalgebra::Point2;
use percept_scene::rooms::RoomId;
use percept_service::{Error, Result, RoomRoute, RoomWanted, reason};

/// The room that is asked for.
///
/// # Errors
/// `FIELD_MISSING` without one.
pub fn wanted(room: Option<v1::route_to_room_request::Room>) -> Result<RoomWanted> {
    use v1::route_to_room_request::Room;
    match room {
        Some(Room::RoomId(id)) => Ok(RoomWanted::Id(RoomId(id))),
        Some(Room::RoomName(name)) => Ok(RoomWanted::Name(name)),
        None => Err(Error::invalid(reason::FIELD_MISSING, "room", "give room_id or room_name".to_owned())),
    }
}

/// Where the way begins; none: where the robot is.
///
/// # Errors
/// Coordinates that are not finite.
pub fn start(p: Option<&v1::Vector2>) -> Result<Option<Point2<f64>>> {
    p.map(|p| super::geometry::point2("start", p)).transpose()
}

/// A way as a message.
pub fn route_to(found: &RoomRoute) -> v1::RouteToRoomResponse {
    use v1::route_to_room_response::Outcome;
    let outcome = planned_to(&found.plan).map_or_else(Outcome::NoPath, Outcome::Path);
    let step = |step: &percept_service::rooms::LabelledStep| v1::RouteStep {
        room_id: step.room.0,
        label: step.label.clone(),
        door: step.door.as_ref().map(door_to),
    };
    v1::RouteToRoomResponse {
        steps: found.steps.iter().map(step).collect(),
        length_m: found.length_m,
        goal: Some(point_to(&found.goal)),
        outcome: Some(outcome),
    }
}

//! Rooms, doors and places.

use crate::v1;
use nalgebra::Point2;
use percept_scene::RoomNode;
use percept_scene::rooms::{Door, Place, PlaceLink, RoomKind, Rooms};
use percept_service::SessionRooms;

pub(super) fn point_to(p: &Point2<f64>) -> v1::Vector2 {
    v1::Vector2 { x: p.x, y: p.y }
}

/// A room with the numbers of the objects in it, as a message.
pub fn room_to(node: &RoomNode, objects: &[u64]) -> v1::Room {
    let room = &node.room;
    let kind = match room.kind {
        RoomKind::Room => v1::RoomKind::Room,
        RoomKind::Corridor => v1::RoomKind::Corridor,
    };
    v1::Room {
        room_id: room.id.0,
        kind: kind.into(),
        name: node.name.clone().unwrap_or_default(),
        likely_use: node.likely.unwrap_or_default().to_owned(),
        was_entered: room.id.was_entered(),
        center: Some(point_to(&room.center)),
        radius_m: room.radius_m,
        area_m2: room.area_m2,
        outline: room.outline.iter().map(point_to).collect(),
        object_ids: objects.to_vec(),
    }
}

pub(super) fn door_to(door: &Door) -> v1::Door {
    v1::Door {
        room_id_1: door.rooms.0.0,
        room_id_2: door.rooms.1.0,
        center: Some(point_to(&door.center)),
        width_m: door.width_m,
        angle_rad: door.angle_rad,
    }
}

fn place_to(place: &Place) -> v1::Place {
    v1::Place {
        place_id: place.id.0,
        position: Some(point_to(&place.position)),
        clearance_m: place.clearance_m,
        room_id: place.room.0,
        is_in_door: place.door.is_some(),
    }
}

fn link_to(link: &PlaceLink) -> v1::PlaceLink {
    v1::PlaceLink { place_id_1: link.places.0.0, place_id_2: link.places.1.0, length_m: link.length_m }
}

/// All rooms as a message.
pub fn rooms_to(found: &SessionRooms, with_places: bool) -> v1::GetRoomsResponse {
    let Rooms { doors, places, links, .. } = &*found.rooms;
    let (places, links) = if with_places { (&places[..], &links[..]) } else { (&[][..], &[][..]) };
    v1::GetRoomsResponse {
        rooms: found.nodes.iter().zip(&found.objects).map(|(node, objects)| room_to(node, objects)).collect(),
        doors: doors.iter().map(door_to).collect(),
        places: places.iter().map(place_to).collect(),
        links: links.iter().map(link_to).collect(),
        map_version: found.map_version,
    }
}

/// One of the rooms as a message; none if it is not there any more.
pub fn one_to(found: &SessionRooms, id: u64) -> Option<v1::Room> {
    let mut all = found.nodes.iter().zip(&found.objects);
    all.find(|(node, _)| node.room.id.0 == id).map(|(node, objects)| room_to(node, objects))
}

//! Where the robot can get to: rooms, and things that it can drive up to.

use super::{Placed, Relation, RelationFrame, RelationKind};
use crate::rooms::{Place, RoomId, Rooms};
use crate::{NodeId, overlap};
use nalgebra::{Point3, Vector3};
use percept_geometry::OrientedBox3;
use std::collections::BTreeMap;

/// From a place so near to a thing's footprint, the rest of the way is short, metres: places are laid so far apart
/// ([`crate::rooms::RoomParams::place_spacing_m`] by default), so that what stands at free floor has one within it.
const REACH_M: f64 = 1.5;

/// Rooms and things that the robot can get to, as [`RelationKind::ReachableFrom`] has it.
///
/// Takes time in the number of links, and for each thing in that of the places in its room.
pub(crate) fn reachable(robot: &Placed, things: &[Placed], rooms: &Rooms) -> Vec<Relation> {
    let Some(here) = robot.room else { return vec![] };
    let around: Vec<(f64, &Place)> =
        rooms.places.iter().filter(|p| p.room == here).filter_map(|p| Some((gap(p, robot, rooms)?, p))).collect();
    let Some((first_m, first)) = around.iter().min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.id.cmp(&b.1.id))) else {
        return vec![];
    };
    let lengths = rooms.lengths_from(first.id);
    // A thing may stand between the robot and one of them: whose side it is on cannot be told.
    if around.iter().any(|(_, p)| !lengths.contains_key(&p.id)) {
        return vec![];
    }
    let mut places = BTreeMap::<RoomId, Vec<(f64, &Place)>>::new();
    for place in &rooms.places {
        if let Some(length) = lengths.get(&place.id) {
            places.entry(place.room).or_default().push((first_m + length, place));
        }
    }
    let relation = |subject, distance_m| {
        let (kind, frame) = (RelationKind::ReachableFrom, RelationFrame::Any);
        Relation { subject, kind, object: robot.id, frame, strength: 1.0, distance_m, stamp: None }
    };
    let shortest = |ways: &mut dyn Iterator<Item = f64>| ways.min_by(f64::total_cmp);
    let room = |(id, ways): (&RoomId, &Vec<(f64, &Place)>)| {
        let way = if *id == here { Some(0.0) } else { shortest(&mut ways.iter().map(|w| w.0)) };
        Some(relation(NodeId::Room(*id), way?))
    };
    let thing = |thing: &Placed| {
        let ways = places.get(&thing.room?)?;
        let way = shortest(&mut ways.iter().filter_map(|(length, p)| Some(length + gap(p, thing, rooms)?)));
        Some(relation(thing.id, way?))
    };
    places.iter().filter_map(room).chain(things.iter().filter_map(thing)).collect()
}

/// From a place to a thing's footprint, metres; none if it is out of reach, or behind a wall.
fn gap(place: &Place, thing: &Placed, rooms: &Rooms) -> Option<f64> {
    let center = thing.bbox.center();
    let reach_m = REACH_M + 0.5 * thing.bbox.size.xy().norm();
    if (place.position - center.xy()).norm() > reach_m {
        return None;
    }
    let at = Point3::new(place.position.x, place.position.y, center.z);
    let place = OrientedBox3::upright(at, Vector3::zeros(), 0.0);
    let gap = overlap::gap(&place, &thing.bbox);
    (gap <= REACH_M && rooms.is_open_between(&place, &thing.bbox)).then_some(gap)
}

//! How things stand to each other, wherever the robot is: kept until objects or rooms change.

use super::{Placed, Relation, RelationFrame, RelationKind, RelationParams, beside, stacked};
use crate::rooms::{RoomId, Rooms};
use crate::{NodeId, Object, ObjectState};
use std::collections::BTreeSet;

/// Objects that are not gone, with the relations between them.
#[derive(Debug, Clone, Default)]
pub struct Related {
    /// Ascending by id.
    pub(crate) things: Vec<Placed>,
    /// In rooms, stacked, beside each other.
    pub(crate) edges: Vec<Relation>,
}

impl Related {
    /// Of objects in rooms.
    ///
    /// Takes time in the number of things that stand in each other's room or share ground: 10,000 things in 500 rooms are related in
    /// 50 ms (`many_things`, an example of this crate).
    pub fn of(objects: &[Object], rooms: &Rooms, params: &RelationParams) -> Self {
        Self::default().renewed(objects, rooms, params)
    }

    /// The same of other objects, in the same rooms with the same parameters: where nothing is otherwise than before, relations are taken
    /// over.
    pub fn renewed(&self, objects: &[Object], rooms: &Rooms, params: &RelationParams) -> Self {
        let there = objects.iter().filter(|o| o.state != ObjectState::Gone);
        let mut things: Vec<Placed> = there.map(|o| self.known(o).unwrap_or_else(|| Placed::of(o, rooms))).collect();
        things.sort_by_key(|t| t.id);
        let mut edges: Vec<Relation> = things.iter().filter_map(in_room).collect();
        let mut stacks = BTreeSet::new();
        for (a, b) in sharing_ground(&things) {
            let found = stacked(&things[a], &things[b], params);
            if !found.is_empty() {
                stacks.insert((a, b));
                edges.extend(found);
            }
        }
        let changed = changed_rooms(&self.things, &things);
        let is_as_it_was = |thing: &Placed| match (&changed, thing.room) {
            (Some(changed), Some(room)) => !changed.contains(&room),
            _ => false,
        };
        let is_kept = |e: &&Relation| {
            let is_beside = matches!(e.kind, RelationKind::NextTo | RelationKind::Near);
            is_beside && self.thing(e.subject).is_some_and(is_as_it_was)
        };
        edges.extend(self.edges.iter().filter(is_kept));
        edges.extend(beside(&things, |thing| !is_as_it_was(thing), &stacks, rooms, params));
        edges.retain(|e| params.lists(e));
        Self { things, edges }
    }

    /// An object that stood so, and is of the same class.
    fn known(&self, object: &Object) -> Option<Placed> {
        let thing = self.thing(NodeId::Object(object.id))?;
        (thing.bbox == object.bbox).then_some(Placed { class: Some(object.class), ..*thing })
    }

    /// An object that is there.
    pub(crate) fn thing(&self, id: NodeId) -> Option<&Placed> {
        self.things.binary_search_by_key(&id, |t| t.id).ok().map(|i| &self.things[i])
    }
}

pub(crate) fn in_room(thing: &Placed) -> Option<Relation> {
    let (kind, frame) = (RelationKind::InRoom, RelationFrame::Any);
    let object = NodeId::Room(thing.room?);
    Some(Relation { subject: thing.id, kind, object, frame, strength: 1.0, distance_m: 0.0, stamp: None })
}

/// Rooms in which something stands otherwise than before; none if that cannot be told by room, as something stands in no room that is known.
fn changed_rooms(before: &[Placed], now: &[Placed]) -> Option<BTreeSet<RoomId>> {
    if before.iter().chain(now).any(|t| t.room.is_none()) {
        return None;
    }
    let differs = |thing: &&Placed, others: &[Placed]| {
        let same = others.binary_search_by_key(&thing.id, |t| t.id).ok().map(|i| &others[i]);
        same != Some(*thing)
    };
    let went = before.iter().filter(|t| differs(t, now));
    let came = now.iter().filter(|t| differs(t, before));
    Some(went.chain(came).filter_map(|t| t.room).collect())
}

/// Pairs of things whose footprints may overlap, the first one before the second: a sweep along x.
fn sharing_ground(things: &[Placed]) -> Vec<(usize, usize)> {
    let radius = |i: usize| 0.5 * things[i].bbox.size.xy().norm();
    let mut order: Vec<usize> = (0..things.len()).collect();
    let center = |i: usize| things[i].bbox.center().xy();
    order.sort_by(|a, b| center(*a).x.total_cmp(&center(*b).x).then(a.cmp(b)));
    let largest = (0..things.len()).map(radius).fold(0.0, f64::max);
    let mut pairs = vec![];
    for (k, &a) in order.iter().enumerate() {
        for &b in &order[k + 1..] {
            let offset = center(b) - center(a);
            if offset.x > radius(a) + largest {
                break;
            }
            if offset.norm() <= radius(a) + radius(b) {
                pairs.push((a.min(b), a.max(b)));
            }
        }
    }
    pairs.sort_unstable();
    pairs
}

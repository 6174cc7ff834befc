//! Which relations somebody asks for.

use crate::relations::Placed;
use crate::rooms::RoomId;
use crate::{NodeId, Relation, RelationKind};
use percept_geometry::{Aabb3, ObjectClass};

/// All that is set has to hold.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RelationFilter {
    /// One of these; empty: any but [`RelationKind::ReachableFrom`], which has to be named.
    pub kinds: Vec<RelationKind>,
    /// The subject.
    pub subject: Option<NodeId>,
    /// The object.
    pub object: Option<NodeId>,
    /// Class of the subject.
    pub subject_class: Option<ObjectClass>,
    /// Class of the object.
    pub object_class: Option<ObjectClass>,
    /// Subject or object is in this room, or is it.
    pub room: Option<RoomId>,
    /// The middle of the subject lies in it, map frame, metres.
    pub region: Option<Aabb3>,
    /// Strength, at least; 0..1.
    pub min_strength: f64,
}

impl RelationFilter {
    /// Whether nothing is left out.
    pub fn is_everything(&self) -> bool {
        *self == Self::default()
    }

    /// Whether a relation is asked for; `place` says where its nodes stand, and what they are.
    pub(crate) fn wants(&self, relation: &Relation, place: &dyn Fn(NodeId) -> Option<Placed>) -> bool {
        let is_of = |id: NodeId, class: Option<ObjectClass>| {
            class.is_none_or(|class| place(id).is_some_and(|placed| placed.class == Some(class)))
        };
        let is_in = |id: NodeId, room: RoomId| {
            id == NodeId::Room(room) || place(id).is_some_and(|placed| placed.room == Some(room))
        };
        let is_within =
            |region: Aabb3| place(relation.subject).is_some_and(|placed| region.contains(&placed.bbox.center()));
        relation.strength >= self.min_strength
            && (self.kinds.is_empty() || self.kinds.contains(&relation.kind))
            && self.subject.is_none_or(|id| id == relation.subject)
            && self.object.is_none_or(|id| id == relation.object)
            && is_of(relation.subject, self.subject_class)
            && is_of(relation.object, self.object_class)
            && self.room.is_none_or(|room| is_in(relation.subject, room) || is_in(relation.object, room))
            && self.region.is_none_or(is_within)
    }
}

impl Relation {
    /// Who is in which room, if it says so.
    pub(crate) fn room(&self) -> Option<(NodeId, RoomId)> {
        match (self.kind, self.object) {
            (RelationKind::InRoom, NodeId::Room(room)) => Some((self.subject, room)),
            _ => None,
        }
    }
}

//! Which relations somebody asks for.

use crate::rooms::RoomId;
use crate::{Node, NodeId, Relation, RelationKind};
use nalgebra::Point3;
use percept_geometry::{Aabb3, ObjectClass};
use std::collections::BTreeMap;

/// All that is set has to hold.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RelationFilter {
    /// One of these; empty: any.
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

    /// Whether a relation is asked for.
    pub(crate) fn wants(
        &self,
        relation: &Relation,
        nodes: &BTreeMap<NodeId, &Node>,
        room_of: &BTreeMap<NodeId, RoomId>,
    ) -> bool {
        let class = |id: &NodeId| match nodes.get(id) {
            Some(Node::Object(o)) => Some(o.class),
            _ => None,
        };
        let is_in = |id: &NodeId, room: RoomId| *id == NodeId::Room(room) || room_of.get(id) == Some(&room);
        let center = |id: &NodeId| nodes.get(id).map(|n| n.bbox().center());
        let within = |region: &Aabb3, p: Option<Point3<f64>>| p.is_some_and(|p| region.contains(&p));
        relation.strength >= self.min_strength
            && (self.kinds.is_empty() || self.kinds.contains(&relation.kind))
            && self.subject.is_none_or(|id| id == relation.subject)
            && self.object.is_none_or(|id| id == relation.object)
            && self.subject_class.is_none_or(|c| class(&relation.subject) == Some(c))
            && self.object_class.is_none_or(|c| class(&relation.object) == Some(c))
            && self.room.is_none_or(|room| is_in(&relation.subject, room) || is_in(&relation.object, room))
            && self.region.is_none_or(|region| within(&region, center(&relation.subject)))
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

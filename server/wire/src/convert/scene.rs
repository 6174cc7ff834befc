//! Objects, relations, the scene graph.

use super::geometry;
use crate::v1;
use percept_geometry::ObjectClass;
use percept_scene::{
    Node, NodeId, Object, ObjectChange, ObjectChangeKind, ObjectState, Relation, RelationFrame, RelationKind,
    SceneGraph,
};
use percept_service::Result;

/// A class that is not UNSPECIFIED.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn class(value: i32) -> Result<ObjectClass> {
    optional_class(value)?.ok_or_else(|| super::unknown_enum("object_class", value))
}

/// A class; UNSPECIFIED is none.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn optional_class(value: i32) -> Result<Option<ObjectClass>> {
    use v1::ObjectClass as C;
    Ok(Some(match C::try_from(value) {
        Ok(C::Unspecified) => return Ok(None),
        Ok(C::Unknown) => ObjectClass::Unknown,
        Ok(C::Table) => ObjectClass::Table,
        Ok(C::Chair) => ObjectClass::Chair,
        Ok(C::Shelf) => ObjectClass::Shelf,
        Ok(C::Box) => ObjectClass::Box,
        Ok(C::Cylinder) => ObjectClass::Cylinder,
        Ok(C::Person) => ObjectClass::Person,
        Err(_) => return Err(super::unknown_enum("object_class", value)),
    }))
}

/// A class as a message.
pub fn class_to(class: ObjectClass) -> v1::ObjectClass {
    use v1::ObjectClass as C;
    match class {
        ObjectClass::Unknown => C::Unknown,
        ObjectClass::Table => C::Table,
        ObjectClass::Chair => C::Chair,
        ObjectClass::Shelf => C::Shelf,
        ObjectClass::Box => C::Box,
        ObjectClass::Cylinder => C::Cylinder,
        ObjectClass::Person => C::Person,
    }
}

/// An object as a message.
pub fn object_to(o: &Object) -> v1::Object {
    let state = match o.state {
        ObjectState::Static => v1::ObjectState::Static,
        ObjectState::Moving => v1::ObjectState::Moving,
        ObjectState::Gone => v1::ObjectState::Gone,
    };
    v1::Object {
        object_id: o.id.0,
        object_class: class_to(o.class).into(),
        confidence: o.confidence,
        r#box: Some(geometry::box_to(&o.bbox)),
        state: state.into(),
        velocity_mps: Some(geometry::vector_to(&o.velocity_mps)),
        first_seen_ns: o.first_seen.nanos(),
        last_seen_ns: o.last_seen.nanos(),
        num_observations: o.observation_count,
    }
}

/// A change as a message, with the object as it is now if it still is.
pub fn change_to(change: &ObjectChange, object: Option<&Object>) -> v1::ObjectChange {
    use v1::ObjectChangeKind as K;
    let kind = match change.kind {
        ObjectChangeKind::Appeared => K::Appeared,
        ObjectChangeKind::Updated => K::Updated,
        ObjectChangeKind::Reclassified { .. } => K::Reclassified,
        ObjectChangeKind::StartedMoving => K::StartedMoving,
        ObjectChangeKind::Stopped => K::Stopped,
        ObjectChangeKind::Gone => K::Gone,
        ObjectChangeKind::Reappeared => K::Reappeared,
        ObjectChangeKind::Merged { .. } => K::Merged,
        ObjectChangeKind::Forgotten => K::Forgotten,
    };
    let merged_into = match change.kind {
        ObjectChangeKind::Merged { into } => Some(into.0),
        _ => None,
    };
    v1::ObjectChange { object_id: change.id.0, kind: kind.into(), object: object.map(object_to), merged_into }
}

fn node_id(id: NodeId) -> String {
    match id {
        NodeId::Robot => "robot".to_owned(),
        NodeId::Object(id) => format!("object/{id}"),
    }
}

fn node_to(node: &Node) -> v1::SceneNode {
    let (kind, label, t_map_node, object) = match node {
        Node::Robot { t_map_base } => (v1::SceneNodeKind::Robot, "robot".to_owned(), *t_map_base, None),
        Node::Object(o) => {
            let label = format!("{} {}", o.class.name(), o.id);
            (v1::SceneNodeKind::Object, label, o.bbox.t_frame_box, Some(object_to(o)))
        }
    };
    v1::SceneNode {
        node_id: node_id(node.id()),
        kind: kind.into(),
        label,
        t_map_node: Some(geometry::pose_to(&t_map_node)),
        object,
    }
}

fn relation_to(r: &Relation) -> v1::Relation {
    use v1::RelationKind as K;
    let kind = match r.kind {
        RelationKind::On => K::On,
        RelationKind::Inside => K::Inside,
        RelationKind::Near => K::Near,
        RelationKind::Above => K::Above,
        RelationKind::Below => K::Below,
        RelationKind::LeftOf => K::LeftOf,
        RelationKind::RightOf => K::RightOf,
        RelationKind::InFrontOf => K::InFrontOf,
        RelationKind::Behind => K::Behind,
    };
    let frame = match r.frame {
        RelationFrame::Any => v1::RelationFrame::Any,
        RelationFrame::Gravity => v1::RelationFrame::Gravity,
        RelationFrame::Viewer { .. } => v1::RelationFrame::Viewer,
    };
    v1::Relation {
        subject_id: node_id(r.subject),
        kind: kind.into(),
        object_id: node_id(r.object),
        strength: r.strength,
        frame: frame.into(),
        distance_m: r.distance_m,
    }
}

/// The scene graph as a message.
pub fn graph_to(g: &SceneGraph) -> v1::SceneGraph {
    v1::SceneGraph {
        stamp_ns: g.stamp.nanos(),
        map_version: g.map_version,
        frame_id: "map".to_owned(),
        nodes: g.nodes.iter().map(node_to).collect(),
        relations: g.edges.iter().map(relation_to).collect(),
    }
}

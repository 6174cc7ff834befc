//! Objects, relations, the scene graph.

use super::geometry;
use super::rooms::room_to;
use crate::v1;
use percept_geometry::{ClassNameError, ObjectClass, Timestamp};
use percept_scene::rooms::RoomId;
use percept_scene::{
    Correction, Directions, Node, NodeId, Object, ObjectChange, ObjectChangeKind, ObjectFilter, ObjectId, ObjectState,
    PastState, Relation, RelationFilter, RelationFrame, RelationKind, SceneGraph,
};
use percept_service::{ClassInfo, Error, ObjectQuery, Result, reason};
use std::collections::BTreeMap;

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
        Ok(C::Car) => ObjectClass::Car,
        Ok(C::Van) => ObjectClass::Van,
        Ok(C::Truck) => ObjectClass::Truck,
        Ok(C::Bus) => ObjectClass::Bus,
        Ok(C::Cyclist) => ObjectClass::Cyclist,
        Ok(C::Motorcycle) => ObjectClass::Motorcycle,
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
        ObjectClass::Car => C::Car,
        ObjectClass::Van => C::Van,
        ObjectClass::Truck => C::Truck,
        ObjectClass::Bus => C::Bus,
        ObjectClass::Cyclist => C::Cyclist,
        ObjectClass::Motorcycle => C::Motorcycle,
        ObjectClass::Named(_) => C::Unknown,
    }
}

/// A class by its name; empty is none.
///
/// # Errors
/// `CLASS_NAME_INVALID`.
pub fn class_named(field: &str, name: &str) -> Result<Option<ObjectClass>> {
    if name.is_empty() {
        return Ok(None);
    }
    let refused = |e: ClassNameError| Error::invalid(reason::CLASS_NAME_INVALID, field, e.to_string());
    ObjectClass::parse(name).map(Some).map_err(refused)
}

/// A class by its number or by its name; none if neither is set.
///
/// # Errors
/// `ENUM_UNKNOWN`, `CLASS_NAME_INVALID`, `FILTERS_INVALID` if both are.
fn class_of(number: i32, (field, name): (&str, &str)) -> Result<Option<ObjectClass>> {
    match (optional_class(number)?, class_named(field, name)?) {
        (Some(_), Some(_)) => {
            let message = format!("{field} is set, and the class by its number, too; set one of them");
            Err(Error::invalid(reason::FILTERS_INVALID, field, message))
        }
        (number, name) => Ok(number.or(name)),
    }
}

/// Which objects are listed.
///
/// # Errors
/// As [`class_named`]; `ENUM_UNKNOWN`, those of a box and a point.
pub fn query(r: &v1::ListObjectsRequest) -> Result<ObjectQuery> {
    let near = r.near.as_ref().map(|near| geometry::vector("near", near)).transpose()?;
    let filter = ObjectFilter {
        class: class_of(r.object_class, ("label", &r.label))?,
        text: r.text.clone(),
        region: super::layers::box3(r.region.as_ref())?,
        seen_since: r.seen_since_ns.map(Timestamp),
        seen_until: r.seen_until_ns.map(Timestamp),
        include_gone: r.include_gone,
        at: r.at_ns.map(Timestamp),
        near: near.map(Into::into),
    };
    Ok(ObjectQuery { filter, room: r.room_id.map(RoomId), include_set_aside: r.include_set_aside })
}

/// What a person says of an object.
///
/// # Errors
/// `FIELD_MISSING`, `CLASS_NAME_INVALID`, those of boxes.
pub fn correction(correction: Option<&v1::correct_object_request::Correction>) -> Result<Correction> {
    use v1::correct_object_request::Correction as C;
    Ok(match super::required("correction", correction)? {
        C::Label(name) => Correction::Class(class_named("label", name)?),
        C::IsDeleted(true) => Correction::Delete,
        C::IsDeleted(false) => Correction::Restore,
        C::PartOf(id) => Correction::PartOf(ObjectId(*id)),
        C::Pieces(pieces) => {
            let boxes = pieces.boxes.iter().map(|b| geometry::oriented_box("pieces.boxes", b));
            Correction::Split(boxes.collect::<Result<_>>()?)
        }
    })
}

/// A class of a session as a message.
pub fn class_info_to(c: &ClassInfo) -> v1::ObjectClassInfo {
    v1::ObjectClassInfo {
        label: c.class.name().to_owned(),
        is_built_in: c.is_built_in,
        num_examples: u32::try_from(c.num_examples).unwrap_or(u32::MAX),
        num_objects: c.num_objects as u64,
    }
}

fn state_to(state: ObjectState) -> v1::ObjectState {
    match state {
        ObjectState::Static => v1::ObjectState::Static,
        ObjectState::Moving => v1::ObjectState::Moving,
        ObjectState::Gone => v1::ObjectState::Gone,
    }
}

fn past_to(past: &PastState) -> v1::PastObjectState {
    v1::PastObjectState {
        stamp_ns: past.stamp.nanos(),
        label: past.class.name().to_owned(),
        state: state_to(past.state).into(),
        r#box: Some(geometry::box_to(&past.bbox)),
    }
}

/// An object as a message, with what it was before.
pub fn whole_object_to(o: &Object) -> v1::Object {
    v1::Object { history: o.history.iter().map(past_to).collect(), ..object_to(o) }
}

/// An object as a message.
pub fn object_to(o: &Object) -> v1::Object {
    let probability = |&(class, probability): &(ObjectClass, f64)| v1::ClassProbability {
        label: class.name().to_owned(),
        probability,
    };
    let annotation = (!o.annotation.is_empty()).then(|| v1::ObjectAnnotation {
        label: o.annotation.class.map(|c| c.name().to_owned()).unwrap_or_default(),
        is_deleted: o.annotation.is_deleted,
        part_of: o.annotation.part_of.map(|id| id.0),
        is_drawn: o.annotation.is_drawn,
    });
    v1::Object {
        object_id: o.id.0,
        object_class: class_to(o.class).into(),
        confidence: o.confidence,
        r#box: Some(geometry::box_to(&o.bbox)),
        state: state_to(o.state).into(),
        velocity_mps: Some(geometry::vector_to(&o.velocity_mps)),
        first_seen_ns: o.first_seen.nanos(),
        last_seen_ns: o.last_seen.nanos(),
        num_observations: o.observation_count,
        label: o.class.name().to_owned(),
        class_probabilities: o.class_probabilities.iter().map(probability).collect(),
        annotation,
        history: vec![],
        velocity_variance: o.velocity_variance,
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
        NodeId::Room(id) => format!("room/{id}"),
    }
}

fn node_to(node: &Node, inside: &BTreeMap<RoomId, Vec<u64>>) -> v1::SceneNode {
    let (kind, label, t_map_node) = match node {
        Node::Robot { t_map_base } => (v1::SceneNodeKind::Robot, "robot".to_owned(), *t_map_base),
        Node::Object(o) => (v1::SceneNodeKind::Object, format!("{} {}", o.class.name(), o.id), o.bbox.t_frame_box),
        Node::Room(room) => (v1::SceneNodeKind::Room, room.label(), node.bbox().t_frame_box),
    };
    let (mut object, mut room) = (None, None);
    match node {
        Node::Robot { .. } => {}
        Node::Object(o) => object = Some(object_to(o)),
        Node::Room(r) => room = Some(room_to(r, inside.get(&r.room.id).map_or(&[], Vec::as_slice))),
    }
    let (node_id, t_map_node) = (node_id(node.id()), Some(geometry::pose_to(&t_map_node)));
    v1::SceneNode { node_id, kind: kind.into(), label, t_map_node, object, room }
}

/// A node's id.
///
/// # Errors
/// `NODE_ID_INVALID`.
fn node_of(field: &str, text: &str) -> Result<Option<NodeId>> {
    let number = |text: &str| text.parse::<u64>().ok();
    Ok(Some(match text.split_once('/') {
        None if text.is_empty() => return Ok(None),
        None if text == "robot" => NodeId::Robot,
        Some(("object", id)) if number(id).is_some() => NodeId::Object(ObjectId(number(id).unwrap_or_default())),
        Some(("room", id)) if number(id).is_some() => NodeId::Room(RoomId(number(id).unwrap_or_default())),
        _ => {
            let shown: String = text.chars().take(80).collect();
            let message = format!("{shown:?} is no node_id; write \"robot\", \"object/7\" or \"room/3072\"");
            return Err(Error::invalid(reason::NODE_ID_INVALID, field, message));
        }
    }))
}

/// Whose directions are asked for.
///
/// # Errors
/// `ENUM_UNKNOWN`, `OUT_OF_RANGE`.
pub fn directions(frame: i32, viewer_yaw_rad: f64) -> Result<Option<Directions>> {
    use v1::RelationFrame as F;
    Ok(match F::try_from(frame) {
        Ok(F::Unspecified) => None,
        Ok(F::Robot) => Some(Directions::Robot),
        Ok(F::Map) => Some(Directions::Map),
        Ok(F::Viewer) if viewer_yaw_rad.is_finite() => Some(Directions::Viewer { yaw_rad: viewer_yaw_rad }),
        Ok(F::Viewer) => {
            let message = format!("viewer_yaw_rad is {viewer_yaw_rad}; it must be finite");
            return Err(Error::invalid(reason::OUT_OF_RANGE, "viewer_yaw_rad", message));
        }
        Ok(F::Gravity | F::Any) => {
            let message = "directions are for somebody: choose ROBOT, MAP or VIEWER".to_owned();
            return Err(Error::invalid(reason::OUT_OF_RANGE, "directions", message));
        }
        Err(_) => return Err(super::unknown_enum("directions", frame)),
    })
}

/// A filter; none lets everything pass.
///
/// # Errors
/// `ENUM_UNKNOWN`, `NODE_ID_INVALID`, `OUT_OF_RANGE`, those of a box.
pub fn filter(f: Option<&v1::RelationFilter>) -> Result<RelationFilter> {
    let Some(f) = f else { return Ok(RelationFilter::default()) };
    if !(0.0..=1.0).contains(&f.min_strength) {
        let message = format!("min_strength is {}; it must lie from 0 to 1", f.min_strength);
        return Err(Error::invalid(reason::OUT_OF_RANGE, "filter.min_strength", message));
    }
    Ok(RelationFilter {
        kinds: f.kinds.iter().map(|k| kind(*k)).collect::<Result<_>>()?,
        subject: node_of("filter.subject_id", &f.subject_id)?,
        object: node_of("filter.object_id", &f.object_id)?,
        subject_class: class_of(f.subject_class, ("filter.subject_label", &f.subject_label))?,
        object_class: class_of(f.object_class, ("filter.object_label", &f.object_label))?,
        room: f.room_id.map(RoomId),
        region: super::layers::box3(f.region.as_ref())?,
        min_strength: f.min_strength,
    })
}

/// Every kind with its message's.
const KINDS: [(RelationKind, v1::RelationKind); 21] = [
    (RelationKind::On, v1::RelationKind::On),
    (RelationKind::Supports, v1::RelationKind::Supports),
    (RelationKind::Inside, v1::RelationKind::Inside),
    (RelationKind::Under, v1::RelationKind::Under),
    (RelationKind::Above, v1::RelationKind::Above),
    (RelationKind::Below, v1::RelationKind::Below),
    (RelationKind::NextTo, v1::RelationKind::NextTo),
    (RelationKind::Near, v1::RelationKind::Near),
    (RelationKind::InRoom, v1::RelationKind::InRoom),
    (RelationKind::ConnectedTo, v1::RelationKind::ConnectedTo),
    (RelationKind::ReachableFrom, v1::RelationKind::ReachableFrom),
    (RelationKind::LeftOf, v1::RelationKind::LeftOf),
    (RelationKind::RightOf, v1::RelationKind::RightOf),
    (RelationKind::InFrontOf, v1::RelationKind::InFrontOf),
    (RelationKind::Behind, v1::RelationKind::Behind),
    (RelationKind::AppearedIn, v1::RelationKind::AppearedIn),
    (RelationKind::DisappearedFrom, v1::RelationKind::DisappearedFrom),
    (RelationKind::MovedFrom, v1::RelationKind::MovedFrom),
    (RelationKind::MovedTo, v1::RelationKind::MovedTo),
    (RelationKind::Before, v1::RelationKind::Before),
    (RelationKind::Together, v1::RelationKind::Together),
];

fn kind(value: i32) -> Result<RelationKind> {
    let found = KINDS.iter().find(|(_, message)| *message as i32 == value);
    found.map(|(kind, _)| *kind).ok_or_else(|| super::unknown_enum("filter.kinds", value))
}

fn relation_to(r: &Relation) -> v1::Relation {
    let kind = KINDS.iter().find(|(kind, _)| *kind == r.kind).map_or(v1::RelationKind::Unspecified, |(_, k)| *k);
    let frame = match r.frame {
        RelationFrame::Any => v1::RelationFrame::Any,
        RelationFrame::Gravity => v1::RelationFrame::Gravity,
        RelationFrame::Robot { .. } => v1::RelationFrame::Robot,
        RelationFrame::Map => v1::RelationFrame::Map,
        RelationFrame::Viewer => v1::RelationFrame::Viewer,
    };
    v1::Relation {
        subject_id: node_id(r.subject),
        kind: kind.into(),
        object_id: node_id(r.object),
        strength: r.strength,
        frame: frame.into(),
        distance_m: r.distance_m,
        stamp_ns: r.stamp.map(Timestamp::nanos),
    }
}

/// The scene graph as a message.
pub fn graph_to(g: &SceneGraph) -> v1::SceneGraph {
    let mut inside = BTreeMap::<RoomId, Vec<u64>>::new();
    for edge in &g.edges {
        if let (NodeId::Object(object), RelationKind::InRoom, NodeId::Room(room)) =
            (edge.subject, edge.kind, edge.object)
        {
            inside.entry(room).or_default().push(object.0);
        }
    }
    v1::SceneGraph {
        stamp_ns: g.stamp.nanos(),
        map_version: g.map_version,
        frame_id: "map".to_owned(),
        nodes: g.nodes.iter().map(|node| node_to(node, &inside)).collect(),
        relations: g.edges.iter().map(relation_to).collect(),
    }
}

//! The scene graph: nodes in layers, typed edges with a strength.

use crate::relations::{Directions, Placed, Related, beside_robot, directions, in_room, reachable, temporal};
use crate::rooms::{Room, RoomId, RoomKind, Rooms};
use crate::{
    Node, NodeId, Object, ObjectState, Relation, RelationFilter, RelationFrame, RelationKind, RelationParams, RoomNode,
};
use percept_geometry::{ObjectClass, Pose, Timestamp};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// What a room with such things in it is likely used for. None if they do not tell.
fn likely_use(kind: RoomKind, things: impl Iterator<Item = ObjectClass>) -> Option<&'static str> {
    let mut counts = BTreeMap::<ObjectClass, usize>::new();
    things.for_each(|class| *counts.entry(class).or_default() += 1);
    let num = |class| counts.get(&class).copied().unwrap_or_default();
    let (tables, chairs, shelves, boxes) =
        (num(ObjectClass::Table), num(ObjectClass::Chair), num(ObjectClass::Shelf), num(ObjectClass::Box));
    match () {
        () if kind == RoomKind::Corridor => None,
        () if tables >= 1 && chairs >= 3 * tables => Some("meeting room"),
        () if tables >= 1 && chairs >= 1 => Some("office"),
        () if tables == 0 && shelves + boxes >= 3 && shelves + boxes > chairs => Some("storage room"),
        () => None,
    }
}

/// What is there and how it lies, at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneGraph {
    /// Stamp of the robot's pose and of the viewer's frame.
    pub stamp: Timestamp,
    /// Version of the map that the boxes are in.
    pub map_version: u64,
    /// The robot, then objects ascending by id, then rooms.
    pub nodes: Vec<Node>,
    /// Ascending by subject, object and kind.
    pub edges: Vec<Relation>,
}

/// What a graph is made of.
#[derive(Debug, Clone, Copy)]
pub struct SceneView<'a> {
    /// Stamp of the robot's pose.
    pub stamp: Timestamp,
    /// Version of the map that boxes and rooms are in.
    pub map_version: u64,
    /// Base to map.
    pub t_map_base: &'a Pose,
    /// Ascending by id. What is gone among them is left out, unless it went after `since`.
    pub objects: &'a [Object],
    /// May be empty: nothing is in a room then, and walls are not known.
    pub rooms: &'a Rooms,
    /// Of these objects in these rooms.
    pub related: &'a Related,
    /// What people call rooms.
    pub names: &'a BTreeMap<RoomId, String>,
    /// What happened from then on is listed, too.
    pub since: Option<Timestamp>,
}

impl SceneGraph {
    /// The graph of the robot, of what is not gone, and of the rooms, as far as it is asked for; with directions for somebody, if they are.
    /// A filter that wants less than everything leaves out nodes that no relation joins.
    ///
    /// Takes time in the number of objects and relations; for directions, in the number of pairs within reach of each other along x.
    pub fn build(
        view: &SceneView<'_>,
        params: &RelationParams,
        whose: Option<Directions>,
        filter: &RelationFilter,
    ) -> Self {
        let SceneView { stamp, map_version, t_map_base, objects, rooms, related, since, .. } = *view;
        let bbox = Node::Robot { t_map_base: *t_map_base }.bbox();
        let robot = Placed { id: NodeId::Robot, bbox, class: None, room: rooms.of(&bbox).map(|r| r.id) };
        let mut rest: Vec<Relation> = in_room(&robot).into_iter().collect();
        rest.extend(beside_robot(&robot, &related.things, rooms, params));
        if let Some(whose) = whose {
            let heading = whose.heading(t_map_base, stamp);
            let things: Vec<Placed> = std::iter::once(robot).chain(related.things.iter().copied()).collect();
            let pairs = near_pairs(&things, params.max_distance_m);
            pairs.iter().for_each(|(a, b)| directions(&things[*a], &things[*b], heading, params, &mut rest));
        }
        if filter.kinds.contains(&RelationKind::ReachableFrom) {
            rest.extend(reachable(&robot, &related.things, rooms));
        }
        rest.retain(|e| params.lists(e));
        rest.extend(doors(rooms));
        rest.extend(since.map(|since| temporal(objects, since, rooms)).unwrap_or_default());
        let place = |id: NodeId| match id {
            NodeId::Robot => Some(robot),
            NodeId::Object(object) => related.thing(id).copied().or_else(|| {
                // What has gone.
                objects
                    .binary_search_by_key(&object, |o| o.id)
                    .ok()
                    .map(|i| Placed { room: None, ..Placed::of(&objects[i], rooms) })
            }),
            NodeId::Room(room) => {
                rooms.get(room).map(|room| Placed { id, bbox: RoomNode::bbox_of(room), class: None, room: None })
            }
        };
        let wanted = |e: &&Relation| filter.wants(e, &place);
        let mut edges: Vec<Relation> = related.edges.iter().chain(&rest).filter(wanted).copied().collect();
        edges.sort_by_key(|e| (e.subject, e.object, e.kind));
        Self { stamp, map_version, nodes: nodes(view, filter, &edges), edges }
    }

    /// The graph in Graphviz's DOT language. Text.
    ///
    /// Things lie in a frame for each room; edges are labelled with kind and strength, those that need a viewer are dashed.
    pub fn to_dot(&self) -> String {
        let name = |id: NodeId| match id {
            NodeId::Robot => "robot".to_owned(),
            NodeId::Object(id) => format!("object_{id}"),
            NodeId::Room(id) => format!("room_{id}"),
        };
        let room_of: BTreeMap<NodeId, RoomId> = self.edges.iter().filter_map(Relation::room).collect();
        let line = |node: &Node| match node {
            Node::Robot { .. } => "robot [shape=diamond, label=\"robot\"];".to_owned(),
            Node::Object(o) => {
                let (class, confidence) = (o.class.name(), o.confidence);
                let style = if o.state == ObjectState::Gone { ", style=dotted" } else { "" };
                format!("{} [shape=box, label=\"{class} {}\\n{confidence:.2}\"{style}];", name(node.id()), o.id)
            }
            Node::Room(r) => format!("{} [shape=ellipse, label=\"{}\"];", name(node.id()), escaped(&r.label())),
        };
        let mut out = String::from("digraph scene {\n");
        // Writing to a String cannot fail.
        let _ = writeln!(out, "  label=\"{} s, map version {}\";", self.stamp, self.map_version);
        for room in self.nodes.iter().filter(|n| matches!(n, Node::Room(_))) {
            let NodeId::Room(id) = room.id() else { continue };
            let _ = writeln!(out, "  subgraph cluster_{id} {{");
            let inside = self.nodes.iter().filter(|n| room_of.get(&n.id()) == Some(&id));
            for node in std::iter::once(room).chain(inside) {
                let _ = writeln!(out, "    {}", line(node));
            }
            let _ = writeln!(out, "  }}");
        }
        let is_shown = |n: &&Node| {
            let room = room_of.get(&n.id()).map(|r| NodeId::Room(*r));
            matches!(n, Node::Room(_)) || room.is_some_and(|r| self.nodes.iter().any(|n| n.id() == r))
        };
        for node in self.nodes.iter().filter(|n| !is_shown(n)) {
            let _ = writeln!(out, "  {}", line(node));
        }
        for e in self.edges.iter().filter(|e| e.kind != RelationKind::InRoom) {
            let needs_viewer =
                matches!(e.frame, RelationFrame::Robot { .. } | RelationFrame::Map | RelationFrame::Viewer);
            let style = if needs_viewer { ", style=dashed" } else { "" };
            let (from, to, kind) = (name(e.subject), name(e.object), e.kind.name());
            let _ = writeln!(out, "  {from} -> {to} [label=\"{kind} {:.2}\"{style}];", e.strength);
        }
        out.push_str("}\n");
        out
    }
}

/// Text for a label between quotes.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}

/// Nodes of a graph with these relations: robot, objects, rooms.
fn nodes(view: &SceneView<'_>, filter: &RelationFilter, edges: &[Relation]) -> Vec<Node> {
    let mut joined: Vec<NodeId> = edges.iter().flat_map(|e| [e.subject, e.object]).collect();
    joined.sort_unstable();
    joined.dedup();
    let is_joined = |id: NodeId| joined.binary_search(&id).is_ok();
    let is_wanted = |id: NodeId| filter.is_everything() || is_joined(id);
    let mut nodes = vec![];
    nodes.extend(is_wanted(NodeId::Robot).then_some(Node::Robot { t_map_base: *view.t_map_base }));
    // What has gone is there if something is told of it.
    let is_told = |o: &&Object| {
        if o.state == ObjectState::Gone { is_joined(NodeId::Object(o.id)) } else { is_wanted(NodeId::Object(o.id)) }
    };
    nodes.extend(view.objects.iter().filter(is_told).map(|o| Node::Object(o.clone())));
    nodes.sort_by_key(Node::id);
    let in_rooms = by_room(&view.related.things);
    let inside = |room: &Room| {
        let classes = in_rooms.get(&room.id).into_iter().flatten().copied();
        let name = view.names.get(&room.id).cloned();
        Node::Room(RoomNode { likely: likely_use(room.kind, classes), name, room: room.clone() })
    };
    nodes.extend(view.rooms.rooms.iter().filter(|room| is_wanted(NodeId::Room(room.id))).map(inside));
    nodes
}

/// Classes of what stands in each room.
fn by_room(things: &[Placed]) -> BTreeMap<RoomId, Vec<ObjectClass>> {
    let mut out = BTreeMap::<RoomId, Vec<ObjectClass>>::new();
    for (room, class) in things.iter().filter_map(|t| t.room.zip(t.class)) {
        out.entry(room).or_default().push(class);
    }
    out
}

/// Rooms that a door joins, each pair once.
fn doors(rooms: &Rooms) -> Vec<Relation> {
    let pairs: BTreeSet<(RoomId, RoomId)> = rooms.doors.iter().map(|d| d.rooms).collect();
    let joined = |(a, b): (RoomId, RoomId)| {
        let (kind, frame) = (RelationKind::ConnectedTo, RelationFrame::Any);
        let (subject, object) = (NodeId::Room(a), NodeId::Room(b));
        Relation { subject, kind, object, frame, strength: 1.0, distance_m: 0.0, stamp: None }
    };
    pairs.into_iter().map(joined).collect()
}

/// Pairs of things whose bounding spheres are within `max_distance_m`, the first one before the second: a sweep along x.
fn near_pairs(things: &[Placed], max_distance_m: f64) -> Vec<(usize, usize)> {
    let mut order: Vec<(usize, f64)> = things.iter().enumerate().map(|(i, t)| (i, 0.5 * t.bbox.size.norm())).collect();
    let x = |i: usize| things[i].bbox.center().x;
    order.sort_by(|a, b| x(a.0).total_cmp(&x(b.0)).then(a.0.cmp(&b.0)));
    let largest = order.iter().map(|p| p.1).fold(0.0, f64::max);
    let mut pairs = vec![];
    for (k, (a, radius)) in order.iter().enumerate() {
        for (b, other) in &order[k + 1..] {
            let offset = things[*b].bbox.center() - things[*a].bbox.center();
            if offset.x > max_distance_m + radius + largest {
                break;
            }
            if offset.norm() <= max_distance_m + radius + other {
                pairs.push((*a.min(b), *a.max(b)));
            }
        }
    }
    pairs.sort_unstable();
    pairs
}

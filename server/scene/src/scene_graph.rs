//! The scene graph: nodes in layers, typed edges with a strength.

use crate::relations::{Directions, Placed, beside, directions, stacked, temporal};
use crate::rooms::{Room, RoomId, RoomKind, Rooms};
use crate::{NodeId, Object, ObjectState, Relation, RelationFilter, RelationFrame, RelationKind, RelationParams};
use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, Timestamp, se3};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Edges of the nominal box that stands for the robot on its base frame, metres.
const ROBOT_SIZE_M: [f64; 3] = [0.5, 0.5, 0.5];

/// A node of the graph.
#[derive(Debug, Clone, PartialEq)]
pub enum Node {
    /// The robot.
    Robot {
        /// Base to map.
        t_map_base: Pose,
    },
    /// An object that is there; or that has gone, if it is asked what happened.
    Object(Object),
    /// A room.
    Room(RoomNode),
}

/// A room, what it is called, and what it may be used for.
#[derive(Debug, Clone, PartialEq)]
pub struct RoomNode {
    /// The room.
    pub room: Room,
    /// What people call it.
    pub name: Option<String>,
    /// What it is likely used for, by what stands in it.
    pub likely: Option<&'static str>,
}

impl RoomNode {
    /// Its name, else what it is likely used for, else what its shape says; with its number if it has no name.
    pub fn label(&self) -> String {
        let kind = self.likely.unwrap_or(self.room.kind.name());
        self.name.clone().unwrap_or_else(|| format!("{kind} {}", self.room.id))
    }
}

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

impl Node {
    /// Its identity.
    pub fn id(&self) -> NodeId {
        match self {
            Self::Robot { .. } => NodeId::Robot,
            Self::Object(object) => NodeId::Object(object.id),
            Self::Room(node) => NodeId::Room(node.room.id),
        }
    }

    /// Upright box in the map frame, metres: nominal for the robot; of a room the circle that fits, flat.
    pub fn bbox(&self) -> OrientedBox3 {
        match self {
            Self::Robot { t_map_base } => {
                let size = Vector3::from(ROBOT_SIZE_M);
                let center = t_map_base.translation.vector + Vector3::new(0.0, 0.0, 0.5 * size.z);
                OrientedBox3::upright(Point3::from(center), size, se3::yaw(t_map_base))
            }
            Self::Object(object) => object.bbox,
            Self::Room(RoomNode { room, .. }) => {
                let size = Vector3::new(2.0 * room.radius_m, 2.0 * room.radius_m, 0.0);
                OrientedBox3::upright(Point3::new(room.center.x, room.center.y, 0.0), size, 0.0)
            }
        }
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
    /// What is gone among them is left out, unless it went after `since`.
    pub objects: &'a [Object],
    /// May be empty: nothing is in a room then, and walls are not known.
    pub rooms: &'a Rooms,
    /// What people call rooms.
    pub names: &'a BTreeMap<RoomId, String>,
    /// What happened from then on is listed, too.
    pub since: Option<Timestamp>,
}

impl SceneGraph {
    /// The graph of the robot, of what is not gone, and of the rooms; with directions for somebody, if they are asked for.
    ///
    /// Takes time in the number of pairs within reach of each other along x.
    pub fn build(view: &SceneView<'_>, params: &RelationParams, whose: Option<Directions>) -> Self {
        let SceneView { stamp, map_version, t_map_base, objects, rooms, names, since } = *view;
        let mut nodes = vec![Node::Robot { t_map_base: *t_map_base }];
        nodes.extend(objects.iter().filter(|o| o.state != ObjectState::Gone).map(|o| Node::Object(o.clone())));
        nodes.sort_by_key(Node::id);
        let placed = |node: &Node| {
            let (bbox, class) = match node {
                Node::Object(o) => (o.bbox, Some(o.class)),
                _ => (node.bbox(), None),
            };
            Placed { id: node.id(), bbox, class, room: rooms.of(&bbox).map(|r| r.id) }
        };
        let things: Vec<Placed> = nodes.iter().map(placed).collect();
        let mut edges: Vec<Relation> = things.iter().filter_map(in_room).collect();
        let pairs = near_pairs(&things, params.max_distance_m);
        let mut stacks = BTreeSet::new();
        for (a, b) in pairs.iter().filter(|(a, b)| things[*a].class.is_some() && things[*b].class.is_some()) {
            let found = stacked(&things[*a], &things[*b], params);
            if !found.is_empty() {
                stacks.insert((*a, *b));
                edges.extend(found);
            }
        }
        edges.extend(beside(&things, &pairs, |a, b| stacks.contains(&(a, b)), rooms, params));
        if let Some(whose) = whose {
            let heading = whose.heading(t_map_base, stamp);
            pairs.iter().for_each(|(a, b)| directions(&things[*a], &things[*b], heading, params, &mut edges));
        }
        edges.retain(|e| e.strength >= params.min_strength && e.strength > 0.0);
        edges.extend(doors(rooms));
        let happened = since.map(|since| temporal(objects, since, rooms)).unwrap_or_default();
        let went: BTreeSet<NodeId> = happened.iter().flat_map(|e| [e.subject, e.object]).collect();
        edges.extend(happened);
        let inside = |room: &Room| {
            let classes = things.iter().filter(|t| t.room == Some(room.id)).filter_map(|t| t.class);
            let name = names.get(&room.id).cloned();
            Node::Room(RoomNode { likely: likely_use(room.kind, classes), name, room: room.clone() })
        };
        let gone = objects.iter().filter(|o| o.state == ObjectState::Gone && went.contains(&NodeId::Object(o.id)));
        nodes.extend(gone.map(|o| Node::Object(o.clone())));
        nodes.sort_by_key(Node::id);
        nodes.extend(rooms.rooms.iter().map(inside));
        edges.sort_by_key(|e| (e.subject, e.object, e.kind));
        Self { stamp, map_version, nodes, edges }
    }

    /// The relations that are asked for, and the nodes that they join.
    pub fn filtered(mut self, filter: &RelationFilter) -> Self {
        if filter.is_everything() {
            return self;
        }
        let nodes: BTreeMap<NodeId, &Node> = self.nodes.iter().map(|n| (n.id(), n)).collect();
        let room_of: BTreeMap<NodeId, RoomId> = self.edges.iter().filter_map(Relation::room).collect();
        let edges: Vec<Relation> = self.edges.iter().filter(|e| filter.wants(e, &nodes, &room_of)).copied().collect();
        let mentioned: BTreeSet<NodeId> = edges.iter().flat_map(|e| [e.subject, e.object]).collect();
        self.nodes.retain(|n| mentioned.contains(&n.id()));
        Self { edges, ..self }
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

fn in_room(thing: &Placed) -> Option<Relation> {
    let (kind, frame) = (RelationKind::InRoom, RelationFrame::Any);
    let object = NodeId::Room(thing.room?);
    Some(Relation { subject: thing.id, kind, object, frame, strength: 1.0, distance_m: 0.0, stamp: None })
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

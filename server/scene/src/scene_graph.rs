//! The scene graph: nodes in layers, typed edges with a strength.

use crate::relations::{Placed, Viewer, relate};
use crate::{NodeId, Object, ObjectState, Relation, RelationFrame, RelationParams};
use nalgebra::{Point3, Vector3};
use percept_geometry::{OrientedBox3, Pose, Timestamp, se3};
use std::fmt::Write;

/// Edges of the nominal box that stands for the robot on its base frame, metres.
const ROBOT_SIZE_M: [f64; 3] = [0.5, 0.5, 0.5];

/// A node of the graph. Layers above (places, rooms, the building) are further variants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Node {
    /// The robot.
    Robot {
        /// Base to map.
        t_map_base: Pose,
    },
    /// An object that is there.
    Object(Object),
}

impl Node {
    /// Its identity.
    pub fn id(&self) -> NodeId {
        match self {
            Self::Robot { .. } => NodeId::Robot,
            Self::Object(object) => NodeId::Object(object.id),
        }
    }

    /// Upright box in the map frame, metres: nominal for the robot.
    pub fn bbox(&self) -> OrientedBox3 {
        match self {
            Self::Robot { t_map_base } => {
                let size = Vector3::from(ROBOT_SIZE_M);
                let center = t_map_base.translation.vector + Vector3::new(0.0, 0.0, 0.5 * size.z);
                OrientedBox3::upright(Point3::from(center), size, se3::yaw(t_map_base))
            }
            Self::Object(object) => object.bbox,
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
    /// The robot, then the objects ascending by id.
    pub nodes: Vec<Node>,
    /// Ascending by subject, object and kind.
    pub edges: Vec<Relation>,
}

impl SceneGraph {
    /// The graph of the robot at `t_map_base` and of those of `objects` that are not gone.
    ///
    /// Takes time in the number of pairs within reach of each other along x.
    pub fn build(
        stamp: Timestamp,
        map_version: u64,
        t_map_base: &Pose,
        objects: &[Object],
        params: &RelationParams,
    ) -> Self {
        let mut nodes = vec![Node::Robot { t_map_base: *t_map_base }];
        nodes.extend(objects.iter().filter(|o| o.state != ObjectState::Gone).map(|o| Node::Object(*o)));
        nodes.sort_by_key(Node::id);
        let viewer = Viewer { t_map_base: *t_map_base, stamp };
        let mut edges = Vec::new();
        for_near_pairs(&nodes, params.max_distance_m, |a, b| relate(a, b, &viewer, params, &mut edges));
        edges.sort_by_key(|e| (e.subject, e.object, e.kind));
        Self { stamp, map_version, nodes, edges }
    }

    /// The graph in Graphviz's DOT language. Text.
    ///
    /// Edges are labelled with kind and strength; those that need a viewer are dashed.
    pub fn to_dot(&self) -> String {
        let name = |id: NodeId| match id {
            NodeId::Robot => "robot".to_owned(),
            NodeId::Object(id) => format!("object_{id}"),
        };
        let mut out = String::from("digraph scene {\n");
        // Writing to a String cannot fail.
        let _ = writeln!(out, "  label=\"{} s, map version {}\";", self.stamp, self.map_version);
        for node in &self.nodes {
            let _ = match node {
                Node::Robot { .. } => writeln!(out, "  robot [shape=diamond, label=\"robot\"];"),
                Node::Object(o) => {
                    let (class, confidence) = (o.class.name(), o.confidence);
                    writeln!(out, "  {} [shape=box, label=\"{class} {}\\n{confidence:.2}\"];", name(node.id()), o.id)
                }
            };
        }
        for e in &self.edges {
            let style = if matches!(e.frame, RelationFrame::Viewer { .. }) { ", style=dashed" } else { "" };
            let (from, to, kind) = (name(e.subject), name(e.object), e.kind.name());
            let _ = writeln!(out, "  {from} -> {to} [label=\"{kind} {:.2}\"{style}];", e.strength);
        }
        out.push_str("}\n");
        out
    }
}

/// Visits each pair of nodes whose bounding spheres are within `max_distance_m`: a sweep along x.
fn for_near_pairs(nodes: &[Node], max_distance_m: f64, mut visit: impl FnMut(&Placed, &Placed)) {
    let mut placed: Vec<(Placed, f64)> =
        nodes.iter().map(|n| ((n.id(), n.bbox()), 0.5 * n.bbox().size.norm())).collect();
    placed.sort_by(|(a, _), (b, _)| a.1.center().x.total_cmp(&b.1.center().x).then(a.0.cmp(&b.0)));
    let largest = placed.iter().map(|p| p.1).fold(0.0, f64::max);
    for (i, (a, radius)) in placed.iter().enumerate() {
        for (b, other) in &placed[i + 1..] {
            let offset = b.1.center() - a.1.center();
            if offset.x > max_distance_m + radius + largest {
                break;
            }
            if offset.norm() <= max_distance_m + radius + other {
                visit(a, b);
            }
        }
    }
}

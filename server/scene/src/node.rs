//! The nodes of the scene graph: robot, objects, rooms.

use crate::rooms::Room;
use crate::{NodeId, Object};
use nalgebra::{Point3, Vector3};
use percept_geometry::{OrientedBox3, Pose, se3};

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

    /// The circle that fits into a room, flat.
    pub(crate) fn bbox_of(room: &Room) -> OrientedBox3 {
        let size = Vector3::new(2.0 * room.radius_m, 2.0 * room.radius_m, 0.0);
        OrientedBox3::upright(Point3::new(room.center.x, room.center.y, 0.0), size, 0.0)
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
            Self::Room(node) => RoomNode::bbox_of(&node.room),
        }
    }
}

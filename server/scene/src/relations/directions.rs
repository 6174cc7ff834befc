//! Left and right, in front and behind: for somebody.

use super::{Placed, Relation, RelationFrame, RelationKind, RelationParams};
use crate::{NodeId, overlap};
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{Pose, Timestamp, se3};

/// Whose left and right is meant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Directions {
    /// The robot's.
    Robot,
    /// Of somebody who looks along the map's x axis.
    Map,
    /// Of somebody who looks in this direction, radians from the map's x axis.
    Viewer {
        /// Heading.
        yaw_rad: f64,
    },
}

impl Directions {
    /// Heading, radians, and the frame's name, of a robot that is there.
    pub(crate) fn heading(self, t_map_base: &Pose, stamp: Timestamp) -> (f64, RelationFrame) {
        match self {
            Self::Robot => (se3::yaw(t_map_base), RelationFrame::Robot { stamp }),
            Self::Map => (0.0, RelationFrame::Map),
            Self::Viewer { yaw_rad } => (yaw_rad, RelationFrame::Viewer),
        }
    }
}

/// How two things lie for somebody with this heading, each with its converse; of what shares ground nothing.
///
/// Source: the falloff is that of the perception course whose scene graph this is: linear, to nothing at `max_distance_m`.
pub(crate) fn directions(
    a: &Placed,
    b: &Placed,
    (yaw_rad, frame): (f64, RelationFrame),
    params: &RelationParams,
    out: &mut Vec<Relation>,
) {
    let distance_m = overlap::gap(&a.bbox, &b.bbox);
    let near = 1.0 - distance_m / params.max_distance_m;
    if near < 0.0 || overlap::shared_footprint(&a.bbox, &b.bbox) > 0.0 {
        return;
    }
    let with_robot = a.id == NodeId::Robot || b.id == NodeId::Robot;
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -yaw_rad);
    for (subject, object) in [(a, b), (b, a)] {
        // Things lie about the robot; where the robot lies about them, seen by itself, says nothing more.
        if subject.id == NodeId::Robot {
            continue;
        }
        let offset = turned * (subject.bbox.center() - object.bbox.center());
        let ground2 = offset.x * offset.x + offset.y * offset.y;
        if ground2 < 1e-12 {
            continue;
        }
        let (ahead2, left2) = (offset.x * offset.x / ground2, offset.y * offset.y / ground2);
        let side = if offset.y > 0.0 { RelationKind::LeftOf } else { RelationKind::RightOf };
        // Of two objects the nearer one is in front; of the robot what is ahead is in front.
        let front = if with_robot { offset.x > 0.0 } else { offset.x < 0.0 };
        let depth = if front { RelationKind::InFrontOf } else { RelationKind::Behind };
        for (kind, strength) in [(side, near * left2), (depth, near * ahead2)] {
            let strength = strength.min(1.0);
            out.push(Relation {
                subject: subject.id,
                kind,
                object: object.id,
                frame,
                strength,
                distance_m,
                stamp: None,
            });
        }
    }
}

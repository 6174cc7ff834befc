//! How two things lie to each other, each relation in a stated frame and with a strength.

use crate::{ObjectId, SceneError, overlap, within};
use percept_geometry::{OrientedBox3, Pose, Timestamp, se3};
use serde::{Deserialize, Serialize};

/// A node of the scene graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NodeId {
    /// The robot.
    Robot,
    /// A tracked object.
    Object(ObjectId),
}

/// `subject kind object`: the cup is *on* the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RelationKind {
    /// The subject rests on top of the object.
    On,
    /// Most of the subject's volume lies within the object's box.
    Inside,
    /// The subject is over the object, apart from it.
    Above,
    /// The subject is under the object, apart from it.
    Below,
    /// The gap between the two is small.
    Near,
    /// The subject is to the left of the object, as the viewer sees it.
    LeftOf,
    /// The subject is to the right of the object, as the viewer sees it.
    RightOf,
    /// The subject is on the viewer's side of the object; with the robot as object: ahead of the robot.
    InFrontOf,
    /// The subject is on the far side of the object; with the robot as object: behind the robot.
    Behind,
}

impl RelationKind {
    /// Lower-case name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Inside => "inside",
            Self::Above => "above",
            Self::Below => "below",
            Self::Near => "near",
            Self::LeftOf => "left_of",
            Self::RightOf => "right_of",
            Self::InFrontOf => "in_front_of",
            Self::Behind => "behind",
        }
    }
}

/// The frame in which a relation holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RelationFrame {
    /// Any: it reads the same from everywhere (near, inside).
    Any,
    /// Gravity: up is against it (on, above, below).
    Gravity,
    /// The robot's heading when it was there at this time, levelled (left, right, in front, behind).
    Viewer {
        /// Stamp of the robot's pose.
        stamp: Timestamp,
    },
}

/// A typed, directed edge of the scene graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relation {
    /// Who.
    pub subject: NodeId,
    /// How.
    pub kind: RelationKind,
    /// To whom.
    pub object: NodeId,
    /// In which frame.
    pub frame: RelationFrame,
    /// 0..1; see [`relate`] for what it measures.
    pub strength: f64,
    /// Gap between the two boxes, metres; 0 if they touch or overlap.
    pub distance_m: f64,
}

/// Which relations are listed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelationParams {
    /// Things with a larger gap between them are not related, metres, positive.
    pub max_distance_m: f64,
    /// Weaker relations are not listed; 0..1.
    pub min_strength: f64,
    /// Gap or overlap in height at which one thing still rests on another, metres, positive.
    pub contact_m: f64,
}

impl Default for RelationParams {
    fn default() -> Self {
        Self { max_distance_m: 5.0, min_strength: 0.1, contact_m: 0.1 }
    }
}

impl RelationParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and what it has to be.
    pub fn validate(&self) -> Result<(), SceneError> {
        within("max_distance_m", self.max_distance_m, 1e-6, 1e6, "positive and at most 1e6")?;
        within("min_strength", self.min_strength, 0.0, 1.0, "from 0 to 1")?;
        within("contact_m", self.contact_m, 1e-6, 1e6, "positive and at most 1e6")
    }
}

/// Where relations of left and right, front and behind are seen from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewer {
    /// Base to map; only the heading counts.
    pub t_map_base: Pose,
    /// Stamp of that pose.
    pub stamp: Timestamp,
}

/// Something that has a place: upright box in the map frame, metres.
pub type Placed = (NodeId, OrientedBox3);

/// The relations of `a` to `b` and of `b` to `a`, upright boxes in the map frame, that are strong enough.
///
/// With `g` the gap between the boxes and `n = 1 - g / max_distance_m` their nearness, strength is
/// - near: `n` (listed once, with the smaller node as subject);
/// - inside: how much more than half of the subject's volume the object's box holds, 0 at half and 1 at all;
/// - on: share of the subject's footprint that is over the object, times how good the contact is, 1 where the
///   subject's bottom is at the object's top and 0 at `contact_m` from it;
/// - above, below: share of the smaller footprint that is over or under the other, times `n`;
/// - left of, right of, in front of, behind: `n` times the squared cosine between that direction and the line of
///   the centres on the ground, so that the two directions that apply add up to `n`.
///
/// Things inside, on or above each other have no left and right. The robot is near things, and things are left of it,
/// ahead of it and so on; every other relation of direction is listed with its converse.
pub fn relate(a: &Placed, b: &Placed, viewer: &Viewer, params: &RelationParams, out: &mut Vec<Relation>) {
    let distance_m = overlap::gap(&a.1, &b.1);
    let near = 1.0 - distance_m / params.max_distance_m;
    if near < 0.0 {
        return;
    }
    let mut list = |subject: &Placed, kind, object: &Placed, frame, strength: f64| {
        if strength >= params.min_strength && strength > 0.0 {
            let strength = strength.min(1.0);
            out.push(Relation { subject: subject.0, kind, object: object.0, frame, strength, distance_m });
        }
    };
    let (first, second) = if a.0 <= b.0 { (a, b) } else { (b, a) };
    list(first, RelationKind::Near, second, RelationFrame::Any, near);
    let robot = a.0 == NodeId::Robot || b.0 == NodeId::Robot;
    let mut stacked = false;
    if !robot {
        for (subject, object) in [(a, b), (b, a)] {
            let (kind, strength) = stacking(&subject.1, &object.1, near, params);
            let Some(kind) = kind else { continue };
            stacked = true;
            let frame = if kind == RelationKind::Inside { RelationFrame::Any } else { RelationFrame::Gravity };
            list(subject, kind, object, frame, strength);
            if kind == RelationKind::Above {
                list(object, RelationKind::Below, subject, frame, strength);
            }
        }
    }
    if stacked {
        return;
    }
    let frame = RelationFrame::Viewer { stamp: viewer.stamp };
    let turned = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), -se3::yaw(&viewer.t_map_base));
    for (subject, object) in [(a, b), (b, a)] {
        // Things lie about the robot; where the robot lies about them, seen by itself, says nothing more.
        if subject.0 == NodeId::Robot {
            continue;
        }
        let offset = turned * (subject.1.center() - object.1.center());
        let ground2 = offset.x * offset.x + offset.y * offset.y;
        if ground2 < 1e-12 {
            continue;
        }
        let (ahead2, left2) = (offset.x * offset.x / ground2, offset.y * offset.y / ground2);
        let side = if offset.y > 0.0 { RelationKind::LeftOf } else { RelationKind::RightOf };
        list(subject, side, object, frame, near * left2);
        // Of two objects the nearer one is in front; of the robot what is ahead is in front.
        let front = if robot { offset.x > 0.0 } else { offset.x < 0.0 };
        let depth = if front { RelationKind::InFrontOf } else { RelationKind::Behind };
        list(subject, depth, object, frame, near * ahead2);
    }
}

/// Whether and how much `subject` is inside, on or above `object`.
fn stacking(
    subject: &OrientedBox3,
    object: &OrientedBox3,
    near: f64,
    params: &RelationParams,
) -> (Option<RelationKind>, f64) {
    let inside = 2.0 * overlap::share_of(subject, object) - 1.0;
    if inside > 0.0 && subject.volume() < object.volume() {
        return (Some(RelationKind::Inside), inside);
    }
    let shared = overlap::shared_footprint(subject, object);
    let height = overlap::z_range(subject).0 - overlap::z_range(object).1;
    if shared <= 0.0 || height < -params.contact_m {
        return (None, 0.0);
    }
    let area = overlap::footprint_area(subject);
    if height <= params.contact_m {
        let contact = 1.0 - height.abs() / params.contact_m;
        return (Some(RelationKind::On), shared / area * contact);
    }
    (Some(RelationKind::Above), shared / area.min(overlap::footprint_area(object)) * near)
}

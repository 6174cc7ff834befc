//! How two things stand to each other, each relation in a stated frame, with a strength and a reason to exist.
//!
//! What holds whoever looks: what rests on what, is in it, under it ([`mod@physical`]); what stands next to it or near, in the same room and
//! in sight ([`mod@beside`]). Left and right, front and behind only are listed on request, and say for whom ([`mod@directions`]); so is where
//! the robot can get to ([`mod@reachable`]), and what happened since a time ([`mod@temporal`]).

mod beside;
mod directions;
mod physical;
mod reachable;
mod related;
mod temporal;

pub use directions::Directions;
pub use related::Related;

pub(crate) use beside::{beside, beside_robot};
pub(crate) use directions::directions;
pub(crate) use physical::stacked;
pub(crate) use reachable::reachable;
pub(crate) use related::in_room;
pub(crate) use temporal::temporal;

use crate::rooms::{RoomId, Rooms};
use crate::{Object, ObjectId, SceneError, within};
use percept_geometry::{ObjectClass, OrientedBox3, Timestamp};
use serde::{Deserialize, Serialize};

/// A node of the scene graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NodeId {
    /// The robot.
    Robot,
    /// A tracked object.
    Object(ObjectId),
    /// A room.
    Room(RoomId),
}

/// `subject kind object`: the cup is *on* the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RelationKind {
    /// The subject rests on top of the object.
    On,
    /// The object rests on top of the subject.
    Supports,
    /// Most of the subject's volume lies within the object, which can hold things.
    Inside,
    /// The subject stands under the object's top, between its legs.
    Under,
    /// The subject is over the object, apart from it.
    Above,
    /// The subject is under the object, apart from it.
    Below,
    /// Nobody passes between the two, which stand in one room. Listed once, with the smaller node as subject.
    NextTo,
    /// Each other's nearest, in one room and in sight, or the robot's. Listed once, with the smaller node as subject.
    Near,
    /// The subject is in the room.
    InRoom,
    /// A door leads from one room to the other. Listed once, with the smaller node as subject.
    ConnectedTo,
    /// The robot, which is the object, can drive from where it is into the room, or up to the thing, that is the subject. Only listed if
    /// [`crate::RelationFilter::kinds`] names it. A room: one of its places is joined by links between places
    /// ([`crate::rooms::PlaceLink`]: free floor on which obstacles, furniture included, keep their distance) to where the robot stands. A
    /// thing: such a place lies in the room that it stands in, within 1.5 m of its footprint, and no wall between. It says nothing of how
    /// high a thing lies. What is not listed may be reachable as well: over floor that is not known, or by a robot that is slimmer than
    /// [`crate::rooms::RoomParams::place_clearance_m`] says; nothing is listed where rooms are not known, where the robot is in none, and
    /// where the places around it do not hang together.
    ReachableFrom,
    /// The subject is to the left of the object.
    LeftOf,
    /// The subject is to the right of the object.
    RightOf,
    /// The subject is on the viewer's side of the object; with the robot as object: ahead of the robot.
    InFrontOf,
    /// The subject is on the far side of the object; with the robot as object: behind the robot.
    Behind,
    /// The subject was not there, and came to stand in the room. Of this and the next three, the object is the subject itself where
    /// rooms are not known.
    AppearedIn,
    /// The subject stood in the room, and is not there any more.
    DisappearedFrom,
    /// The subject stood in the room, and stands elsewhere.
    MovedFrom,
    /// The subject stood elsewhere, and stands in the room.
    MovedTo,
    /// What happened to the subject came before what happened to the object, which came next.
    Before,
    /// What happened to both happened at once; no more than two seconds lie between.
    Together,
}

impl RelationKind {
    /// Lower-case name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Supports => "supports",
            Self::Inside => "inside",
            Self::Under => "under",
            Self::Above => "above",
            Self::Below => "below",
            Self::NextTo => "next_to",
            Self::Near => "near",
            Self::InRoom => "in_room",
            Self::ConnectedTo => "connected_to",
            Self::ReachableFrom => "reachable_from",
            Self::LeftOf => "left_of",
            Self::RightOf => "right_of",
            Self::InFrontOf => "in_front_of",
            Self::Behind => "behind",
            Self::AppearedIn => "appeared_in",
            Self::DisappearedFrom => "disappeared_from",
            Self::MovedFrom => "moved_from",
            Self::MovedTo => "moved_to",
            Self::Before => "before",
            Self::Together => "together",
        }
    }
}

/// The frame in which a relation holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RelationFrame {
    /// Any: it reads the same from everywhere (near, inside, in a room).
    Any,
    /// Gravity: up is against it (on, under, above, below).
    Gravity,
    /// The robot's heading when it was there at this time, levelled.
    Robot {
        /// Stamp of the robot's pose.
        stamp: Timestamp,
    },
    /// The heading of somebody who looks along the map's x axis.
    Map,
    /// The heading that was asked for.
    Viewer,
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
    /// How much it holds, 0..1:
    /// - on, supports: share of the subject's footprint over the object, times how good the contact is, 1 where one's bottom is at the
    ///   other's top and 0 at `contact_m` from it;
    /// - inside: how much more than half of the subject's volume the object holds, 0 at half and 1 at all;
    /// - under: share of the smaller footprint that both have;
    /// - above, below: the same times the nearness;
    /// - next to, near: the nearness, `1 - gap / max_distance_m`;
    /// - left of, right of, in front of, behind: the nearness times the squared cosine between that direction and the line of the centres
    ///   on the ground, so that the two directions that apply add up to it;
    /// - in a room, connected, reachable, and what happened: 1.
    pub strength: f64,
    /// Gap between the two, metres; 0 if they touch or overlap. Of what moved, how far; of what is reachable, the way there: 0 to the
    /// room that the robot is in, else to the place in it that is reached first; to a thing, up to its footprint.
    pub distance_m: f64,
    /// When it happened; none of what holds at the graph's stamp.
    pub stamp: Option<Timestamp>,
}

/// Something that stands somewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placed {
    pub(crate) id: NodeId,
    /// Upright, map frame, metres.
    pub(crate) bbox: OrientedBox3,
    /// None of the robot.
    pub(crate) class: Option<ObjectClass>,
    /// Where rooms are known.
    pub(crate) room: Option<RoomId>,
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
    /// A gap in which nobody passes: things so near are next to each other, metres, positive.
    pub next_to_m: f64,
    /// Of each thing so many others are near, 0 to 100.
    pub num_near: usize,
}

impl Placed {
    /// An object where it stands.
    pub(crate) fn of(object: &Object, rooms: &Rooms) -> Self {
        let (bbox, class) = (object.bbox, Some(object.class));
        Self { id: NodeId::Object(object.id), bbox, class, room: rooms.of(&bbox).map(|r| r.id) }
    }
}

impl Default for RelationParams {
    fn default() -> Self {
        Self { max_distance_m: 5.0, min_strength: 0.1, contact_m: 0.1, next_to_m: 0.5, num_near: 3 }
    }
}

impl RelationParams {
    /// Whether a relation is strong enough to be listed.
    pub(crate) fn lists(&self, relation: &Relation) -> bool {
        relation.strength >= self.min_strength && relation.strength > 0.0
    }

    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and what it has to be.
    pub fn validate(&self) -> Result<(), SceneError> {
        within("max_distance_m", self.max_distance_m, 1e-6, 1e6, "positive and at most 1e6")?;
        within("min_strength", self.min_strength, 0.0, 1.0, "from 0 to 1")?;
        within("contact_m", self.contact_m, 1e-6, 1e6, "positive and at most 1e6")?;
        within("next_to_m", self.next_to_m, 1e-6, 1e6, "positive and at most 1e6")?;
        within("num_near", self.num_near as f64, 0.0, 100.0, "from 0 to 100")
    }
}

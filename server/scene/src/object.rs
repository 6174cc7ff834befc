//! What is observed, what is tracked, and what may change about it.

use crate::{Annotation, ObjectId};
use nalgebra::Vector3;
use percept_geometry::{ObjectClass, OrientedBox3, Timestamp};
use serde::{Deserialize, Serialize};

/// One detection, the tracker's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// What it looks like.
    pub class: ObjectClass,
    /// Probability of that class, 0..1.
    pub confidence: f64,
    /// Where it is: upright box in the map frame, metres.
    pub bbox: OrientedBox3,
    /// Points that the box was fitted to: the more, the more the box is trusted.
    pub num_points: usize,
    /// Whether it was seen to move: frames just before saw through where it is.
    pub is_moving: bool,
    /// Whether beams of this update end at it. Else it is known from before: it may be what somebody who walked by has left in the map,
    /// where nobody has looked since.
    pub is_seen: bool,
}

impl Observation {
    /// Whether it can be tracked: centre within 1000 km of the origin, edges from a micrometre to 10 km, confidence in
    /// 0..1, nothing NaN. The tracker passes over observations that are not usable.
    pub fn is_usable(&self) -> bool {
        let t = &self.bbox.t_frame_box;
        let placed = t.translation.vector.iter().all(|v| v.abs() <= 1e6);
        let turned = t.rotation.coords.iter().all(|v| v.is_finite());
        let sized = self.bbox.size.iter().all(|s| (1e-6..=1e4).contains(s));
        placed && turned && sized && (0.0..=1.0).contains(&self.confidence)
    }
}

/// What the sensors of this update say about a box in the map frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visibility {
    /// Beams went through it and ended behind: it is empty.
    SeenThrough,
    /// Beams ended in it: something is there.
    Occupied,
    /// Something may be there, but all around was searched for objects and none stands there by itself: it is a
    /// part of another thing, or clutter.
    Refuted,
    /// Hidden, out of view or out of range: nothing can be said.
    Unseen,
}

/// What an object does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectState {
    /// Where it was.
    Static,
    /// On its way.
    Moving,
    /// Not there any more: its place was seen through.
    Gone,
}

/// A tracked thing in the map frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Object {
    /// Identity.
    pub id: ObjectId,
    /// What a person said that it is, else the likeliest class over all observations.
    pub class: ObjectClass,
    /// Probability of that class, 0..1; 1 if a person said so.
    pub confidence: f64,
    /// Probabilities of the classes that it was taken for, likeliest first; what they lack to 1 is shared by all others.
    #[serde(deserialize_with = "listed_or_in_order")]
    pub class_probabilities: Vec<(ObjectClass, f64)>,
    /// Upright box in the map frame, metres; where it was last seen if gone.
    pub bbox: OrientedBox3,
    /// What it does.
    pub state: ObjectState,
    /// Velocity in the map frame, m/s; zero unless moving.
    pub velocity_mps: Vector3<f64>,
    /// Variance of the velocity along x, and along y, (m/s)²; zero unless moving.
    #[serde(default)]
    pub velocity_variance: f64,
    /// Stamp of the first observation.
    pub first_seen: Timestamp,
    /// Stamp of the newest observation.
    pub last_seen: Timestamp,
    /// Observations so far.
    pub observation_count: u64,
    /// Points of the best observation that the box rests on.
    pub num_points: usize,
    /// What people said of it.
    #[serde(default, skip_serializing_if = "Annotation::is_empty")]
    pub annotation: Annotation,
    /// What it was before, oldest first, ascending by stamp.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub history: Vec<PastState>,
}

/// What an object was from a stamp on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PastState {
    /// From then on.
    pub stamp: Timestamp,
    /// Class.
    pub class: ObjectClass,
    /// What it did.
    pub state: ObjectState,
    /// Upright box, map frame as it is now.
    pub bbox: OrientedBox3,
}

impl Object {
    /// The object as it was at a stamp: class, state and box of then. None before it was known.
    pub fn at(&self, stamp: Timestamp) -> Option<Self> {
        let later = self.history.partition_point(|h| h.stamp <= stamp);
        let past = match later.checked_sub(1) {
            Some(i) if later < self.history.len() => self.history[i],
            // Since the last change.
            Some(_) => return Some(self.clone()),
            None if !self.history.is_empty() || stamp < self.first_seen => return None,
            None => return Some(self.clone()),
        };
        let (history, velocity_mps) = (self.history[..later].to_vec(), Vector3::zeros());
        let (class, state, bbox) = (past.class, past.state, past.bbox);
        // What people said since then was not said.
        let annotation = Annotation { class: self.annotation.class.filter(|said| *said == class), ..self.annotation };
        let believed = self.class_probabilities.iter().find(|p| p.0 == class).map_or(0.0, |p| p.1);
        let confidence = if annotation.class.is_some() { 1.0 } else { believed };
        let velocity_variance = 0.0;
        Some(Self {
            annotation,
            confidence,
            class,
            state,
            bbox,
            velocity_mps,
            velocity_variance,
            history,
            last_seen: self.last_seen.min(stamp),
            ..self.clone()
        })
    }
}

/// Pairs of class and probability; or, of earlier versions, the probabilities alone in the order of [`ObjectClass::BUILT_IN`], all
/// of them or a beginning.
fn listed_or_in_order<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<(ObjectClass, f64)>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Stored {
        Listed(Vec<(ObjectClass, f64)>),
        InOrder(Vec<f64>),
    }
    let in_order = match Stored::deserialize(from)? {
        Stored::Listed(listed) => return Ok(listed),
        Stored::InOrder(in_order) => in_order,
    };
    if in_order.len() > ObjectClass::BUILT_IN.len() {
        let wanted = "at most as many probabilities as there are classes";
        return Err(serde::de::Error::invalid_length(in_order.len(), &wanted));
    }
    // Those that it was never taken for share the least.
    let least = in_order.iter().copied().fold(f64::INFINITY, f64::min);
    let named = ObjectClass::BUILT_IN.into_iter().zip(in_order).filter(|p| p.1 > least * (1.0 + 1e-9));
    let mut listed: Vec<(ObjectClass, f64)> = named.collect();
    listed.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    Ok(listed)
}

/// What happened to an object in an update.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectChangeKind {
    /// Confirmed: it is now listed.
    Appeared,
    /// Its box changed by more than the reporting distance.
    Updated,
    /// Its likeliest class changed.
    Reclassified {
        /// Before.
        from: ObjectClass,
        /// Now.
        to: ObjectClass,
    },
    /// It set off.
    StartedMoving,
    /// It came to rest.
    Stopped,
    /// Its place was seen through: it is not there any more.
    Gone,
    /// It was gone and is back in its place.
    Reappeared,
    /// It is the same thing as another object, and is no longer listed.
    Merged {
        /// The object that stays.
        into: ObjectId,
    },
    /// It was dropped: it turned out to be no thing of its own, or it was gone and the list is at its limit.
    Forgotten,
}

/// A change of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ObjectChange {
    /// Which object.
    pub id: ObjectId,
    /// What happened.
    pub kind: ObjectChangeKind,
}

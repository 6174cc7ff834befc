//! What people said of objects. It outlives what the machine thinks: classes stay, what is no thing is not told again, and parts stay
//! together, until somebody takes it back.

use crate::ObjectId;
use percept_geometry::ObjectClass;
use serde::{Deserialize, Serialize};

/// What people said of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Annotation {
    /// What it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub class: Option<ObjectClass>,
    /// It is no thing. What is detected in its place is this, and not told.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub is_deleted: bool,
    /// It is a part of another, whose box holds it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part_of: Option<ObjectId>,
    /// Its box was drawn by a person, as a piece of what was detected as one.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub is_drawn: bool,
    /// What it was a piece of, before that was split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub piece_of: Option<ObjectId>,
}

impl Annotation {
    /// Whether nobody said anything.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether it is told as an object of its own.
    pub fn is_listed(&self) -> bool {
        !self.is_deleted && self.part_of.is_none()
    }
}

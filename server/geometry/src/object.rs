//! Object classes.

use serde::{Deserialize, Serialize};

/// What an object is, as far as the built-in classifier can tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectClass {
    /// A compact thing that fits no class.
    Unknown,
    /// Table or desk.
    Table,
    /// Chair.
    Chair,
    /// Shelf, cabinet or bookcase: tall and against a wall as a rule.
    Shelf,
    /// Box or crate.
    Box,
    /// Upright cylinder: bin, barrel, column.
    Cylinder,
    /// Person.
    Person,
}

impl ObjectClass {
    /// All classes, `Unknown` first.
    pub const ALL: [Self; 7] =
        [Self::Unknown, Self::Table, Self::Chair, Self::Shelf, Self::Box, Self::Cylinder, Self::Person];

    /// Lower-case name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Table => "table",
            Self::Chair => "chair",
            Self::Shelf => "shelf",
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::Person => "person",
        }
    }
}

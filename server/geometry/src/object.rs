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
    /// Car.
    Car,
    /// Van or minibus.
    Van,
    /// Truck.
    Truck,
    /// Bus.
    Bus,
    /// Bicycle with its rider.
    Cyclist,
    /// Motorcycle or scooter, with its rider if it has one.
    Motorcycle,
}

impl ObjectClass {
    /// All classes, `Unknown` first. New ones are added at the end: what was stored by earlier versions is a beginning
    /// of it.
    pub const ALL: [Self; 13] = [
        Self::Unknown,
        Self::Table,
        Self::Chair,
        Self::Shelf,
        Self::Box,
        Self::Cylinder,
        Self::Person,
        Self::Car,
        Self::Van,
        Self::Truck,
        Self::Bus,
        Self::Cyclist,
        Self::Motorcycle,
    ];

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
            Self::Car => "car",
            Self::Van => "van",
            Self::Truck => "truck",
            Self::Bus => "bus",
            Self::Cyclist => "cyclist",
            Self::Motorcycle => "motorcycle",
        }
    }
}

//! Protos to domain types, checked, and back. One file a noun.

pub mod detectors;
pub mod draco;
pub mod drawing;
pub mod evaluation;
pub mod exploration;
pub mod fleet;
pub mod geometry;
pub mod layers;
pub mod map_import;
pub mod maps;
pub mod navigation;
pub mod operations;
pub mod recordings;
pub mod room_routes;
pub mod rooms;
pub mod scene;
pub mod sensors;
pub mod server;
pub mod sessions;
pub mod streams;
pub mod toolbox;
pub mod updates;
mod zones;

use percept_service::reason;
use percept_service::{Error, Result};

/// The value of a field that must be there.
///
/// # Errors
/// `FIELD_MISSING` naming the field.
pub fn required<T>(field: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| Error::invalid(reason::FIELD_MISSING, field, format!("{field} is missing; set it")))
}

/// An enum value that this version does not know, or that was left unspecified.
pub fn unknown_enum(field: &str, value: i32) -> Error {
    Error::invalid(
        reason::ENUM_UNKNOWN,
        field,
        format!("{field} is {value}, which is unspecified or unknown; choose one of the contract's values"),
    )
}

/// The formats' limits under the service's.
pub fn format_limits(limits: &percept_service::Limits) -> percept_formats::Limits {
    percept_formats::Limits {
        max_points: limits.max_cloud_points as u64,
        max_pixels: limits.max_image_pixels as u64,
        // A decoded image may be larger than the file it came in.
        max_bytes: limits.max_image_pixels as u64 * 8,
    }
}

pub use percept_service::toolbox::format_error;

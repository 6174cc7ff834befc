//! What the crates below refuse, with reason and field.

use crate::Error;
use percept_perception::cloud::CloudError;
use percept_perception::registration::RegistrationError;

/// A cloud that could not be worked on.
pub fn cloud_error(e: CloudError) -> Error {
    match e {
        CloudError::Input(e) => e.into(),
        CloudError::VoxelTooSmall { voxel_size_m, coordinate_m, at_least_m } => Error::invalid(
            "VOXEL_TOO_SMALL",
            "voxel_size_m",
            format!(
                "voxel_size_m is {voxel_size_m}, too small for a coordinate of {coordinate_m} m; use at least {at_least_m}"
            ),
        ),
    }
}

/// Clouds that could not be registered at all.
pub fn registration_error(e: RegistrationError) -> Error {
    let field = match e {
        RegistrationError::Cloud(e) => return cloud_error(e),
        RegistrationError::BadParam { field, .. } | RegistrationError::TooFewPoints { field, .. } => field,
        RegistrationError::Missing { cloud, .. } => cloud,
    };
    Error::invalid("REGISTRATION_INVALID", field, e.to_string())
}

/// A file that did not decode, or cannot be written.
pub fn format_error(e: percept_formats::FormatError) -> Error {
    Error::invalid("FILE_INVALID", "data", format!("data does not decode: {e}"))
}

//! Messages to geometry, and geometry to messages.
//!
//! Comes in: decoded messages of any layout that drivers send. Goes out: checked types of `percept_geometry`, in the frame of
//! the message's header, metres and radians. Nothing is guessed quietly: what was dropped is counted, and how points' times
//! were read is told.

mod camera;
mod cloud;
mod compressed;
mod image;
mod motion;
mod picture;
mod publish;
mod publish_sensors;
mod rvl;
mod scan;
mod times;

pub use camera::{intrinsics, rectified_intrinsics};
pub use cloud::{Cloud, cloud};
pub use compressed::{compressed_color, compressed_depth};
pub use image::{color, depth};
pub use motion::{Grid, grid, imu, odometry, pose, transform};
pub use publish::{
    cloud_message, color_message, depth_message, grid_message, path_message, pose_covariance, pose_message,
    transform_message,
};
pub use publish_sensors::{
    camera_info_message, imu_message, odometry_message, pose_with_covariance_message, scan_message,
};
pub use scan::scan;
pub use times::{PointTimes, TimeUnit};

use percept_geometry::GeometryError;

/// Why a message does not say what its type is for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConvertError {
    /// A field does not say what it should.
    #[error("{message}, {field}: {found} found, expected {expected}")]
    Invalid {
        /// Type of the message.
        message: &'static str,
        /// Path of the field.
        field: String,
        /// What is there.
        found: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A field that is needed is not there.
    #[error("{message}: {field} is missing; {remedy}")]
    Missing {
        /// Type of the message.
        message: &'static str,
        /// Field.
        field: &'static str,
        /// What to do.
        remedy: &'static str,
    },
    /// Fewer bytes than width, height and steps declare.
    #[error("{message}, data: {needed} bytes are declared by width, height and steps, {available} are there")]
    Truncated {
        /// Type of the message.
        message: &'static str,
        /// Bytes declared.
        needed: u64,
        /// Bytes that are there.
        available: u64,
    },
    /// A size beyond the limit; nothing was allocated.
    #[error("{message}, {field}: {value} exceeds the limit of {limit}")]
    TooLarge {
        /// Type of the message.
        message: &'static str,
        /// What is limited.
        field: &'static str,
        /// Declared size.
        value: u64,
        /// Limit.
        limit: u64,
    },
    /// An image file inside the message is damaged.
    #[error("{message}, data: {reason}")]
    Picture {
        /// Type of the message.
        message: &'static str,
        /// The decoder's word.
        reason: String,
    },
    /// The values do not make a valid geometry type.
    #[error("{message}, {error}")]
    Geometry {
        /// Type of the message.
        message: &'static str,
        /// What is wrong with them.
        error: GeometryError,
    },
}

impl ConvertError {
    fn invalid(message: &'static str, field: impl Into<String>, found: impl ToString, expected: &'static str) -> Self {
        let found = found.to_string().chars().take(80).collect();
        Self::Invalid { message, field: field.into(), found, expected }
    }

    fn geometry(message: &'static str) -> impl Fn(GeometryError) -> Self {
        move |error| Self::Geometry { message, error }
    }
}

/// Rows of `row_bytes` bytes, `step` apart, as they lie in `data`; a step of 0 is taken for rows without padding.
fn rows<'a>(
    message: &'static str,
    data: &'a [u8],
    height: u32,
    row_bytes: u64,
    step: u32,
) -> Result<impl Iterator<Item = &'a [u8]>, ConvertError> {
    let step = if step == 0 || height <= 1 { row_bytes } else { u64::from(step) };
    if step < row_bytes {
        let expected = "at least the bytes of a row's points or pixels";
        return Err(ConvertError::invalid(message, "step of rows", step, expected));
    }
    let needed = u64::from(height).saturating_sub(1).saturating_mul(step).saturating_add(row_bytes);
    let available = data.len() as u64;
    if needed > available {
        return Err(ConvertError::Truncated { message, needed, available });
    }
    // Both fit: they are within the data.
    let (row_bytes, step) = (row_bytes as usize, step as usize);
    Ok((0..height as usize).map(move |row| data.get(row * step..row * step + row_bytes).unwrap_or_default()))
}

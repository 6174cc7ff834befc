//! Clouds of files, and files of clouds.

use super::format_error;
use crate::{Error, Limits, Result};
pub use percept_formats::CloudFormat;
use percept_formats::FormatError;
use percept_geometry::PointCloud;

/// Ending of a file's name.
pub const fn suffix(format: CloudFormat) -> &'static str {
    match format {
        CloudFormat::Ply(_) => "ply",
        CloudFormat::Pcd(_) => "pcd",
        CloudFormat::Xyz => "xyz",
        CloudFormat::KittiBin => "bin",
        CloudFormat::Las => "las",
        CloudFormat::Laz => "laz",
    }
}

/// Points of a file relative to an origin, metres; the format is told by the content if it is not said.
///
/// # Errors
/// `FILE_INVALID`, `FORMAT_UNKNOWN`, `FORMAT_MISMATCH`, `CLOUD_TOO_LARGE`.
pub fn decode_cloud(bytes: &[u8], format: Option<CloudFormat>, limits: &Limits) -> Result<(PointCloud, [f64; 3])> {
    let name_hint = format.map_or(String::new(), |f| format!("cloud.{}", suffix(f)));
    let found = percept_formats::sniff_cloud(bytes, &name_hint).map_err(|_| {
        let words = "format is not told by the first bytes of data; say it";
        Error::invalid("FORMAT_UNKNOWN", "format", words)
    })?;
    if let Some(said) = format.filter(|f| suffix(*f) != suffix(found)) {
        let (said, found) = (suffix(said), suffix(found));
        let words = format!("format is {said} but data begins as {found} does; leave format out, or say the true one");
        // LAS and LAZ differ by a bit of the header, which decides.
        if !(said.starts_with("la") && found.starts_with("la")) {
            return Err(Error::invalid("FORMAT_MISMATCH", "format", words));
        }
    }
    let bounds = percept_formats::Limits {
        max_points: limits.max_cloud_points as u64,
        max_pixels: limits.max_image_pixels as u64,
        max_bytes: limits.max_upload_bytes as u64,
    };
    match percept_formats::load_cloud(bytes, &name_hint, &bounds) {
        Ok(file) => Ok((file.cloud, file.origin_m)),
        Err(e @ FormatError::TooLarge { .. }) => {
            Err(Error::exhausted("CLOUD_TOO_LARGE", "data", format!("{e}; downsample or split the cloud")))
        }
        Err(e) => Err(format_error(e)),
    }
}

/// A file of points that are relative to an origin, metres.
///
/// # Errors
/// `FILE_INVALID` for an origin that the format cannot keep.
pub fn encode_cloud(cloud: &PointCloud, origin_m: [f64; 3], format: CloudFormat) -> Result<Vec<u8>> {
    percept_formats::save_cloud(cloud, origin_m, format).map_err(|e| match e {
        FormatError::Unsupported { field: "origin_m", .. } => {
            Error::invalid("ORIGIN_UNSUPPORTED", "origin_m", e.to_string())
        }
        e => format_error(e),
    })
}

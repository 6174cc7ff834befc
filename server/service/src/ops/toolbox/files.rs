//! Clouds of files, and files of clouds.

use super::format_error;
use crate::{Error, Limits, Result};
use percept_formats::{kitti, pcd, ply};
use percept_geometry::PointCloud;

/// A cloud's file format; reading takes any variant of PLY and PCD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloudFormat {
    /// Binary little-endian PLY.
    Ply,
    /// PLY as text.
    PlyAscii,
    /// Binary PCD.
    Pcd,
    /// float32 x y z intensity, without a header.
    KittiBin,
}

impl CloudFormat {
    /// Ending of the file's name.
    pub const fn suffix(self) -> &'static str {
        match self {
            Self::Ply | Self::PlyAscii => "ply",
            Self::Pcd => "pcd",
            Self::KittiBin => "bin",
        }
    }

    /// By the first bytes.
    fn told_by(bytes: &[u8]) -> Result<Self> {
        let starts = |word: &[u8]| bytes.starts_with(word);
        if starts(b"ply") {
            return Ok(Self::Ply);
        }
        if starts(b"# .PCD") || starts(b"VERSION") {
            return Ok(Self::Pcd);
        }
        let words = "format is not told by the first bytes of data; say it";
        Err(Error::invalid("FORMAT_UNKNOWN", "format", words))
    }
}

/// Points of a file; the format is told by the first bytes if it is not said.
///
/// # Errors
/// `FILE_INVALID`, `FORMAT_UNKNOWN`.
pub fn decode_cloud(bytes: &[u8], format: Option<CloudFormat>, limits: &Limits) -> Result<PointCloud> {
    let format = format.map_or_else(|| CloudFormat::told_by(bytes), Ok)?;
    let limits = percept_formats::Limits {
        max_points: limits.max_cloud_points as u64,
        max_pixels: limits.max_image_pixels as u64,
        max_bytes: limits.max_upload_bytes as u64,
    };
    match format {
        CloudFormat::Ply | CloudFormat::PlyAscii => ply::decode(bytes, &limits),
        CloudFormat::Pcd => pcd::decode(bytes, &limits).map(|f| f.cloud),
        CloudFormat::KittiBin => kitti::decode_bin(bytes, &limits),
    }
    .map_err(format_error)
}

/// A file of points.
///
/// # Errors
/// Clouds whose channels do not fit.
pub fn encode_cloud(cloud: &PointCloud, format: CloudFormat) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    match format {
        CloudFormat::Ply => ply::write(&mut out, cloud, ply::Encoding::BinaryLittleEndian),
        CloudFormat::PlyAscii => ply::write(&mut out, cloud, ply::Encoding::Ascii),
        CloudFormat::Pcd => pcd::write(&mut out, cloud),
        CloudFormat::KittiBin => kitti::write_bin(&mut out, cloud),
    }
    .map_err(format_error)?;
    Ok(out)
}

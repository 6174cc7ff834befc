//! How much a decoder may take, checked before memory is.

use crate::FormatError;
use std::io::Read;
use std::path::Path;

/// Largest sizes that a decoder accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Points of one cloud, nodes of one octree, faces of one mesh, or rows of one list.
    pub max_points: u64,
    /// Pixels (or cells) of one image.
    pub max_pixels: u64,
    /// Bytes of one file, compressed or not.
    pub max_bytes: u64,
}

impl Default for Limits {
    /// 20 million points, 64 megapixels, 1 GiB: beyond any single message of today's sensors.
    fn default() -> Self {
        Self { max_points: 20_000_000, max_pixels: 64_000_000, max_bytes: 1 << 30 }
    }
}

impl Limits {
    /// `count` as a length, if it is within `max_points`.
    pub(crate) fn points(&self, count: u64) -> Result<usize, FormatError> {
        check("num_points", count, self.max_points)
    }

    /// `count` nodes as a length, if it is within `max_points`.
    pub(crate) fn nodes(&self, count: u64) -> Result<usize, FormatError> {
        check("num_nodes", count, self.max_points)
    }

    /// `count` faces as a length, if it is within `max_points`.
    pub(crate) fn faces(&self, count: u64) -> Result<usize, FormatError> {
        check("num_faces", count, self.max_points)
    }

    /// `count` rows of a list as a length, if it is within `max_points`.
    pub(crate) fn rows(&self, count: u64) -> Result<usize, FormatError> {
        check("num_rows", count, self.max_points)
    }

    /// `width * height` as a length, if it is within `max_pixels`.
    pub(crate) fn pixels(&self, width: u64, height: u64) -> Result<usize, FormatError> {
        check("num_pixels", width.saturating_mul(height), self.max_pixels)
    }

    /// `count` as a length, if it is within `max_bytes`.
    pub(crate) fn bytes(&self, count: u64) -> Result<usize, FormatError> {
        check("num_bytes", count, self.max_bytes)
    }
}

fn check(field: &'static str, value: u64, limit: u64) -> Result<usize, FormatError> {
    match usize::try_from(value) {
        Ok(n) if value <= limit => Ok(n),
        _ => Err(FormatError::TooLarge { field, value, limit }),
    }
}

/// Reads a whole file of at most `limits.max_bytes`.
///
/// # Errors
/// `Io` as the file system says; `TooLarge` before reading if the file is.
pub fn read_file(path: &Path, limits: &Limits) -> Result<Vec<u8>, FormatError> {
    let io = |e: std::io::Error| FormatError::io(path, &e);
    let file = std::fs::File::open(path).map_err(io)?;
    let declared = file.metadata().map_err(io)?.len();
    let mut bytes = Vec::with_capacity(limits.bytes(declared).map_err(|e| e.in_file(path))?);
    // A pipe or a growing file may hold more than it declared.
    file.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
    limits.bytes(bytes.len() as u64).map_err(|e| e.in_file(path))?;
    Ok(bytes)
}

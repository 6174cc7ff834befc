//! What can be wrong with bytes from outside: facts, for the caller to put into words.

use percept_geometry::GeometryError;
use std::path::{Path, PathBuf};

/// Where in a file or message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line of a text, the first being 1.
    Line(u64),
    /// Offset in bytes, the first being 0.
    Byte(u64),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Line(n) => write!(f, "line {n}"),
            Self::Byte(n) => write!(f, "byte {n}"),
        }
    }
}

/// Why bytes could not be read or a value not be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FormatError {
    /// A field is there but does not say what it should.
    #[error("{format}, {place}: {field} is '{found}', expected {expected}")]
    Malformed {
        /// Format name.
        format: &'static str,
        /// Where.
        place: Place,
        /// Field name.
        field: String,
        /// What was found, shortened to 40 characters.
        found: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A field that the format or we need is not there.
    #[error("{format}: {field} is missing")]
    Missing {
        /// Format name.
        format: &'static str,
        /// Field name.
        field: &'static str,
    },
    /// Fewer bytes than the header declares.
    #[error("{format}: {field} needs {needed} bytes, {available} are there")]
    Truncated {
        /// Format name.
        format: &'static str,
        /// Field name.
        field: &'static str,
        /// Bytes (of text: least bytes) that the declared size takes.
        needed: u64,
        /// Bytes left.
        available: u64,
    },
    /// A declared size beyond the caller's limit; nothing was allocated.
    #[error("{field}: {value} exceeds the limit of {limit}")]
    TooLarge {
        /// What is limited: `num_points`, `num_rows`, `num_pixels`, `num_bytes`.
        field: &'static str,
        /// Declared size.
        value: u64,
        /// Limit.
        limit: u64,
    },
    /// Sound, but a variant that is not read here.
    #[error("{format}: {field} '{value}' is not supported, only {supported}")]
    Unsupported {
        /// Format name.
        format: &'static str,
        /// Field name.
        field: &'static str,
        /// Value found.
        value: String,
        /// What is read.
        supported: &'static str,
    },
    /// The image decoder's or encoder's word.
    #[error("{format}: {reason}")]
    Image {
        /// Format name.
        format: &'static str,
        /// Reason as the codec gave it.
        reason: String,
    },
    /// The values do not make a valid geometry type.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// The file system refused.
    #[error("{}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Kind of refusal.
        kind: std::io::ErrorKind,
        /// Reason as the system gave it.
        reason: String,
    },
    /// A text with a row for each of something else has more or fewer.
    #[error("{num_rows} rows for {num_expected} {of}; write one for each")]
    RowsMismatch {
        /// Rows that are there.
        num_rows: usize,
        /// Rows that there should be.
        num_expected: usize,
        /// What each row is for.
        of: &'static str,
    },
    /// A calibration of images of another size.
    #[error(
        "{field} is {declared_width} x {declared_height}, the images are {width} x {height}; calibrate for their size"
    )]
    ImageSize {
        /// What declares a size.
        field: &'static str,
        /// Columns declared.
        declared_width: usize,
        /// Rows declared.
        declared_height: usize,
        /// Columns of the images.
        width: usize,
        /// Rows of the images.
        height: usize,
    },
    /// Depth and colour that do not go together, frame by frame.
    #[error(
        "{num_color} colour images for {num_depth} depth images, and {lone} has no other; add or remove one, or leave colour out"
    )]
    UnpairedImages {
        /// Colour images.
        num_color: usize,
        /// Depth images.
        num_depth: usize,
        /// The first file, with its folder, that is alone.
        lone: String,
    },
    /// The writer that was handed in refused.
    #[error("write: {reason}")]
    Write {
        /// Kind of refusal.
        kind: std::io::ErrorKind,
        /// Reason as the writer gave it.
        reason: String,
    },
    /// A recording of ROS messages that cannot be read, or has nothing to replay, in its reader's words; when one is opened,
    /// they begin with the file.
    #[error("{reason}")]
    Recording {
        /// What is wrong, and a remedy.
        reason: String,
    },
    /// A path that holds none of the data sets that are known.
    #[error(
        "{}: not a 7-Scenes, TUM RGB-D, EuRoC (mav0) or KITTI velodyne folder, RGB-D images in folders color and depth, CARMEN log, \
         recording of ROS (.mcap, .db3, .bag), nor PCD or PLY cloud(s)",
        path.display()
    )]
    Unrecognised {
        /// The path.
        path: PathBuf,
    },
    /// An error of the file named.
    #[error("{}: {error}", path.display())]
    InFile {
        /// File.
        path: PathBuf,
        /// What is wrong in it.
        error: Box<FormatError>,
    },
}

impl FormatError {
    /// This error, saying in which file it was found.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Io { .. } | Self::InFile { .. } | Self::Unrecognised { .. } | Self::Recording { .. } => self,
            error => Self::InFile { path: path.to_owned(), error: Box::new(error) },
        }
    }

    pub(crate) fn io(path: &Path, error: &std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), kind: error.kind(), reason: error.to_string() }
    }

    pub(crate) fn recording(error: impl std::fmt::Display) -> Self {
        Self::Recording { reason: error.to_string() }
    }

    pub(crate) fn malformed(
        format: &'static str,
        place: Place,
        field: impl Into<String>,
        found: &[u8],
        expected: &'static str,
    ) -> Self {
        let found = String::from_utf8_lossy(&found[..found.len().min(160)]).chars().take(40).collect();
        Self::Malformed { format, place, field: field.into(), found, expected }
    }
}

impl From<std::io::Error> for FormatError {
    fn from(error: std::io::Error) -> Self {
        Self::Write { kind: error.kind(), reason: error.to_string() }
    }
}

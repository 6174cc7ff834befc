//! Why there is no recording.

use percept_bags::BagError;
use std::path::PathBuf;

/// Why a recording cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The folder is not there and cannot be made.
    #[error("{}: {error}; name a folder that can be written to", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The system's refusal.
        error: std::io::Error,
    },
    /// The first file cannot be begun, perhaps because there is one of its name.
    #[error(transparent)]
    File(#[from] BagError),
    /// The name is none of a file.
    #[error("name: '{name}' is none of a file; send 1 to {limit} letters, digits, '.', '-' or '_', no '.' first")]
    Name {
        /// The name as it was given, shortened.
        name: String,
        /// Characters of a name at most.
        limit: usize,
    },
    /// The system gives no thread.
    #[error("no thread for the recording: {0}")]
    Thread(std::io::Error),
}

impl RecordError {
    pub(crate) fn is_disk_full(&self) -> bool {
        match self {
            Self::Folder { error, .. } => error.kind() == std::io::ErrorKind::StorageFull,
            Self::File(error) => crate::files::is_disk_full(error),
            Self::Name { .. } | Self::Thread(_) => false,
        }
    }
}

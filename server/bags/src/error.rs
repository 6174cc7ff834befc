//! What can be wrong with a recording.

use std::path::{Path, PathBuf};

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The file system refused.
    #[error("{}: {error}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The refusal.
        error: std::io::Error,
    },
    /// None of the containers that are known.
    #[error("{}: neither MCAP, nor a ROS 1 bag of version 2.0, nor rosbag2's SQLite, by its first bytes; unpack it, or convert it by `rosbags-convert`", path.display())]
    Unrecognised {
        /// The file.
        path: PathBuf,
    },
    /// A file that was packed as a whole: messages cannot be read from its middle.
    #[error("{}: packed by zstd as a whole; unpack it first: `zstd -d {}`", path.display(), path.display())]
    Packed {
        /// The file.
        path: PathBuf,
    },
    /// A folder without a recording.
    #[error("{}: no .mcap, .bag or .db3 file in this folder", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// SQLite refused, or the tables are not those of rosbag2.
    #[error("{}: {reason}; repair it, e.g. by `sqlite3 FILE .recover`", path.display())]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// SQLite's word.
        reason: String,
    },
    /// A recording of more topics or types than its format can number.
    #[error("{}: more than 65535 topics or types; write another file", path.display())]
    TooManyChannels {
        /// The file.
        path: PathBuf,
    },
}

impl BagError {
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + '_ {
        move |error| Self::Io { path: path.to_owned(), error }
    }

    pub(crate) fn sqlite(path: &Path) -> impl Fn(rusqlite::Error) -> Self + '_ {
        move |error| {
            let reason = match error {
                rusqlite::Error::InvalidQuery => "has no tables `topics` and `messages`".to_owned(),
                other => other.to_string(),
            };
            Self::Sqlite { path: path.to_owned(), reason }
        }
    }
}

/// Something that was passed over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// The file.
    pub path: PathBuf,
    /// Where, bytes from its beginning.
    pub byte: u64,
    /// What was found, and what was done.
    pub what: String,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, byte {}: {}", self.path.display(), self.byte, self.what)
    }
}

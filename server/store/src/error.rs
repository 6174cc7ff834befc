//! Why the store could not do it: facts, and whether somebody else owns the data now.

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::blob_id::{BlobId, InvalidBlobId};

/// Why a call to the store failed.
///
/// A write that fails was **not acknowledged**: after [`StoreError::Full`], [`StoreError::Io`],
/// [`StoreError::Stalled`] and [`StoreError::Fenced`] it may or may not be there after the next open.
/// All other variants of a write mean that nothing was written.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StoreError {
    /// Another writer has opened the data since; this one can confirm nothing any more.
    #[error("store: another writer took over after epoch {epoch}; reopen to take it back")]
    Fenced {
        /// The epoch that this writer held, 0 if it never had one.
        epoch: u64,
    },
    /// Another process (or another open store in this one) holds the directory.
    #[error("data directory {} is in use by another process; stop it, or give another directory", path.display())]
    DirectoryInUse {
        /// The directory as given.
        path: PathBuf,
    },
    /// The catalogue has a session of this id.
    #[error("session {id} exists already")]
    AlreadyExists {
        /// The id.
        id: String,
    },
    /// The data were written by a newer version of this program.
    #[error("store: format {found} is newer than {supported}, the newest that this version reads; upgrade percept")]
    FormatTooNew {
        /// Number in the data.
        found: u32,
        /// Newest number known here.
        supported: u32,
    },
    /// Data of an older format are to be read only.
    #[error("store: format {found} is older than {current}; start percept once on these data to bring them up to date")]
    FormatTooOld {
        /// Number in the data.
        found: u32,
        /// Number that is needed.
        current: u32,
    },
    /// Data were to be read only, and there are none.
    #[error("no data of percept are there")]
    NoData,
    /// The catalogue has no session of this id.
    #[error("session {id} does not exist")]
    NoSession {
        /// The id.
        id: String,
    },
    /// The `FORMAT` object does not hold a number: this is not a percept store, or it is damaged.
    #[error("store: FORMAT is not readable: {text:?}")]
    FormatUnreadable {
        /// What it holds, shortened.
        text: String,
    },
    /// The directory for copies of blobs cannot be read and written.
    #[error("cannot keep copies of blobs in {}: {source}; name a directory that can be written, or none", directory.display())]
    CacheUnusable {
        /// The directory.
        directory: PathBuf,
        /// What the system says.
        source: Arc<std::io::Error>,
    },
    /// A text that names no place for data.
    #[error("data location {text:?} is not {requirement}")]
    InvalidLocation {
        /// The text, shortened.
        text: String,
        /// What it has to be.
        requirement: &'static str,
    },
    /// Two writers created the same object, so nothing could keep stale writers away.
    #[error(
        "object store: {num_won} of {num_writers} writers created the same object; it does not honour `If-None-Match`: \
         use a service that does"
    )]
    CreateNotAtomic {
        /// Writers that were told that they created it.
        num_won: usize,
        /// Writers that tried.
        num_writers: usize,
    },
    /// Another node that may be alive has the session.
    #[error("session belongs to the node at {address}; ask there")]
    Elsewhere {
        /// The address that the other node advertises.
        address: String,
    },
    /// This node could not renew its heartbeat in time: what it held may be another's.
    #[error("store: this node could not write its heartbeat; its sessions may be another node's")]
    NodeSilent,
    /// No space or quota left where the data live.
    #[error("store: no space left; free some and try again")]
    Full,
    /// The disk or the object store failed.
    #[error("store: {operation} failed")]
    Io {
        /// What was being done.
        operation: &'static str,
        /// What the layer below said.
        #[source]
        source: Arc<dyn Error + Send + Sync>,
    },
    /// A write was not durable in time; the layer below is still trying.
    #[error("store: not durable after {waited:?}")]
    Stalled {
        /// How long the write waited.
        waited: Duration,
    },
    /// What was read back is not what was written.
    #[error("store: stored data are damaged ({operation})")]
    Corrupt {
        /// What was being done.
        operation: &'static str,
        /// What the layer below said.
        #[source]
        source: Arc<dyn Error + Send + Sync>,
    },
    /// The store was closed.
    #[error("store: closed")]
    Closed,
    /// A key or a part of one breaks the rules of [`crate::Key`].
    #[error("key: {segment:?} is not {requirement}")]
    InvalidKey {
        /// The offending part, shortened.
        segment: String,
        /// What it has to be.
        requirement: &'static str,
    },
    /// A record's value is larger than the limit; large things are blobs.
    #[error("record {key}: {num_bytes} bytes exceed the limit of {limit}; store it as a blob")]
    RecordTooLarge {
        /// Its key.
        key: String,
        /// Its size.
        num_bytes: usize,
        /// Most bytes that a value may have.
        limit: usize,
    },
    /// A batch is larger than the limit.
    #[error("batch: {num_bytes} bytes exceed the limit of {limit}; split it")]
    BatchTooLarge {
        /// Keys and values together.
        num_bytes: usize,
        /// Most bytes that a batch may have.
        limit: usize,
    },
    /// A blob is larger than the limit.
    #[error("blob: {num_bytes} bytes exceed the limit of {limit}")]
    BlobTooLarge {
        /// Its size.
        num_bytes: usize,
        /// Most bytes that a blob may have.
        limit: usize,
    },
    /// No blob has this identity.
    #[error("blob {id} is not there")]
    BlobMissing {
        /// The blob asked for.
        id: BlobId,
    },
    /// A blob's bytes no longer have the hash that names it.
    #[error("blob {id} is damaged: its content does not have this hash")]
    BlobCorrupt {
        /// The blob asked for.
        id: BlobId,
    },
    /// A text names no blob.
    #[error(transparent)]
    InvalidBlobId(#[from] InvalidBlobId),
    /// An export breaks off or does not follow the framing of [`crate::archive`].
    #[error("export: {reason} at byte {offset}")]
    ExportMalformed {
        /// What is wrong.
        reason: &'static str,
        /// Where.
        offset: u64,
    },
    /// An export of another version than this program writes.
    #[error(
        "export: version {found} cannot be read, only {supported}; export again with the percept that is to read it"
    )]
    ExportVersion {
        /// Number in the export.
        found: u32,
        /// Number that is read here.
        supported: u32,
    },
    /// What went wrong with one of several sessions.
    #[error("session {id}")]
    InSession {
        /// Its id.
        id: String,
        /// What went wrong.
        #[source]
        source: Box<StoreError>,
    },
}

impl StoreError {
    /// Puts an error of the object store into our words.
    pub(crate) fn from_object(operation: &'static str, error: object_store::Error) -> Self {
        if is_full(&error) { Self::Full } else { Self::Io { operation, source: Arc::new(error) } }
    }

    /// Puts an I/O error into our words.
    pub(crate) fn from_io(operation: &'static str, error: std::io::Error) -> Self {
        if is_full(&error) { Self::Full } else { Self::Io { operation, source: Arc::new(error) } }
    }

    /// Puts an error of SlateDB, opened at `epoch`, into our words.
    pub(crate) fn from_slate(operation: &'static str, epoch: u64, error: slatedb::Error) -> Self {
        use slatedb::{CloseReason, ErrorKind};
        match error.kind() {
            ErrorKind::Closed(CloseReason::Fenced) => Self::Fenced { epoch },
            ErrorKind::Closed(CloseReason::Clean) => Self::Closed,
            ErrorKind::Data => Self::Corrupt { operation, source: Arc::new(error) },
            _ if is_full(&error) => Self::Full,
            _ => Self::Io { operation, source: Arc::new(error) },
        }
    }
}

/// Whether some cause of `error` is a full disk or an exhausted quota.
pub(crate) fn is_full(error: &(dyn Error + 'static)) -> bool {
    use std::io::ErrorKind;
    let mut current = Some(error);
    while let Some(cause) = current {
        // Causes are kept behind `Arc` by SlateDB; `io::Error::source` skips what it wraps.
        let io = cause
            .downcast_ref::<std::io::Error>()
            .or_else(|| cause.downcast_ref::<Arc<std::io::Error>>().map(AsRef::as_ref));
        if let Some(io) = io {
            if matches!(io.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) {
                return true;
            }
            if io.get_ref().is_some_and(|inner| is_full(inner)) {
                return true;
            }
        }
        if let Some(object) = cause.downcast_ref::<Arc<object_store::Error>>() {
            return is_full(object.as_ref());
        }
        current = cause.source();
    }
    false
}

/// The first 64 characters, for messages that quote what a caller sent.
pub(crate) fn shortened(text: &str) -> String {
    text.chars().take(64).collect()
}

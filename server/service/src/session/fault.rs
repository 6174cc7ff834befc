//! What is wrong with a session for good, and which faults of the storage pass.

use super::records::Unreadable;
use crate::reason;
use crate::{Error, ErrorCode};
use percept_store::StoreError;

/// Why a session is set apart: it is not written any more, and read only as far as it is whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Stable, upper-case.
    pub reason: &'static str,
    /// For the operator.
    pub message: String,
}

impl Fault {
    pub(crate) fn new(reason: &'static str, message: impl Into<String>) -> Self {
        Self { reason, message: message.into() }
    }

    /// What a caller is told who wants to change the session.
    pub(crate) fn error(&self) -> Error {
        let words = format!(
            "the session is set apart ({}): {}; read or export what is whole, then restore it from a backup or delete it",
            self.reason, self.message
        );
        Error::new(ErrorCode::FailedPrecondition, reason::SESSION_FAULTED, words)
    }
}

/// Why something could not be done with a session's data.
#[derive(Debug, Clone)]
pub(crate) enum Trouble {
    /// It may go well later.
    Passing(Error),
    /// It will not.
    Lasting(Fault),
    /// Somebody else owns the data.
    Fenced,
}

impl Trouble {
    /// What a caller is told.
    pub(crate) fn error(&self) -> Error {
        match self {
            Self::Passing(error) => error.clone(),
            Self::Lasting(fault) => fault.error(),
            Self::Fenced => fenced(),
        }
    }
}

impl From<StoreError> for Trouble {
    fn from(e: StoreError) -> Self {
        match &e {
            StoreError::Fenced { .. } => Self::Fenced,
            StoreError::Elsewhere { .. } | StoreError::NodeSilent => Self::Passing(store_error(&e)),
            StoreError::Full | StoreError::Closed | StoreError::Stalled { .. } | StoreError::Io { .. } => {
                Self::Passing(store_error(&e))
            }
            StoreError::Corrupt { .. } | StoreError::BlobMissing { .. } | StoreError::BlobCorrupt { .. } => {
                Self::Lasting(Fault::new(reason::DATA_DAMAGED, e.to_string()))
            }
            StoreError::RecordTooLarge { .. } | StoreError::BatchTooLarge { .. } | StoreError::BlobTooLarge { .. } => {
                Self::Lasting(Fault::new(reason::RECORD_TOO_LARGE, e.to_string()))
            }
            _ => Self::Lasting(Fault::new(reason::STORE_REFUSED, e.to_string())),
        }
    }
}

impl From<Unreadable> for Trouble {
    fn from(e: Unreadable) -> Self {
        Self::Lasting(Fault::new(reason::DATA_DAMAGED, e.to_string()))
    }
}

impl From<Error> for Trouble {
    fn from(e: Error) -> Self {
        match e.code {
            ErrorCode::Internal => Self::Lasting(Fault::new("INTERNAL", e.message)),
            _ => Self::Passing(e),
        }
    }
}

fn fenced() -> Error {
    Error::new(
        ErrorCode::Unavailable,
        reason::STORAGE_FENCED,
        "another server has taken over the session; talk to that one",
    )
}

/// The storage's facts in the caller's words.
pub(crate) fn store_error(e: &StoreError) -> Error {
    match e {
        StoreError::Full => Error::exhausted(reason::STORAGE_FULL, "", "no space left where the data live; free some"),
        StoreError::Fenced { .. } => fenced(),
        StoreError::Elsewhere { address } => Error::elsewhere("", address),
        StoreError::NodeSilent => {
            let words = "this server has not reached the shared storage for some seconds and left its sessions to others; \
                         try again, or ask another server";
            Error::new(ErrorCode::Unavailable, reason::NODE_SILENT, words)
        }
        StoreError::Closed => Error::new(ErrorCode::Unavailable, reason::STOPPING, "the server is stopping; try again"),
        StoreError::Stalled { .. } | StoreError::Io { .. } => {
            tracing::error!(error = ?e, "storage fault");
            let words = "the storage does not take data; the server's log has the cause";
            Error::new(ErrorCode::Unavailable, reason::STORAGE_FAULT, words)
        }
        other => Error::internal(other),
    }
}

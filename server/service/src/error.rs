//! The one error that operations answer with, whichever door was used.

use crate::{ErrorCode, reason};
use std::time::Duration;

/// Why a request was not served: code, stable reason, sentence for the caller, offending field.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Error {
    /// Kind of failure.
    pub code: ErrorCode,
    /// Stable, upper-case, e.g. `SENSOR_NOT_FOUND`.
    pub reason: &'static str,
    /// Lower case, no full stop: field, value, remedy.
    pub message: String,
    /// Path of the offending field; empty if none.
    pub field: String,
    /// Where to ask instead; empty if that is no matter of where.
    pub server: String,
    /// When it may be tried again, if that is known.
    pub retry_after: Option<Duration>,
}

/// What every operation answers with.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Any code.
    pub fn new(code: ErrorCode, reason: &'static str, message: impl Into<String>) -> Self {
        Self { code, reason, message: message.into(), field: String::new(), server: String::new(), retry_after: None }
    }

    /// Bad input in `field`.
    pub fn invalid(reason: &'static str, field: impl Into<String>, message: impl Into<String>) -> Self {
        Self { field: field.into(), ..Self::new(ErrorCode::InvalidArgument, reason, message) }
    }

    /// Something named does not exist.
    pub fn not_found(reason: &'static str, field: impl Into<String>, message: impl Into<String>) -> Self {
        Self { field: field.into(), ..Self::new(ErrorCode::NotFound, reason, message) }
    }

    /// A limit was reached.
    pub fn exhausted(reason: &'static str, field: impl Into<String>, message: impl Into<String>) -> Self {
        Self { field: field.into(), ..Self::new(ErrorCode::ResourceExhausted, reason, message) }
    }

    /// A rate is used up; there is room again `after` a while.
    pub fn too_fast(reason: &'static str, message: impl Into<String>, after: Duration) -> Self {
        Self { retry_after: Some(after), ..Self::exhausted(reason, "", message) }
    }

    /// Another of the servers that share the data has the session.
    pub fn elsewhere(session: &str, server: &str) -> Self {
        let which = if session.is_empty() { "the session".to_owned() } else { format!("session_id {session:?}") };
        let words =
            format!("{which} is in use at the server {server}; ask that one, or try again when it has ended there");
        Self { server: server.to_owned(), ..Self::new(ErrorCode::Unavailable, reason::SESSION_ELSEWHERE, words) }
    }

    /// A fault of ours: the cause goes to the log, the caller learns only that it happened.
    pub fn internal(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "internal error");
        Self::new(ErrorCode::Internal, "INTERNAL", "internal error; the server's log has the cause")
    }

    /// The same error with `prefix.` before its field.
    pub fn within(mut self, prefix: &str) -> Self {
        self.field = if self.field.is_empty() { prefix.to_owned() } else { format!("{prefix}.{}", self.field) };
        self
    }
}

impl From<percept_geometry::GeometryError> for Error {
    fn from(e: percept_geometry::GeometryError) -> Self {
        use percept_geometry::GeometryError as G;
        match e {
            G::ShapeMismatch { field, expected, actual } => Self::invalid(
                reason::SIZE_MISMATCH,
                field,
                format!(
                    "{field} holds {actual} elements but its declared shape needs {expected}; send exactly that many"
                ),
            ),
            G::OutOfRange { field, value, requirement } => {
                Self::invalid(reason::OUT_OF_RANGE, field, format!("{field} is {value}; it must be {requirement}"))
            }
            G::NotUnitQuaternion { field, norm } => Self::invalid(
                reason::QUATERNION_NOT_UNIT,
                field,
                format!("{field} has a quaternion of norm {norm}; normalise it (order x, y, z, w)"),
            ),
        }
    }
}

/// Checks an identifier: 1 to 64 characters of a-z A-Z 0-9 _ -.
///
/// # Errors
/// `ID_INVALID` naming the field.
pub fn check_id(field: &str, id: &str) -> Result<()> {
    let fine = (1..=64).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
    if fine {
        return Ok(());
    }
    let shown: String = id.chars().take(80).collect();
    Err(Error::invalid(
        reason::ID_INVALID,
        field,
        format!("{field} is {shown:?}; use 1 to 64 characters of a-z A-Z 0-9 _ -"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_checked_at_both_sides_of_their_limits() {
        assert!(check_id("session_id", "a").is_ok());
        assert!(check_id("session_id", &"x".repeat(64)).is_ok());
        for bad in ["", "a/b", "ü", "a b", "..", &"x".repeat(65)] {
            assert_eq!(check_id("session_id", bad).unwrap_err().reason, "ID_INVALID", "{bad}");
        }
    }
}

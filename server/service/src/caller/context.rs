//! In whose name an operation is called.

use crate::{Error, ErrorCode};
use percept_identity::{Principal, Reason, Refusal};
use std::sync::Arc;
use std::time::Instant;

/// Goes with every call, from the door to its end.
#[derive(Debug, Clone)]
pub struct CallContext {
    /// Who calls.
    pub principal: Arc<Principal>,
    /// When the answer is of no use any more.
    pub deadline: Option<Instant>,
    /// Names the call in logs and traces.
    pub trace: String,
    /// Where it came from: an address, or the name of a door.
    pub peer: String,
}

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        let code = match refusal.reason {
            Reason::ProviderUnavailable => ErrorCode::Unavailable,
            _ => ErrorCode::Unauthenticated,
        };
        Self::new(code, refusal.reason.name(), refusal.reason.message())
    }
}

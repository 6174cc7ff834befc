//! The kinds of failures.

/// What kind of failure: decides the gRPC status, the HTTP status and whether to try again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorCode {
    /// The request is wrong whatever the state of the service: mend it.
    InvalidArgument,
    /// What was named does not exist.
    NotFound,
    /// It exists already, and differs.
    AlreadyExists,
    /// Right request, wrong state: do something else first.
    FailedPrecondition,
    /// Somebody else was quicker: look again at what is there now, then try again.
    Aborted,
    /// A limit or budget is used up.
    ResourceExhausted,
    /// Nobody, or nobody any more, that is known here: send credentials that hold.
    Unauthenticated,
    /// Known, and not allowed.
    PermissionDenied,
    /// The service is stopping, or a resource is gone for now: try again.
    Unavailable,
    /// The deadline passed.
    DeadlineExceeded,
    /// A fault of ours; the cause is in the log.
    Internal,
}

impl ErrorCode {
    /// Name of the gRPC code.
    pub const fn name(self) -> &'static str {
        match self {
            Self::InvalidArgument => "INVALID_ARGUMENT",
            Self::NotFound => "NOT_FOUND",
            Self::AlreadyExists => "ALREADY_EXISTS",
            Self::FailedPrecondition => "FAILED_PRECONDITION",
            Self::Aborted => "ABORTED",
            Self::ResourceExhausted => "RESOURCE_EXHAUSTED",
            Self::Unauthenticated => "UNAUTHENTICATED",
            Self::PermissionDenied => "PERMISSION_DENIED",
            Self::Unavailable => "UNAVAILABLE",
            Self::DeadlineExceeded => "DEADLINE_EXCEEDED",
            Self::Internal => "INTERNAL",
        }
    }
}

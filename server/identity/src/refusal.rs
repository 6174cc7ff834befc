//! Why credentials were not taken: a reason for the caller, the cause for the log.

use std::fmt;

/// What the caller is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reason {
    /// None were sent.
    Missing,
    /// They are not ours, not whole, or wrong. More is not said: whoever guesses learns nothing.
    Invalid,
    /// They were right until their time ran out.
    Expired,
    /// They are right, but not yet.
    NotYetValid,
    /// They were right until they were taken back.
    Revoked,
    /// They are right, and allow nothing here.
    WithoutGrant,
    /// Nobody can tell now: the identity provider's keys cannot be had.
    ProviderUnavailable,
}

impl Reason {
    /// Stable name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Missing => "CREDENTIALS_MISSING",
            Self::Invalid => "CREDENTIALS_INVALID",
            Self::Expired => "CREDENTIALS_EXPIRED",
            Self::NotYetValid => "CREDENTIALS_NOT_YET_VALID",
            Self::Revoked => "CREDENTIALS_REVOKED",
            Self::WithoutGrant => "CREDENTIALS_WITHOUT_GRANT",
            Self::ProviderUnavailable => "IDENTITY_PROVIDER_UNAVAILABLE",
        }
    }

    /// For the caller: what is wrong and what to do.
    pub const fn message(self) -> &'static str {
        match self {
            Self::Missing => "credentials are missing; send `authorization: Bearer` with a key or token",
            Self::Invalid => "the credentials are not valid here; send a key or token of this server",
            Self::Expired => "the credentials have expired; renew them",
            Self::NotYetValid => "the credentials are not valid yet; check this machine's clock, or wait",
            Self::Revoked => "the credentials were revoked; ask for new ones",
            Self::WithoutGrant => "the credentials are valid but grant nothing here; ask for a tenant and access",
            Self::ProviderUnavailable => "the identity provider cannot be reached to check the token; try again",
        }
    }
}

/// Credentials that were not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// For the caller.
    pub reason: Reason,
    /// For the audit log alone. It never holds a secret.
    pub cause: String,
}

impl Refusal {
    pub(crate) fn new(reason: Reason, cause: impl Into<String>) -> Self {
        Self { reason, cause: cause.into() }
    }

    pub(crate) fn invalid(cause: impl Into<String>) -> Self {
        Self::new(Reason::Invalid, cause)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason.message())
    }
}

impl std::error::Error for Refusal {}

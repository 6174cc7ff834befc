//! Who calls, and what they may do.
//!
//! Comes in: a bearer token, or the names in a certificate that the transport has verified. Goes out: a [`Principal`]
//! with its tenant and grants, or a [`Refusal`] that says no more than its holder may know. It knows no other crate of
//! percept, neither HTTP nor gRPC, and reads no network: keys of an identity provider come through a function that
//! the caller gives. Start with [`Authenticator`], then [`Principal`].
//!
//! Three kinds of credentials:
//! - `keys`: keys that percept makes and keeps by their digest, in a file (`percept keys`);
//! - `jwt`: tokens of an identity provider, checked with its public keys;
//! - `certificates`: names in a client's certificate.

mod authenticator;
mod certificates;
mod jwt;
mod keys;
mod pattern;
mod principal;
mod random;
mod refusal;
mod settings;

pub use authenticator::{Authenticator, Credentials, bearer};
pub use certificates::CertificateNames;
pub use jwt::{FetchKeys, JwtVerifier, KeySet, discovered_jwks_url, discovery_url};
pub use keys::file::{KeyFile, KeyFileError, KeyRecord, NewKey};
pub use keys::ring::KeyRing;
pub use pattern::{Pattern, PatternError};
pub use principal::{Access, DEFAULT_TENANT, Grant, Principal, Standing};
pub use random::{RandomError, random_token};
pub use refusal::{Reason, Refusal};
pub use settings::{AuthMode, AuthSettings, CertificateRule, JwtSettings, SettingsError, ZenohUser};

/// Seconds since the Unix epoch by this machine's clock.
pub fn now_s() -> u64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default().as_secs()
}

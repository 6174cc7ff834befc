//! Tokens of an identity provider: signed JWTs (RFC 7515, 7517, 7519), checked with the provider's public keys.
//!
//! The key's type decides which signatures are looked at, never the token alone, and there are no keys but public
//! ones: a token that says `none`, or that is signed by HMAC with a public key as the secret, finds nothing that could
//! take it. The signatures are ring's, which the house has already; libraries for JWT bring a second cryptography.

mod claims;
mod jwk;
mod token;
mod verifier;

pub use jwk::KeySet;
pub(crate) use token::Algorithm;
pub use verifier::{FetchKeys, JwtVerifier};

/// Where an issuer describes itself (OpenID Connect Discovery 1.0, section 4).
pub fn discovery_url(issuer: &str) -> String {
    format!("{}/.well-known/openid-configuration", issuer.trim_end_matches('/'))
}

/// Where the keys are, by the issuer's description of itself.
///
/// # Errors
/// It describes another issuer, or names no keys.
pub fn discovered_jwks_url(issuer: &str, document: &str) -> Result<String, String> {
    let document: serde_json::Value =
        serde_json::from_str(document).map_err(|e| format!("the issuer's description is no JSON: {e}"))?;
    let text = |name: &str| document.get(name).and_then(|v| v.as_str()).unwrap_or_default();
    if text("issuer") != issuer {
        return Err(format!("the description is of the issuer {:?}, not of {issuer:?}", text("issuer")));
    }
    match text("jwks_uri") {
        "" => Err("the issuer's description has no jwks_uri".to_owned()),
        url => Ok(url.to_owned()),
    }
}

//! From credentials to a principal.

use crate::certificates::Rules;
use crate::jwt::JwtVerifier;
use crate::keys::PREFIX;
use crate::{
    AuthMode, AuthSettings, CertificateNames, CertificateRule, FetchKeys, KeyRing, Principal, Reason, Refusal,
};
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};

/// The remedy where there is no file of keys.
const MAKE: &str = "; `percept keys create --file FILE --name NAME --scope admin` makes one with a key in it";

/// What a caller shows.
#[derive(Debug, Clone, Default)]
pub struct Credentials {
    /// Key or token; what came with `authorization: Bearer`.
    pub token: Option<String>,
    /// Names in the certificate that the transport has verified.
    pub certificate: Option<CertificateNames>,
}

/// Tells who a caller is.
pub struct Authenticator {
    settings: AuthSettings,
    keys: Option<KeyRing>,
    jwt: Option<JwtVerifier>,
    certificates: RwLock<Rules>,
    anonymous: Arc<Principal>,
}

impl Authenticator {
    /// By an operator's settings. `fetch` gets an identity provider's keys, if they come from no file.
    ///
    /// # Errors
    /// A sentence: what cannot be read.
    pub fn open(settings: &AuthSettings, fetch: FetchKeys) -> Result<Self, String> {
        let required = settings.mode == AuthMode::Required;
        let keys = (required && !settings.keys_file.is_empty()).then(|| {
            let path = Path::new(&settings.keys_file);
            let remedy = if path.exists() { "" } else { MAKE };
            KeyRing::open(path).map_err(|e| format!("auth.keys_file: {e}{remedy}"))
        });
        let jwt = (required && !settings.jwt.issuer.is_empty()).then(|| JwtVerifier::open(&settings.jwt, fetch));
        let mut certificates = Rules::default();
        certificates.replace(&settings.certificates);
        Ok(Self {
            settings: settings.clone(),
            certificates: RwLock::new(certificates),
            keys: keys.transpose()?,
            jwt: jwt.transpose().map_err(|e| format!("auth.{e}"))?,
            anonymous: Arc::new(Principal::anonymous()),
        })
    }

    /// What it was opened with; the rules for certificates may be others by now.
    pub fn settings(&self) -> &AuthSettings {
        &self.settings
    }

    /// Who shows these credentials. A token goes before a certificate: it was sent for this call.
    ///
    /// # Errors
    /// Why they are not taken.
    pub async fn authenticate(&self, credentials: &Credentials, now_s: u64) -> Result<Arc<Principal>, Refusal> {
        if self.settings.mode == AuthMode::None {
            return Ok(Arc::clone(&self.anonymous));
        }
        let principal = match (&credentials.token, &credentials.certificate) {
            (Some(token), _) if token.starts_with(PREFIX) => match &self.keys {
                Some(keys) => keys.authenticate(token, now_s)?,
                None => return Err(Refusal::invalid("a key, and auth.keys_file is not set")),
            },
            (Some(token), _) => match &self.jwt {
                Some(jwt) => jwt.authenticate(token, now_s).await?,
                None => return Err(Refusal::invalid("no key, and auth.jwt.issuer is not set")),
            },
            (None, Some(names)) if !self.rules().is_empty() => {
                let principal = self.rules().principal(names)?;
                if !principal.standing.holds(now_s) {
                    return Err(Refusal::new(Reason::Expired, "the certificate has expired since it was shown"));
                }
                principal
            }
            (None, _) => return Err(Refusal::new(Reason::Missing, "no credentials")),
        };
        Ok(Arc::new(principal))
    }

    fn rules(&self) -> std::sync::RwLockReadGuard<'_, Rules> {
        self.certificates.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts other rules for certificates in force; calls that go on under one that is gone lose their standing.
    pub fn set_certificates(&self, rules: &[CertificateRule]) {
        self.certificates.write().unwrap_or_else(PoisonError::into_inner).replace(rules);
    }

    /// Takes over keys that were made or revoked. Call it every second or so.
    pub fn refresh_keys(&self) {
        if let Some(keys) = &self.keys
            && let Err(error) = keys.refresh()
        {
            tracing::error!(%error, "auth.keys_file is not taken; its last keys stay in force");
        }
    }

    /// The same of the provider's keys, which may take as long as the provider does.
    pub async fn refresh_provider(&self) {
        if let Some(jwt) = &self.jwt {
            jwt.refresh().await;
        }
    }
}

/// The token in the value of an `authorization` header (RFC 6750, section 2.1).
///
/// # Errors
/// `Invalid` for any other scheme, or a token that is none.
pub fn bearer(value: &[u8]) -> Result<String, Refusal> {
    let text = std::str::from_utf8(value).map_err(|_| Refusal::invalid("authorization is no text"))?;
    let (scheme, token) = text.trim().split_once(' ').unwrap_or((text.trim(), ""));
    let token = token.trim_start_matches(' ');
    let fine = |b: u8| b.is_ascii_alphanumeric() || b"-._~+/=".contains(&b);
    if !scheme.eq_ignore_ascii_case("bearer") || token.is_empty() || !token.bytes().all(fine) {
        return Err(Refusal::invalid("authorization is not Bearer with a token"));
    }
    Ok(token.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bearer_token_is_read_and_other_schemes_refused() {
        for fine in ["Bearer abc.d_e-f~g", "bearer   abc.d_e-f~g", " BEARER abc.d_e-f~g "] {
            assert_eq!(bearer(fine.as_bytes()).unwrap(), "abc.d_e-f~g");
        }
        for bad in ["", "Bearer", "Bearer ", "Basic YTpi", "abc", "Bearer a b", "Bearer a,b", "Bearer ü"] {
            assert_eq!(bearer(bad.as_bytes()).unwrap_err().reason, Reason::Invalid, "{bad}");
        }
        assert!(bearer(&[0xff, 0xfe]).is_err());
    }
}

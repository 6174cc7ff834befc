//! What an operator sets.

use crate::principal::is_name;
use crate::{Access, DEFAULT_TENANT, Pattern};
use serde::{Deserialize, Serialize};

/// Whether callers are asked who they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AuthMode {
    /// Everybody is the admin of the tenant `default`.
    #[default]
    None,
    /// Every call needs credentials, but for health.
    Required,
}

/// Who may call, and what they may do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AuthSettings {
    /// Whether callers must say who they are: none (everybody is the admin of the tenant default; for one machine
    /// alone) or required.
    pub mode: AuthMode,
    /// File of the keys that `percept keys` makes, empty for none. It is read again when it changes.
    pub keys_file: String,
    /// Listen beyond this machine although mode is none: whoever reaches a door can then read and delete every map.
    pub allow_anonymous_beyond_loopback: bool,
    /// Serve the OpenAPI document, /docs and gRPC reflection without credentials. They hold nothing of yours.
    pub open_documents: bool,
    /// Serve /metrics without credentials. Otherwise it needs admin access to every session, since it sums up what all tenants do.
    /// A telemetry.listen beyond this machine asks nobody who they are, and needs it to be true.
    pub open_metrics: bool,
    /// Clients by the names in their certificates. An entry has subject ("cn:", "dns:" or "uri:" and a name), name
    /// (for the log; the subject's if absent), tenant, access (read, write or admin) and sessions (ids, with * for
    /// any characters).
    pub certificates: Vec<CertificateRule>,
    /// File of user:password lines with which zenoh clients prove who they are, empty for none.
    pub zenoh_users_file: String,
    /// What the users of that file may do. An entry has user, tenant, access and sessions.
    pub zenoh_users: Vec<ZenohUser>,
    /// Tokens of an identity provider (JWT).
    pub jwt: JwtSettings,
}

impl Default for AuthSettings {
    fn default() -> Self {
        Self {
            mode: AuthMode::None,
            keys_file: String::new(),
            allow_anonymous_beyond_loopback: false,
            open_documents: true,
            open_metrics: false,
            certificates: Vec::new(),
            zenoh_users_file: String::new(),
            zenoh_users: Vec::new(),
            jwt: JwtSettings::default(),
        }
    }
}

/// What the holder of a certificate may do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateRule {
    /// `cn:`, `dns:` or `uri:`, and the name.
    pub subject: String,
    /// For the audit log.
    #[serde(default)]
    pub name: String,
    /// Tenant of its holder.
    #[serde(default = "default_tenant")]
    pub tenant: String,
    /// What is allowed.
    pub access: Access,
    /// With which sessions.
    #[serde(default = "Pattern::all")]
    pub sessions: Pattern,
}

/// What a user of zenoh may do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZenohUser {
    /// As in the file of users.
    pub user: String,
    /// Tenant of its holder.
    #[serde(default = "default_tenant")]
    pub tenant: String,
    /// What is allowed.
    pub access: Access,
    /// With which sessions.
    #[serde(default = "Pattern::all")]
    pub sessions: Pattern,
}

fn default_tenant() -> String {
    DEFAULT_TENANT.to_owned()
}

/// Tokens of an identity provider (JWT).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JwtSettings {
    /// The provider, as its tokens name it (iss). An https URL (on this machine http, too), unless jwks_file or jwks_url
    /// says where its keys are. Empty: tokens are not taken.
    pub issuer: String,
    /// This service, as tokens name it (aud).
    pub audience: String,
    /// File with the provider's public keys (JWKS). It is read again when it changes.
    pub jwks_file: String,
    /// Where those keys are fetched from if there is no file, by https (on this machine http, too); empty: the issuer's
    /// /.well-known/openid-configuration tells.
    pub jwks_url: String,
    /// File with the certificates (PEM) that the provider's is checked by; empty: those of this system.
    pub ca_file: String,
    /// Signatures that are taken: RS256, RS384, RS512, PS256, PS384, PS512, ES256, ES384, EdDSA.
    pub algorithms: Vec<String>,
    /// How far the provider's clock may be off, seconds, 0 to 300.
    pub leeway_s: u64,
    /// Claim with the caller's name. A dot in a claim's name leads into it.
    pub name_claim: String,
    /// Claim with the caller's tenant.
    pub tenant_claim: String,
    /// Tenant of tokens without that claim; empty: they are refused.
    pub default_tenant: String,
    /// Claim with read, write or admin among its words, alone or as percept:read.
    pub access_claim: String,
    /// Claim with the patterns of the sessions; a token without it has access to all of its tenant's.
    pub sessions_claim: String,
}

impl Default for JwtSettings {
    fn default() -> Self {
        Self {
            issuer: String::new(),
            audience: "percept".to_owned(),
            jwks_file: String::new(),
            jwks_url: String::new(),
            ca_file: String::new(),
            algorithms: ["RS256", "PS256", "ES256", "EdDSA"].map(str::to_owned).to_vec(),
            leeway_s: 60,
            name_claim: "sub".to_owned(),
            tenant_claim: "percept_tenant".to_owned(),
            default_tenant: String::new(),
            access_claim: "scope".to_owned(),
            sessions_claim: "percept_sessions".to_owned(),
        }
    }
}

/// A setting that does not hold: its path below `auth`, what is wrong, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("auth.{field} is {value}; {remedy}")]
pub struct SettingsError {
    /// Below `auth`, such as `jwt.leeway_s`.
    pub field: String,
    /// What it is.
    pub value: String,
    /// What to do.
    pub remedy: String,
}

impl SettingsError {
    pub(crate) fn new(field: &str, value: impl Into<String>, remedy: &str) -> Self {
        Self { field: field.to_owned(), value: value.into(), remedy: remedy.to_owned() }
    }
}

impl AuthSettings {
    /// Checks every value, and that somebody can be known if everybody must be.
    ///
    /// # Errors
    /// The first that does not hold.
    pub fn validate(&self) -> Result<(), SettingsError> {
        self.jwt.validate()?;
        for rule in &self.certificates {
            let kind = rule.subject.split_once(':').filter(|(_, name)| !name.is_empty()).map(|(kind, _)| kind);
            if !matches!(kind, Some("cn" | "dns" | "uri")) {
                let remedy = "begin subject with cn:, dns: or uri:, and a name behind it";
                return Err(SettingsError::new("certificates", format!("{:?}", rule.subject), remedy));
            }
            check_tenant("certificates", &rule.tenant)?;
        }
        for user in &self.zenoh_users {
            if user.user.is_empty() || user.user.contains(':') {
                let remedy = "name the user as the file of users does, without a colon";
                return Err(SettingsError::new("zenoh_users", format!("{:?}", user.user), remedy));
            }
            check_tenant("zenoh_users", &user.tenant)?;
        }
        if self.zenoh_users_file.is_empty() != self.zenoh_users.is_empty() {
            let (field, value) =
                if self.zenoh_users.is_empty() { ("zenoh_users", "[]") } else { ("zenoh_users_file", "\"\"") };
            return Err(SettingsError::new(field, value, "set zenoh_users_file and zenoh_users together, or neither"));
        }
        let nobody = self.keys_file.is_empty()
            && self.jwt.issuer.is_empty()
            && self.certificates.is_empty()
            && self.zenoh_users.is_empty();
        if self.mode == AuthMode::Required && nobody {
            let remedy = "but nothing tells who anybody is: set keys_file (`percept keys create` makes one), jwt.issuer, \
                          certificates or zenoh_users";
            return Err(SettingsError::new("mode", "\"required\"", remedy));
        }
        Ok(())
    }
}

fn check_tenant(field: &str, tenant: &str) -> Result<(), SettingsError> {
    if is_name(tenant) {
        return Ok(());
    }
    let remedy = "name a tenant by 1 to 64 characters of a-z A-Z 0-9 _ - . @ : /";
    Err(SettingsError::new(field, format!("of the tenant {tenant:?}"), remedy))
}

impl JwtSettings {
    fn validate(&self) -> Result<(), SettingsError> {
        if self.issuer.is_empty() {
            return Ok(());
        }
        let named = [
            ("jwt.audience", &self.audience, "say how tokens name this service"),
            ("jwt.access_claim", &self.access_claim, "name the claim with the access"),
        ];
        for (field, value, remedy) in named {
            if value.is_empty() {
                return Err(SettingsError::new(field, "\"\"", remedy));
            }
        }
        if self.tenant_claim.is_empty() && self.default_tenant.is_empty() {
            return Err(SettingsError::new("jwt.tenant_claim", "\"\"", "name the claim, or set jwt.default_tenant"));
        }
        if !self.default_tenant.is_empty() {
            check_tenant("jwt.default_tenant", &self.default_tenant)?;
        }
        if self.leeway_s > 300 {
            return Err(SettingsError::new("jwt.leeway_s", self.leeway_s.to_string(), "set it between 0 and 300"));
        }
        if self.algorithms.is_empty() {
            return Err(SettingsError::new("jwt.algorithms", "[]", "name at least one, such as \"RS256\""));
        }
        if let Some(unknown) = self.algorithms.iter().find(|a| crate::jwt::Algorithm::named(a).is_none()) {
            let remedy = "take of RS256, RS384, RS512, PS256, PS384, PS512, ES256, ES384 and EdDSA: a shared secret \
                          (HS256) would let whoever checks tokens make them, and none is no signature";
            return Err(SettingsError::new("jwt.algorithms", format!("{unknown:?}"), remedy));
        }
        if self.jwks_file.is_empty() {
            let (field, url) =
                if self.jwks_url.is_empty() { ("jwt.issuer", &self.issuer) } else { ("jwt.jwks_url", &self.jwks_url) };
            // Keys that came unprotected could be anybody's; on this machine nobody stands between.
            let near = ["http://127.0.0.1", "http://localhost", "http://[::1]"];
            let at = |prefix: &str| url.strip_prefix(prefix).is_some_and(|rest| rest.starts_with([':', '/']));
            if !url.starts_with("https://") && !near.into_iter().any(at) {
                let remedy = "begin it with https://, or give the keys by jwt.jwks_file";
                return Err(SettingsError::new(field, format!("{url:?}"), remedy));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut AuthSettings)) -> String {
        let mut settings = AuthSettings::default();
        change(&mut settings);
        settings.validate().unwrap_err().to_string()
    }

    #[test]
    fn required_without_any_way_to_be_known_is_refused() {
        assert!(refused(|s| s.mode = AuthMode::Required).contains("percept keys create"));
        let keys = AuthSettings { mode: AuthMode::Required, keys_file: "k".to_owned(), ..AuthSettings::default() };
        assert_eq!(keys.validate(), Ok(()));
    }

    #[test]
    fn secrets_shared_and_signatures_absent_are_no_algorithms() {
        for bad in ["HS256", "none", "None", "rs256", ""] {
            let said = refused(|s| {
                s.jwt.issuer = "https://id.example".to_owned();
                s.jwt.algorithms = vec![bad.to_owned()];
            });
            assert!(said.starts_with("auth.jwt.algorithms is"), "{said}");
        }
    }

    #[test]
    fn keys_are_fetched_protected_or_from_this_machine() {
        for (url, fine) in [
            ("https://id.example", true),
            ("http://127.0.0.1:9000/realm", true),
            ("http://id.example", false),
            ("http://127.0.0.1.evil.example", false),
            ("ftp://x", false),
        ] {
            let mut settings = AuthSettings::default();
            settings.jwt.issuer = url.to_owned();
            assert_eq!(settings.validate().is_ok(), fine, "{url}");
        }
    }
}

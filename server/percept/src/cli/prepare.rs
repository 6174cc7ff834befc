//! What has to hold before a server listens, beyond what single settings say: the files that they name are there and can be
//! used, and the doors can be what the settings want. `serve` and `config --check` ask the same.

use super::Failure;
use crate::config::Config;
use crate::doors::listener::tls::Tls;
use crate::doors::zenoh;
use percept_identity::Authenticator;
use std::sync::Arc;

/// What was read.
pub(super) struct Prepared {
    /// None: the doors speak without encryption.
    pub(super) tls: Option<Arc<Tls>>,
    pub(super) authenticator: Arc<Authenticator>,
}

/// Reads certificates, keys and rules.
///
/// # Errors
/// Field, value and remedy of the first thing that does not hold.
pub(super) fn prepare(config: &Config) -> Result<Prepared, Failure> {
    crate::storage::location(&config.storage)?;
    let tls = config.tls.is_on().then(|| Tls::open(&config.tls)).transpose()?;
    let authenticator = Authenticator::open(&config.auth, crate::provider::keys(&config.auth.jwt))?;
    zenoh::check(&config.auth, &config.listen.zenoh, &config.tls)?;
    Ok(Prepared { tls, authenticator: Arc::new(authenticator) })
}

//! What has to hold before a server listens, beyond what single settings say: the files that they name are there and can be
//! used, and the doors can be what the settings want. `serve` and `config --check` ask the same.

use super::Failure;
use crate::config::{Config, is_loopback};
use crate::doors::listener::tls::Tls;
use crate::doors::zenoh;
use percept_identity::{AuthMode, Authenticator};
use std::sync::Arc;

/// What was read.
pub(super) struct Prepared {
    /// None: the doors speak without encryption.
    pub(super) tls: Option<Arc<Tls>>,
    pub(super) authenticator: Arc<Authenticator>,
}

/// Reads certificates, keys and rules; warns of what may be meant otherwise.
///
/// # Errors
/// Field, value and remedy of the first thing that does not hold.
pub(super) fn prepare(config: &Config) -> Result<Prepared, Failure> {
    crate::storage::location(&config.storage)?;
    let tls = config.tls.is_on().then(|| Tls::open(&config.tls)).transpose()?;
    let authenticator = Authenticator::open(&config.auth, crate::provider::keys(&config.auth.jwt))?;
    zenoh::check(&config.auth, &config.listen.zenoh, &config.tls)?;
    warn_of_open_keys(config);
    Ok(Prepared { tls, authenticator: Arc::new(authenticator) })
}

/// Whoever listens on the wire then has them.
fn warn_of_open_keys(config: &Config) {
    if config.auth.mode == AuthMode::None || config.tls.is_on() {
        return;
    }
    for (field, address) in [("listen.grpc", &config.listen.grpc), ("listen.rest", &config.listen.rest)] {
        if !address.is_empty() && !is_loopback(address) {
            tracing::warn!(
                field,
                address,
                "keys and tokens travel readably to this door: set tls.cert_file and tls.key_file, or listen on 127.0.0.1 \
                 behind a proxy that encrypts"
            );
        }
    }
}

//! From the configuration to the data: a directory, or a bucket that several servers share.

use crate::config::{Config, Storage};
use percept_store::{CacheConfig, Location, RootConfig, S3Options, StoreError};
use std::net::SocketAddr;

/// How the server opens its data; `grpc` is where it listens, if it does.
///
/// # Errors
/// [`StoreError::InvalidLocation`].
pub(crate) fn root_config(config: &Config, grpc: Option<SocketAddr>) -> Result<RootConfig, StoreError> {
    let storage = &config.storage;
    let mut root = RootConfig::at(location(storage)?);
    root.shared |= storage.shared;
    root.address = match storage.advertise.as_str() {
        "" => grpc.map(|at| at.to_string()).unwrap_or_default(),
        given => given.to_owned(),
    };
    if root.shared && storage.advertise.is_empty() && grpc.is_none_or(|at| at.ip().is_unspecified()) {
        tracing::warn!(address = root.address, "other servers send nobody here: set storage.advertise");
    }
    let is_cached = !storage.cache_dir.as_os_str().is_empty();
    root.cache = is_cached.then(|| CacheConfig {
        directory: storage.cache_dir.clone(),
        max_bytes: storage.cache_mb.saturating_mul(1 << 20),
    });
    Ok(root)
}

/// Where the configuration says that the data are.
///
/// # Errors
/// [`StoreError::InvalidLocation`].
pub(crate) fn location(storage: &Storage) -> Result<Location, StoreError> {
    if storage.url.is_empty() {
        return Ok(Location::Directory(storage.data_dir.clone()));
    }
    parse(&storage.url, storage)
}

/// A place written as a path or a URL; a bucket is reached as the configuration says.
///
/// # Errors
/// [`StoreError::InvalidLocation`].
pub(crate) fn parse(text: &str, storage: &Storage) -> Result<Location, StoreError> {
    let given = |text: &String| (!text.is_empty()).then(|| text.clone());
    let s3 = S3Options {
        endpoint: given(&storage.s3_endpoint),
        region: given(&storage.s3_region),
        allow_http: storage.s3_allow_http,
    };
    Location::parse(text, &s3)
}

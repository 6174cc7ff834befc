//! From the configuration to the data: a directory, or a bucket that several servers share.

use crate::config::{Config, Storage};
use percept_store::{CacheConfig, Location, RootConfig, S3Options, StoreError};
use std::net::SocketAddr;
use tokio::runtime::{Builder, Handle, Runtime};

/// The threads that write and keep data in order.
///
/// All sessions of a fleet fill their tables, and clear their logs away, in the same second: on the doors' threads questions
/// waited for that, up to 150 ms.
pub(crate) struct StorageThreads(Option<Runtime>);

impl StorageThreads {
    /// Two of them, as much behind the doors as the threads for frames.
    ///
    /// # Errors
    /// The system gives no threads.
    pub(crate) fn start(nice: i32, most_file_threads: usize) -> std::io::Result<Self> {
        let mut builder = Builder::new_multi_thread();
        builder.worker_threads(2).max_blocking_threads(most_file_threads).thread_name("storage").enable_all();
        // On Linux the priority is the thread's own; where it cannot be lowered, nothing is lost.
        builder.on_thread_start(move || {
            // Not `nice`, which adds: a thread begins where the one stands that starts it.
            let _ = rustix::process::setpriority_process(None, nice);
        });
        Ok(Self(Some(builder.build()?)))
    }

    /// By which a store is given these threads.
    pub(crate) fn handle(&self) -> Option<Handle> {
        self.0.as_ref().map(|runtime| runtime.handle().clone())
    }
}

impl Drop for StorageThreads {
    fn drop(&mut self) {
        // Stores are closed before; what a second signal left is not waited for.
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

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

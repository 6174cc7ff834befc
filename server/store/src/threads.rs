//! Work that the async threads hand on.

use std::sync::Arc;

use crate::error::StoreError;

/// Runs work that would hold up the async threads.
pub(crate) async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| StoreError::Io { operation: "run a blocking task", source: Arc::new(error) })
}

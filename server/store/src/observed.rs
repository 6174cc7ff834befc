//! An object store that remembers how the last write failed.
//!
//! SlateDB retries failed uploads for ever and says nothing meanwhile, which suits a full disk that gets
//! freed again; but a caller waiting for durability wants to hear `Full` now. This wrapper lets the
//! committer know without giving up the retrying.

use std::ops::Range;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, RenameOptions, Result,
};
use tokio::sync::watch;

use crate::error::StoreError;

/// The newest failure of a write, and how many there were.
#[derive(Debug, Clone, Default)]
pub(crate) struct Failures {
    /// How many so far.
    pub(crate) count: u64,
    /// The newest.
    pub(crate) last: Option<StoreError>,
}

/// Forwards everything; reports failed writes to the watch.
#[derive(Debug)]
pub(crate) struct ObservedStore {
    inner: Arc<dyn ObjectStore>,
    failures: watch::Sender<Failures>,
}

impl ObservedStore {
    /// Wraps a store; the receiver sees the failures of its writes.
    pub(crate) fn new(inner: Arc<dyn ObjectStore>) -> (Self, watch::Receiver<Failures>) {
        let (failures, watched) = watch::channel(Failures::default());
        (Self { inner, failures }, watched)
    }

    fn observe<T>(&self, result: Result<T>) -> Result<T> {
        if let Err(error) = &result
            && is_failure(error)
        {
            let text = std::io::Error::other(format!("{error}"));
            let last = if crate::error::is_full(error) {
                StoreError::Full
            } else {
                StoreError::Io { operation: "write to the object store", source: Arc::new(text) }
            };
            self.failures.send_modify(|failures| {
                failures.count += 1;
                failures.last = Some(last);
            });
        }
        result
    }
}

/// Whether a write's error is a failure rather than an answer (`AlreadyExists` is how fencing works).
fn is_failure(error: &Error) -> bool {
    !matches!(
        error,
        Error::AlreadyExists { .. }
            | Error::Precondition { .. }
            | Error::NotModified { .. }
            | Error::NotFound { .. }
            | Error::NotImplemented { .. }
            | Error::NotSupported { .. }
    )
}

impl std::fmt::Display for ObservedStore {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.inner.fmt(formatter)
    }
}

#[async_trait]
impl ObjectStore for ObservedStore {
    async fn put_opts(&self, location: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        self.observe(self.inner.put_opts(location, payload, options).await)
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.observe(self.inner.put_multipart_opts(location, options).await)
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.inner.get_opts(location, options).await
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        self.inner.get_ranges(location, ranges).await
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.inner.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    fn list_with_offset(&self, prefix: Option<&Path>, offset: &Path) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list_with_offset(prefix, offset)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.observe(self.inner.copy_opts(from, to, options).await)
    }

    async fn rename_opts(&self, from: &Path, to: &Path, options: RenameOptions) -> Result<()> {
        self.observe(self.inner.rename_opts(from, to, options).await)
    }
}

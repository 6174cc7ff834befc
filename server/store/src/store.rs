//! The trait that the rest of the program keeps its state behind.

use std::collections::HashSet;
use std::fmt;
use std::time::Duration;

use bytes::Bytes;
use futures::TryStreamExt;
use futures::future::BoxFuture;
use futures::stream::BoxStream;

use crate::blob_id::BlobId;
use crate::blobs::{GarbageReport, Mark};
use crate::error::StoreError;
use crate::keys::{Key, Prefix};

/// A record: its key and its bytes.
pub type Record = (Key, Bytes);

/// Ordered records and immutable blobs that survive what happens to the process and the machine.
///
/// **Reads see only what is durable**, so nothing that a reader acted on can vanish in a crash. Every
/// write that returned `Ok` is seen by every read that starts later. A future that is dropped before it
/// returns leaves its write undecided.
///
/// A writer that lost its data to another one may serve stale reads for about a second, until it notices;
/// it can never confirm a write. Whoever must not act on a stale read calls [`Store::confirm_ownership`]
/// after reading.
pub trait Store: Send + Sync + fmt::Debug {
    /// Writes records and deletes others in one step: all or nothing, durable when it returns. Deletes
    /// come first; of several values for a key, the last stands. Concurrent callers share one flush. An
    /// empty batch still waits for all that was queued before it.
    ///
    /// # Errors
    /// [`StoreError::RecordTooLarge`], [`StoreError::BatchTooLarge`] (nothing written);
    /// [`StoreError::Fenced`], [`StoreError::Full`], [`StoreError::Stalled`], [`StoreError::Io`],
    /// [`StoreError::Closed`] (not acknowledged).
    fn put_batch(&self, puts: Vec<Record>, deletes: Vec<Key>) -> BoxFuture<'_, Result<(), StoreError>>;

    /// Writes one record; see [`Store::put_batch`].
    ///
    /// # Errors
    /// As [`Store::put_batch`].
    fn put(&self, key: Key, value: Bytes) -> BoxFuture<'_, Result<(), StoreError>> {
        self.put_batch(vec![(key, value)], Vec::new())
    }

    /// Deletes one record, durably; one that is not there is no error.
    ///
    /// # Errors
    /// As [`Store::put_batch`].
    fn delete(&self, key: Key) -> BoxFuture<'_, Result<(), StoreError>> {
        self.put_batch(Vec::new(), vec![key])
    }

    /// The value of a record, `None` if it is not there.
    ///
    /// # Errors
    /// [`StoreError::Fenced`], [`StoreError::Corrupt`], [`StoreError::Io`], [`StoreError::Closed`].
    fn get(&self, key: &Key) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>>;

    /// All records below `prefix` in the order of their keys, as they were when the stream was first
    /// polled; only those after `after` if it is given (to page on). To be read within a few minutes.
    ///
    /// # Errors
    /// As [`Store::get`], as an item; the stream ends there.
    fn scan(&self, prefix: &Prefix, after: Option<&Key>) -> BoxStream<'_, Result<Record, StoreError>>;

    /// [`Store::scan`] into a vector, for prefixes known to be small.
    ///
    /// # Errors
    /// As [`Store::get`].
    fn scan_all(&self, prefix: &Prefix) -> BoxFuture<'_, Result<Vec<Record>, StoreError>> {
        Box::pin(self.scan(prefix, None).try_collect())
    }

    /// The last record below `prefix`, e.g. the newest entry of a log.
    ///
    /// # Errors
    /// As [`Store::get`].
    fn last(&self, prefix: &Prefix) -> BoxFuture<'_, Result<Option<Record>, StoreError>>;

    /// Stores bytes under their SHA-256; durable when it returns. Storing the same bytes again is no
    /// error and costs little; it also keeps the blob from [`Store::collect_garbage`].
    ///
    /// # Errors
    /// [`StoreError::BlobTooLarge`], [`StoreError::Full`], [`StoreError::Io`].
    fn put_blob(&self, bytes: Bytes) -> BoxFuture<'_, Result<BlobId, StoreError>>;

    /// A blob's bytes, their hash checked.
    ///
    /// # Errors
    /// [`StoreError::BlobMissing`], [`StoreError::BlobCorrupt`], [`StoreError::Io`].
    fn get_blob(&self, id: BlobId) -> BoxFuture<'_, Result<Bytes, StoreError>>;

    /// Whether a blob is there; its content is not looked at.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    fn blob_exists(&self, id: BlobId) -> BoxFuture<'_, Result<bool, StoreError>>;

    /// All blobs, in no order: identity and size in bytes.
    fn blobs(&self) -> BoxStream<'_, Result<(BlobId, u64), StoreError>>;

    /// Now, in the order of this opening's `put_blob`s; for [`Store::collect_garbage`].
    fn mark(&self) -> Mark;

    /// Deletes blobs that are not in `live`, were not stored by this opening after `mark`, and are not younger than
    /// `grace`.
    ///
    /// The caller takes the mark first, at a time when every blob that it has stored is named by a record or never will
    /// be, and collects `live` from its records then. Whatever it stores meanwhile stays, whatever clocks say; `grace` is
    /// for writers of before.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] before anything is deleted if this writer lost the data;
    /// [`StoreError::Io`] part-way.
    fn collect_garbage<'a>(
        &'a self,
        live: &'a HashSet<BlobId>,
        mark: Mark,
        grace: Duration,
    ) -> BoxFuture<'a, Result<GarbageReport, StoreError>>;

    /// Asks the storage itself, by a durable write, whether this writer still owns the data.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] if not; otherwise as [`Store::put_batch`].
    fn confirm_ownership(&self) -> BoxFuture<'_, Result<(), StoreError>>;

    /// The number of this opening: one more than that of the writer before it.
    fn epoch(&self) -> u64;

    /// Flushes, stops and lets go of the directory. Later calls get [`StoreError::Closed`]; closing twice
    /// is no error. A store that is dropped instead loses nothing that it acknowledged.
    ///
    /// # Errors
    /// [`StoreError::Fenced`], [`StoreError::Stalled`], [`StoreError::Io`]; the store is closed all the same.
    fn close(&self) -> BoxFuture<'_, Result<(), StoreError>>;
}

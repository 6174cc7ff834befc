//! A session read without taking it from its writer, whoever that is.

use std::sync::Arc;

use futures::TryStreamExt;
use object_store::ObjectStore;
use object_store::path::Path;
use slatedb::config::{DbReaderOptions, ScanOptions};
use slatedb::{DbReader, DbReaderMode};

use crate::blob_id::BlobId;
use crate::blobs::Blobs;
use crate::error::StoreError;
use crate::keys::{Key, RESERVED};
use crate::slate::RECORDS;
use crate::store::Record;

/// Objects are asked for so often before reading fails.
const RETRIES: u32 = 3;
/// All records are read so often before they are called damaged.
const SCANS: usize = 4;

/// A session's records and blobs as they are; see [`crate::DataRoot::read_session`].
pub struct SessionReader {
    objects: Arc<dyn ObjectStore>,
    blobs: Blobs,
}

impl std::fmt::Debug for SessionReader {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("SessionReader").finish_non_exhaustive()
    }
}

impl SessionReader {
    pub(crate) fn new(objects: Arc<dyn ObjectStore>) -> Self {
        let blobs = Blobs::new(objects.clone(), None, usize::MAX, None);
        Self { objects, blobs }
    }

    /// All records of one moment, in the order of their keys; none if the session was never opened.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Io`].
    pub async fn records(&self) -> Result<Vec<Record>, StoreError> {
        let listed = self.objects.list(Some(&Path::from(RECORDS))).try_next().await;
        if listed.map_err(|error| StoreError::from_object("list the records", error))?.is_none() {
            return Ok(Vec::new());
        }
        let mut outcome = self.scan().await;
        for _ in 1..SCANS {
            // The writer may have tidied up meanwhile: a file that is gone looks like damage.
            if !matches!(outcome, Err(StoreError::Io { .. } | StoreError::Corrupt { .. })) {
                break;
            }
            outcome = self.scan().await;
        }
        outcome
    }

    async fn scan(&self) -> Result<Vec<Record>, StoreError> {
        let failed = |error| StoreError::from_slate("read the records", 0, error);
        let options = DbReaderOptions { object_store_max_retries: Some(RETRIES), ..DbReaderOptions::default() };
        let reader = DbReader::builder(RECORDS, self.objects.clone())
            .with_options(options)
            .with_reader_mode(DbReaderMode::FollowLatest)
            .with_db_cache_disabled()
            .build()
            .await
            .map_err(failed)?;
        let mut records = Vec::new();
        let mut scanned = reader.scan_with_options(.., &ScanOptions::default()).await.map_err(failed)?;
        while let Some(record) = scanned.next().await.map_err(failed)? {
            let key = std::str::from_utf8(&record.key)
                .map_err(|error| StoreError::Corrupt { operation: "read a key", source: Arc::new(error) })?;
            if key.split('/').next() != Some(RESERVED) {
                records.push((Key::trusted(key), record.value));
            }
        }
        drop(scanned);
        reader.close().await.map_err(failed)?;
        Ok(records)
    }

    /// All blobs, in no order: identity and size in bytes.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn blobs(&self) -> Result<Vec<(BlobId, u64)>, StoreError> {
        self.blobs.list().map_ok(|(id, meta)| (id, meta.size)).try_collect().await
    }

    /// A blob's bytes, their hash checked.
    ///
    /// # Errors
    /// [`StoreError::BlobMissing`], [`StoreError::BlobCorrupt`], [`StoreError::Io`].
    pub async fn get_blob(&self, id: BlobId) -> Result<bytes::Bytes, StoreError> {
        self.blobs.get(id).await
    }
}

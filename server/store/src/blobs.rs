//! Large immutable bytes, named by their SHA-256, as objects of their own.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::stream::{BoxStream, StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{Error, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};
use tokio::sync::RwLock;

use crate::blob_id::BlobId;
use crate::cache::CachedBlobs;
use crate::directory;
use crate::error::StoreError;
use crate::threads::blocking;

/// A blob stored again is made young again if it is older than this.
const REFRESH_AGE: Duration = Duration::from_secs(60);

/// Bytes from which hashing leaves the async threads alone (about 0.1 ms of work).
const HASH_INLINE_BYTES: usize = 128 << 10;

/// Folder of the blobs.
pub(crate) const FOLDER: &str = "blobs";

fn path(id: BlobId) -> Path {
    Path::from(format!("{FOLDER}/{id}"))
}

/// What a collection of garbage did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GarbageReport {
    /// Blobs that were looked at.
    pub num_seen: u64,
    /// Blobs that are named by a record.
    pub num_live: u64,
    /// Blobs that nobody names but that are too young to go.
    pub num_young: u64,
    /// Blobs that were deleted.
    pub num_deleted: u64,
    /// Their bytes.
    pub deleted_bytes: u64,
}

/// The blobs of one store.
#[derive(Debug)]
pub(crate) struct Blobs {
    objects: Arc<dyn ObjectStore>,
    /// The directory, where entries found existing have to be synced by us.
    synced_root: Option<PathBuf>,
    max_bytes: usize,
    cache: Option<CachedBlobs>,
    /// Storing reads, deleting writes: a blob is not deleted while it is stored again.
    gate: RwLock<()>,
    stored: Mutex<Stored>,
}

/// What this opening has stored, in order.
#[derive(Debug, Default)]
struct Stored {
    count: u64,
    last: HashMap<BlobId, u64>,
}

/// A point in the order in which an opening stores its blobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Mark(u64);

impl Blobs {
    pub(crate) fn new(
        objects: Arc<dyn ObjectStore>,
        synced_root: Option<PathBuf>,
        max_bytes: usize,
        cache: Option<CachedBlobs>,
    ) -> Self {
        Self { objects, synced_root, max_bytes, cache, gate: RwLock::new(()), stored: Mutex::default() }
    }

    fn stored(&self) -> MutexGuard<'_, Stored> {
        self.stored.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn mark(&self) -> Mark {
        Mark(self.stored().count)
    }

    fn was_stored_after(&self, mark: Mark, id: BlobId) -> bool {
        self.stored().last.get(&id).is_some_and(|number| *number > mark.0)
    }

    pub(crate) async fn put(&self, bytes: Bytes) -> Result<BlobId, StoreError> {
        if bytes.len() > self.max_bytes {
            return Err(StoreError::BlobTooLarge { num_bytes: bytes.len(), limit: self.max_bytes });
        }
        let id = hash(&bytes).await?;
        let _not_deleting = self.gate.read().await;
        {
            let mut stored = self.stored();
            stored.count += 1;
            let number = stored.count;
            stored.last.insert(id, number);
        }
        match self.write(id, bytes.clone(), PutMode::Create).await {
            Ok(()) => {}
            Err(Error::AlreadyExists { .. }) => self.put_again(id, bytes.clone()).await?,
            Err(error) => return Err(StoreError::from_object("write a blob", error)),
        }
        if let Some(cache) = &self.cache {
            cache.put(id, bytes).await;
        }
        Ok(id)
    }

    /// The blob was there. A fresh one of the right size only has to be made durable; an older one is
    /// replaced by the same bytes, which makes it young and mends it if it was damaged.
    async fn put_again(&self, id: BlobId, bytes: Bytes) -> Result<(), StoreError> {
        let io = |error| StoreError::from_object("write a blob", error);
        let is_fresh = match self.objects.head(&path(id)).await {
            Ok(meta) => meta.size == bytes.len() as u64 && age(&meta) < REFRESH_AGE,
            Err(Error::NotFound { .. }) => false,
            Err(error) => return Err(io(error)),
        };
        if !is_fresh {
            return self.write(id, bytes, PutMode::Overwrite).await.map_err(io);
        }
        // Whoever created it synced its bytes before linking it, but perhaps not yet the link.
        let Some(root) = &self.synced_root else { return Ok(()) };
        let folder = root.join(FOLDER);
        blocking(move || directory::sync(&folder))
            .await?
            .map_err(|error| StoreError::from_io("sync a blob's directory", error))
    }

    async fn write(&self, id: BlobId, bytes: Bytes, mode: PutMode) -> Result<(), Error> {
        self.objects.put_opts(&path(id), PutPayload::from(bytes), PutOptions::from(mode)).await.map(|_| ())
    }

    pub(crate) async fn get(&self, id: BlobId) -> Result<Bytes, StoreError> {
        let Some(cache) = &self.cache else { return self.fetch(id).await };
        if let Some(bytes) = cache.get(id).await {
            return Ok(bytes);
        }
        let bytes = self.fetch(id).await?;
        cache.put(id, bytes.clone()).await;
        Ok(bytes)
    }

    async fn fetch(&self, id: BlobId) -> Result<Bytes, StoreError> {
        let explain = |error| match error {
            Error::NotFound { .. } => StoreError::BlobMissing { id },
            error => StoreError::from_object("read a blob", error),
        };
        let bytes = self.objects.get(&path(id)).await.map_err(explain)?.bytes().await.map_err(explain)?;
        if hash(&bytes).await? == id { Ok(bytes) } else { Err(StoreError::BlobCorrupt { id }) }
    }

    pub(crate) async fn exists(&self, id: BlobId) -> Result<bool, StoreError> {
        match self.objects.head(&path(id)).await {
            Ok(_) => Ok(true),
            Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(StoreError::from_object("look for a blob", error)),
        }
    }

    /// All blobs with what the object store knows of them; foreign names are passed over.
    pub(crate) fn list(&self) -> BoxStream<'static, Result<(BlobId, ObjectMeta), StoreError>> {
        self.objects
            .list(Some(&Path::from(FOLDER)))
            .map_err(|error| StoreError::from_object("list blobs", error))
            .try_filter_map(|meta| async move {
                let id = meta.location.filename().and_then(|name| name.parse::<BlobId>().ok());
                Ok(id.map(|id| (id, meta)))
            })
            .boxed()
    }

    /// Blobs that may be garbage, with their sizes, and the others counted.
    pub(crate) async fn candidates(
        &self,
        live: &HashSet<BlobId>,
        mark: Mark,
        grace: Duration,
    ) -> Result<(GarbageReport, Vec<(BlobId, u64)>), StoreError> {
        let (mut report, mut candidates) = (GarbageReport::default(), Vec::new());
        let mut blobs = self.list();
        while let Some((id, meta)) = blobs.try_next().await? {
            report.num_seen += 1;
            if live.contains(&id) {
                report.num_live += 1;
            } else if self.was_stored_after(mark, id) || age(&meta) < grace {
                report.num_young += 1;
            } else {
                candidates.push((id, meta.size));
            }
        }
        Ok((report, candidates))
    }

    /// Looks again once nobody is storing: the listing may be old.
    pub(crate) async fn delete_garbage(&self, id: BlobId, mark: Mark, grace: Duration) -> Result<bool, StoreError> {
        let io = |error| StoreError::from_object("delete a blob", error);
        let _nobody_storing = self.gate.write().await;
        if self.was_stored_after(mark, id) {
            return Ok(false);
        }
        match self.objects.head(&path(id)).await {
            Ok(meta) if age(&meta) < grace => return Ok(false),
            Ok(_) => {}
            Err(Error::NotFound { .. }) => return Ok(true),
            Err(error) => return Err(io(error)),
        }
        if let Some(cache) = &self.cache {
            cache.delete(id).await;
        }
        match self.objects.delete(&path(id)).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(true),
            Err(error) => Err(io(error)),
        }
    }
}

/// Time since the object was written; a time in the future counts as now.
pub(crate) fn age(meta: &ObjectMeta) -> Duration {
    SystemTime::now().duration_since(SystemTime::from(meta.last_modified)).unwrap_or_default()
}

async fn hash(bytes: &Bytes) -> Result<BlobId, StoreError> {
    if bytes.len() <= HASH_INLINE_BYTES {
        return Ok(BlobId::of(bytes));
    }
    let bytes = bytes.clone();
    blocking(move || BlobId::of(&bytes)).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_the_sha_256_in_lower_case() {
        // FIPS 180-2, appendix B.1.
        let text = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(BlobId::of(b"abc").to_string(), text);
        assert_eq!(text.parse::<BlobId>().unwrap(), BlobId::of(b"abc"));
        for bad in ["", "ba78", &text.to_uppercase(), &text.replace('b', "g"), &format!("{text}0")] {
            assert!(bad.parse::<BlobId>().is_err(), "{bad}");
        }
    }
}

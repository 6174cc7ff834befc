//! The store over SlateDB and content-addressed objects.

use std::collections::HashSet;
use std::fmt;
use std::ops::Bound;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::future::BoxFuture;
use futures::stream::{BoxStream, StreamExt, TryStreamExt, try_unfold};
use object_store::ObjectStore;
use object_store::memory::InMemory;
use object_store::path::Path;
use slatedb::config::{
    CompactorOptions, DurabilityLevel, GarbageCollectorDirectoryOptions, GarbageCollectorOptions, ReadOptions,
    ScanOptions, Settings,
};
use slatedb::{Db, DbIterator, IterationOrder};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;

use crate::blob_id::BlobId;
use crate::blobs::{Blobs, GarbageReport, Mark};
use crate::cache::CachedBlobs;
use crate::committer::{Committer, Request, full};
use crate::config::StoreConfig;
use crate::error::StoreError;
use crate::keys::{Key, Prefix, RESERVED};
use crate::node::Life;
use crate::observed::ObservedStore;
use crate::room::check_room;
use crate::store::{Record, Store};
use crate::ticks::Ticks;

/// Folder of SlateDB's own objects.
pub(crate) const RECORDS: &str = "records";

/// Tables that may lie unmerged: small ones, which are read quickly all the same.
const MAX_TABLES: usize = 64;

/// Bytes that a scan asks for at once.
const SCAN_READ_AHEAD_BYTES: usize = 256 << 10;

/// Age from which on the marks of earlier openings are removed, seconds: two days.
const FENCES_STAY_S: u64 = 2 * 86_400;

/// Memory for records on their way to the disk; beyond it writers wait.
const MAX_UNFLUSHED_BYTES: usize = 32 << 20;

/// Records in SlateDB, blobs as objects beside it; see [`Store`].
///
/// Needs a tokio runtime. Dropping it without [`Store::close`] closes it in the background.
pub struct SlateStore {
    db: Db,
    queue: mpsc::Sender<Request>,
    blobs: Blobs,
    life: Option<Arc<Life>>,
    disk: Option<PathBuf>,
    epoch: u64,
    max_record_bytes: usize,
    max_batch_bytes: usize,
}

impl fmt::Debug for SlateStore {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("SlateStore").field("epoch", &self.epoch).finish_non_exhaustive()
    }
}

impl SlateStore {
    /// Opens the records and blobs below the root of `objects`, made new if there are none, and takes the next
    /// epoch: a writer that had them open gets [`StoreError::Fenced`] from its next durable write.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Full`], [`StoreError::Io`]; [`StoreError::Fenced`] if
    /// `expected_epoch` is not the newest any more.
    pub async fn open(objects: Arc<dyn ObjectStore>, config: StoreConfig) -> Result<Self, StoreError> {
        Self::open_at(Place { objects, directory: None, disk: None, life: None, cache: None }, config).await
    }

    /// A new store in memory, for tests.
    ///
    /// # Errors
    /// None that are expected.
    pub async fn in_memory() -> Result<Self, StoreError> {
        Self::open(Arc::new(InMemory::new()), StoreConfig::default()).await
    }

    pub(crate) async fn open_at(place: Place, config: StoreConfig) -> Result<Self, StoreError> {
        let Place { objects, directory, disk, life, cache } = place;
        let settings = settings(&config, directory.is_some());
        let blobs = Blobs::new(objects.clone(), directory, config.max_blob_bytes, cache);
        let ticks = Arc::new(Ticks::after(objects.as_ref(), &Path::from(RECORDS)).await?);
        let (observed, failures) = ObservedStore::new(objects);
        // Sessions are read once, when they wake: a cache would hold what nobody reads again.
        let mut builder = Db::builder(RECORDS, Arc::new(observed)).with_settings(settings).with_db_cache_disabled();
        builder = builder.with_system_clock(ticks.clone());
        if let Some(expected) = config.expected_epoch {
            builder = builder.with_expected_epoch(expected);
        }
        // SlateDB's tasks stay on the runtime that it is built on.
        let runtime = config.runtime.unwrap_or_else(Handle::current);
        let mut opening = JoinSet::new();
        opening.spawn_on(builder.build(), &runtime);
        // SlateDB tries for ever to write that it is the writer now; whoever waits for it is told why it cannot.
        let db = tokio::select! {
            opened = opening.join_next() => match opened {
                Some(Ok(opened)) => opened.map_err(|error| StoreError::from_slate("open the records", 0, error))?,
                Some(Err(_)) | None => return Err(StoreError::Closed),
            },
            () = full(failures.clone()) => return Err(StoreError::Full),
            () = tokio::time::sleep(config.open_timeout) => {
                let last = failures.borrow().last.clone();
                return Err(last.unwrap_or(StoreError::Stalled { waited: config.open_timeout }));
            }
        };
        ticks.not_before(db.manifest().last_l0_clock_tick());
        let epoch = db.manifest().writer_epoch();
        let (queue, requests) = mpsc::channel(config.queue_length.max(1));
        let timeout = config.commit_timeout;
        let committer = Committer { db: db.clone(), epoch, failures, timeout, life: life.clone(), stalled: None };
        runtime.spawn(committer.run(requests));
        let StoreConfig { max_record_bytes, max_batch_bytes, .. } = config;
        Ok(Self { db, queue, blobs, life, disk, epoch, max_record_bytes, max_batch_bytes })
    }

    fn check_sizes(&self, puts: &[Record], deletes: &[Key]) -> Result<usize, StoreError> {
        let limit = self.max_record_bytes;
        if let Some((key, value)) = puts.iter().find(|(_, value)| value.len() > limit) {
            return Err(StoreError::RecordTooLarge { key: key.to_string(), num_bytes: value.len(), limit });
        }
        let num_put: usize = puts.iter().map(|(key, value)| key.as_str().len() + value.len()).sum();
        let num_bytes = num_put + deletes.iter().map(|key| key.as_str().len()).sum::<usize>();
        let limit = self.max_batch_bytes;
        if num_bytes > limit { Err(StoreError::BatchTooLarge { num_bytes, limit }) } else { Ok(num_bytes) }
    }

    fn check_room(&self) -> Result<(), StoreError> {
        self.disk.as_deref().map_or(Ok(()), check_room)
    }

    async fn commit(&self, puts: Vec<Record>, deletes: Vec<Key>) -> Result<(), StoreError> {
        let num_bytes = self.check_sizes(&puts, &deletes)?;
        if !puts.is_empty() {
            self.check_room()?;
        }
        let (done, outcome) = oneshot::channel();
        let request = Request::Commit { puts, deletes, num_bytes, done };
        self.queue.send(request).await.map_err(|_| StoreError::Closed)?;
        outcome.await.map_err(|_| StoreError::Closed)?
    }

    async fn iterate(
        &self,
        prefix: &Prefix,
        after: Option<&Key>,
        order: IterationOrder,
    ) -> Result<DbIterator, StoreError> {
        let options = ScanOptions {
            durability_filter: DurabilityLevel::Remote,
            read_ahead_bytes: SCAN_READ_AHEAD_BYTES,
            order,
            ..ScanOptions::default()
        };
        self.db
            .scan_with_options(range(prefix, after), &options)
            .await
            .map_err(|error| StoreError::from_slate("scan", self.epoch, error))
    }

    /// The next record that is not the store's own.
    async fn next(&self, records: &mut DbIterator) -> Result<Option<Record>, StoreError> {
        loop {
            let next = records.next().await.map_err(|error| StoreError::from_slate("scan", self.epoch, error))?;
            let Some(record) = next else { return Ok(None) };
            let key = std::str::from_utf8(&record.key)
                .map_err(|error| StoreError::Corrupt { operation: "read a key", source: Arc::new(error) })?;
            if key.split('/').next() != Some(RESERVED) {
                return Ok(Some((Key::trusted(key), record.value)));
            }
        }
    }
}

impl Store for SlateStore {
    fn put_batch(&self, puts: Vec<Record>, deletes: Vec<Key>) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(self.commit(puts, deletes))
    }

    fn get(&self, key: &Key) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>> {
        let key = key.clone();
        Box::pin(async move {
            let options = ReadOptions { durability_filter: DurabilityLevel::Remote, ..ReadOptions::default() };
            let value = self.db.get_with_options(key.as_str(), &options).await;
            value.map_err(|error| StoreError::from_slate("get", self.epoch, error))
        })
    }

    fn scan(&self, prefix: &Prefix, after: Option<&Key>) -> BoxStream<'_, Result<Record, StoreError>> {
        let (prefix, after) = (prefix.clone(), after.cloned());
        try_unfold(None, move |records: Option<DbIterator>| {
            let (prefix, after) = (prefix.clone(), after.clone());
            async move {
                let mut records = match records {
                    Some(records) => records,
                    None => self.iterate(&prefix, after.as_ref(), IterationOrder::Ascending).await?,
                };
                Ok(self.next(&mut records).await?.map(|record| (record, Some(records))))
            }
        })
        .boxed()
    }

    fn last(&self, prefix: &Prefix) -> BoxFuture<'_, Result<Option<Record>, StoreError>> {
        let prefix = prefix.clone();
        Box::pin(async move {
            let mut records = self.iterate(&prefix, None, IterationOrder::Descending).await?;
            self.next(&mut records).await
        })
    }

    fn put_blob(&self, bytes: Bytes) -> BoxFuture<'_, Result<BlobId, StoreError>> {
        Box::pin(async {
            self.check_room()?;
            self.blobs.put(bytes).await
        })
    }

    fn get_blob(&self, id: BlobId) -> BoxFuture<'_, Result<Bytes, StoreError>> {
        Box::pin(self.blobs.get(id))
    }

    fn blob_exists(&self, id: BlobId) -> BoxFuture<'_, Result<bool, StoreError>> {
        Box::pin(self.blobs.exists(id))
    }

    fn blobs(&self) -> BoxStream<'_, Result<(BlobId, u64), StoreError>> {
        self.blobs.list().map_ok(|(id, meta)| (id, meta.size)).boxed()
    }

    fn collect_garbage<'a>(
        &'a self,
        live: &'a HashSet<BlobId>,
        mark: Mark,
        grace: Duration,
    ) -> BoxFuture<'a, Result<GarbageReport, StoreError>> {
        Box::pin(async move {
            let (mut report, candidates) = self.blobs.candidates(live, mark, grace).await?;
            if candidates.is_empty() {
                return Ok(report);
            }
            self.confirm_ownership().await?;
            for (id, size) in candidates {
                // Who was stopped for long between two of them may have lost the data.
                if self.life.as_ref().is_some_and(|life| !life.is_alive()) {
                    return Err(StoreError::Fenced { epoch: self.epoch });
                }
                if self.blobs.delete_garbage(id, mark, grace).await? {
                    report.num_deleted += 1;
                    report.deleted_bytes += size;
                } else {
                    report.num_young += 1;
                }
            }
            Ok(report)
        })
    }

    fn mark(&self) -> Mark {
        self.blobs.mark()
    }

    fn confirm_ownership(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        let owner = Key::trusted(&format!("{RESERVED}/owner"));
        self.put(owner, Bytes::from(self.epoch.to_string()))
    }

    fn epoch(&self) -> u64 {
        self.epoch
    }

    fn close(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move {
            let (done, outcome) = oneshot::channel();
            if self.queue.send(Request::Close { done }).await.is_err() {
                return Ok(());
            }
            // A second `close` in the queue finds its channel dropped: the first one did it.
            outcome.await.unwrap_or(Ok(()))
        })
    }
}

/// Where a store keeps its objects.
pub(crate) struct Place {
    /// Seen from its root.
    pub(crate) objects: Arc<dyn ObjectStore>,
    /// The same as a directory on disk, if it is one and is to be synced.
    pub(crate) directory: Option<PathBuf>,
    /// On whose disk it is, where it is a directory.
    pub(crate) disk: Option<PathBuf>,
    /// Of the node that opens it, where data are shared.
    pub(crate) life: Option<Arc<Life>>,
    /// On this machine.
    pub(crate) cache: Option<CachedBlobs>,
}

fn settings(config: &StoreConfig, is_local: bool) -> Settings {
    let soon = |min_age_s| {
        Some(GarbageCollectorDirectoryOptions {
            interval: Some(Duration::from_secs(60)),
            min_age: Duration::from_secs(min_age_s),
            dry_run: false,
        })
    };
    let garbage = GarbageCollectorOptions {
        // Every commit is a file there: do not let them pile up.
        wal_options: soon(60),
        manifest_options: soon(300),
        compactions_options: soon(300),
        // One stays behind for every opening. Locks and lives keep writers of before away; none of them sleeps for days and
        // then finds its socket, or its lock, as it was.
        wal_fence_options: soon(FENCES_STAY_S),
        // Local directories cannot overwrite conditionally; there the lock keeps stale writers away.
        boundary_files_enabled: !is_local,
        ..GarbageCollectorOptions::default()
    };
    let compactor = CompactorOptions { poll_interval: Duration::from_secs(2), ..CompactorOptions::default() };
    Settings {
        flush_interval: Some(config.flush_interval),
        l0_sst_size_bytes: config.memtable_bytes,
        // Every sleep of a session leaves a table; at the limit writes, and the next sleep, would wait for compaction.
        l0_max_ssts: MAX_TABLES,
        l0_max_ssts_per_key: MAX_TABLES,
        max_unflushed_bytes: MAX_UNFLUSHED_BYTES.max(config.memtable_bytes * 4),
        compactor_options: Some(compactor),
        garbage_collector_options: Some(garbage),
        ..Settings::default()
    }
}

/// Keys below the prefix, after the given one.
fn range(prefix: &Prefix, after: Option<&Key>) -> (Bound<Vec<u8>>, Bound<Vec<u8>>) {
    let text = prefix.as_str();
    let start = match after {
        Some(key) if key.as_str() >= text => Bound::Excluded(key.as_str().as_bytes().to_vec()),
        _ if text.is_empty() => Bound::Unbounded,
        _ => Bound::Included(text.as_bytes().to_vec()),
    };
    // A prefix ends in `/`, and `0` is the byte after it.
    let end = match text.strip_suffix('/') {
        Some(stem) => Bound::Excluded(format!("{stem}0").into_bytes()),
        None => Bound::Unbounded,
    };
    (start, end)
}

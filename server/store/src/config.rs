//! How a store is opened.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use object_store::ObjectStore;
use object_store::memory::InMemory;

/// Where the data live.
#[derive(Debug, Clone)]
pub enum Location {
    /// A local directory; made if it is not there.
    Directory(PathBuf),
    /// Any object store whose create (`PutMode::Create`) is atomic; the fence rests on it.
    Objects(Arc<dyn ObjectStore>),
}

/// How a store is opened.
#[derive(Debug, Clone)]
pub struct StoreConfig {
    /// Where the data live.
    pub location: Location,
    /// Directory only: wait for the disk, not just for the operating system. Default true; without it,
    /// acknowledged data survive `kill -9` but not power loss.
    pub fsync: bool,
    /// Directory only: hold an advisory lock on `LOCK`, so that a second process is told
    /// `DirectoryInUse` instead of silently fencing off the first. Default true. Off for directories on
    /// network file systems that do not lock; the fence alone keeps the data whole then.
    pub lock_directory: bool,
    /// How long opening waits for that lock, for a predecessor on its way out. Default 1 s.
    pub lock_wait: Duration,
    /// Open only if the newest epoch is still this one, and so be number `n + 1`; else `Fenced`.
    /// Default `None`: take whatever comes next.
    pub expected_epoch: Option<u64>,
    /// Upper bound on how long SlateDB leaves a write of its own unflushed; commits flush at once,
    /// whatever it says. Default 100 ms.
    pub flush_interval: Duration,
    /// Records that SlateDB gathers in memory before it writes them as a sorted table; recovery after a
    /// crash reads at most a few times this much. Default 32 MiB.
    pub memtable_bytes: usize,
    /// After this long a commit that is not durable fails as `Stalled`. Default 10 s.
    pub commit_timeout: Duration,
    /// Callers that may wait for the committer before `put_batch` itself waits. Default 1024.
    pub queue_length: usize,
    /// Most bytes of one record's value. Default 4 MiB.
    pub max_record_bytes: usize,
    /// Most bytes of one batch. Default 32 MiB.
    pub max_batch_bytes: usize,
    /// Most bytes of one blob. Default 1 GiB.
    pub max_blob_bytes: usize,
}

impl StoreConfig {
    /// A store in a local directory, fsync and lock on.
    #[must_use]
    pub fn directory(root: impl Into<PathBuf>) -> Self {
        Self::at(Location::Directory(root.into()))
    }

    /// A store over any object store.
    #[must_use]
    pub fn objects(objects: Arc<dyn ObjectStore>) -> Self {
        Self::at(Location::Objects(objects))
    }

    /// A new store in memory, for tests. It lives as long as this configuration or a clone of it: opening
    /// it again finds the data.
    #[must_use]
    pub fn in_memory() -> Self {
        Self::objects(Arc::new(InMemory::new()))
    }

    fn at(location: Location) -> Self {
        Self {
            location,
            fsync: true,
            lock_directory: true,
            lock_wait: Duration::from_secs(1),
            expected_epoch: None,
            flush_interval: Duration::from_millis(100),
            memtable_bytes: 32 << 20,
            commit_timeout: Duration::from_secs(10),
            queue_length: 1024,
            max_record_bytes: 4 << 20,
            max_batch_bytes: 32 << 20,
            max_blob_bytes: 1 << 30,
        }
    }
}

//! How the data are opened.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use object_store::ObjectStore;
use object_store::memory::InMemory;
use tokio::runtime::Handle;

use crate::cache::CacheConfig;
use crate::clock::Clock;
use crate::location::Location;

/// How a [`crate::DataRoot`] is opened.
#[derive(Debug, Clone)]
pub struct RootConfig {
    /// Where the data live.
    pub location: Location,
    /// Directory only: wait for the disk, not just for the operating system. Default true; without it,
    /// acknowledged data survive `kill -9` but not power loss.
    pub fsync: bool,
    /// Directory only: hold an advisory lock on `LOCK`, so that a second process is told `DirectoryInUse`.
    /// Default true. Off for directories on network file systems that do not lock; the fence of each session
    /// alone keeps the data whole then.
    pub lock_directory: bool,
    /// Only to be read, by [`crate::DataRoot::read_session`] and what rests on it, while another process may be writing:
    /// nothing is locked, made, brought to the current format or claimed. Default false.
    pub read_only: bool,
    /// Several processes have these data open at once, each of them some of the sessions; see [`crate::Claim`].
    /// Default false; a bucket is always shared. The directory is not locked then.
    pub shared: bool,
    /// Shared only: where other nodes send those who ask them for a session of this one.
    pub address: String,
    /// Shared only: by what this node knows how long it was silent.
    pub clock: Clock,
    /// How long opening waits for that lock, for a predecessor on its way out. Default 1 s.
    pub lock_wait: Duration,
    /// Where blobs are kept on this machine, too, if the data are far away. Default none.
    pub cache: Option<CacheConfig>,
    /// Of every session's store.
    pub session: StoreConfig,
}

impl RootConfig {
    /// A local directory, fsync and lock on.
    #[must_use]
    pub fn directory(root: impl Into<PathBuf>) -> Self {
        Self::at(Location::Directory(root.into()))
    }

    /// Any object store.
    #[must_use]
    pub fn objects(objects: Arc<dyn ObjectStore>) -> Self {
        Self::at(Location::Objects(objects))
    }

    /// New data in memory, for tests. They live as long as this configuration or a clone of it: opening it
    /// again finds them.
    #[must_use]
    pub fn in_memory() -> Self {
        Self::objects(Arc::new(InMemory::new()))
    }

    /// Any location.
    #[must_use]
    pub fn at(location: Location) -> Self {
        Self {
            shared: matches!(location, Location::Bucket(_)),
            location,
            read_only: false,
            fsync: true,
            lock_directory: true,
            address: String::new(),
            clock: Clock::default(),
            lock_wait: Duration::from_secs(1),
            cache: None,
            session: StoreConfig::default(),
        }
    }
}

/// How the store of one session is opened.
#[derive(Debug, Clone)]
pub struct StoreConfig {
    /// Open only if the newest epoch is still this one, and so be number `n + 1`; else `Fenced`.
    /// Default `None`: take whatever comes next.
    pub expected_epoch: Option<u64>,
    /// Upper bound on how long SlateDB leaves a write of its own unflushed; commits flush at once,
    /// whatever it says. Default 100 ms.
    pub flush_interval: Duration,
    /// Records that SlateDB gathers in memory before it writes them as a sorted table; recovery after a
    /// crash reads at most a few times this much. Default 2 MiB: some two hours of a robot's trajectory, and little
    /// enough that a hundred sessions that are awake fit into memory.
    pub memtable_bytes: usize,
    /// After this long a commit that is not durable fails as `Stalled`. Default 10 s.
    pub commit_timeout: Duration,
    /// After this long a store that cannot be opened, because nothing can be written, fails as `Stalled` or with what was
    /// said last. Default 60 s: a store that answers after half a minute is slow and not broken.
    pub open_timeout: Duration,
    /// Callers that may wait for the committer before `put_batch` itself waits. Default 64.
    pub queue_length: usize,
    /// Most bytes of one record's value. Default 4 MiB.
    pub max_record_bytes: usize,
    /// Most bytes of one batch. Default 32 MiB.
    pub max_batch_bytes: usize,
    /// Most bytes of one blob. Default 1 GiB.
    pub max_blob_bytes: usize,
    /// The runtime, with time and blocking threads, on which records are committed, sorted, merged and cleared away; it has to
    /// outlive the store. Default `None`: the one that opens the store.
    pub runtime: Option<Handle>,
}

impl Default for StoreConfig {
    fn default() -> Self {
        Self {
            expected_epoch: None,
            flush_interval: Duration::from_millis(100),
            memtable_bytes: 2 << 20,
            commit_timeout: Duration::from_secs(10),
            open_timeout: Duration::from_secs(60),
            queue_length: 64,
            max_record_bytes: 4 << 20,
            max_batch_bytes: 32 << 20,
            max_blob_bytes: 1 << 30,
            runtime: None,
        }
    }
}

//! How the data is opened: tried, locked, brought to the current format.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use object_store::ObjectStore;
use object_store::local::LocalFileSystem;
use tokio::sync::Mutex;

use super::{AbortOnDrop, DataRoot, folder_on_disk};
use crate::cache::BlobCache;
use crate::catalogue::CatalogueEntry;
use crate::config::RootConfig;
use crate::directory::{self, DirectoryLock};
use crate::error::StoreError;
use crate::location::Location;
use crate::node::{Node, random_name};
use crate::observed::ObservedStore;
use crate::threads::blocking;
use crate::{format, migrate, trial};

impl DataRoot {
    /// Opens the data, made new if there are none; those of an older format are brought to the current one.
    ///
    /// # Errors
    /// [`StoreError::DirectoryInUse`], [`StoreError::FormatTooNew`], [`StoreError::FormatUnreadable`],
    /// [`StoreError::FormatTooOld`] if it is to be read only, [`StoreError::CreateNotAtomic`],
    /// [`StoreError::CacheUnusable`], [`StoreError::Full`], [`StoreError::Io`].
    pub async fn open(config: RootConfig) -> Result<Self, StoreError> {
        let (objects, directory, lock): (Arc<dyn ObjectStore>, _, _) = match &config.location {
            Location::Objects(objects) | Location::Bucket(objects) => (objects.clone(), None, None),
            Location::Directory(root) => {
                let (files, lock) = open_directory(root.clone(), &config).await?;
                (files, Some(root.clone()), lock)
            }
        };
        let (observed, failures) = ObservedStore::new(objects);
        let shared = config.shared || matches!(config.location, Location::Bucket(_));
        let mut root = Self {
            objects: Arc::new(observed),
            directory,
            fsync: config.fsync,
            session: config.session,
            cache: None,
            failures,
            last_generation: AtomicU64::new(0),
            shared: shared && !config.read_only,
            changing: Mutex::new(()),
            node: None,
            name: random_name(),
            _lock: lock,
        };
        if config.read_only {
            let found = format::read(root.objects.as_ref()).await?;
            let is_current = found == format::CURRENT;
            return if is_current {
                Ok(root)
            } else {
                Err(StoreError::FormatTooOld { found, current: format::CURRENT })
            };
        }
        if let Location::Bucket(_) = &config.location {
            trial::run(root.objects.as_ref(), &root.name).await?;
        }
        if format::read_or_create(root.objects.as_ref()).await? < format::CURRENT {
            migrate::from_1(&root).await?;
        }
        migrate::clear_old(&root).await?;
        if root.shared {
            let node = Node::start(root.objects.clone(), config.address, config.clock).await?;
            let beating = AbortOnDrop(tokio::spawn(node.clone().run()).abort_handle());
            root.node = Some((node, beating));
        }
        if let Some(cache) = config.cache {
            let there = |entry| match entry {
                CatalogueEntry::Created { place, .. } => Some(folder_on_disk(&place)),
                CatalogueEntry::Deleted { .. } | CatalogueEntry::Damaged { .. } => None,
            };
            let places = root.list().await?.into_iter().filter_map(there).collect();
            root.cache = Some(BlobCache::open(cache, places).await?);
        }
        Ok(root)
    }

    /// New data in memory, for tests.
    ///
    /// # Errors
    /// None that are expected.
    pub async fn in_memory() -> Result<Self, StoreError> {
        Self::open(RootConfig::in_memory()).await
    }
}

async fn open_directory(
    root: PathBuf,
    config: &RootConfig,
) -> Result<(Arc<dyn ObjectStore>, Option<DirectoryLock>), StoreError> {
    let fsync = config.fsync;
    if config.read_only {
        if !root.is_dir() {
            return Err(StoreError::NoData);
        }
        let files = LocalFileSystem::new_with_prefix(&root)
            .map_err(|error| StoreError::from_object("open the data directory", error))?;
        return Ok((Arc::new(files), None));
    }
    let prepared = root.clone();
    blocking(move || directory::prepare(&prepared, fsync)).await??;
    let lock = if config.lock_directory && !config.shared {
        Some(directory::lock(&root, config.lock_wait).await?)
    } else {
        None
    };
    if lock.is_some() {
        let swept = root.clone();
        let removed = blocking(move || directory::remove_staged(&swept)).await?;
        let removed = removed.map_err(|error| StoreError::from_io("clear staged files", error))?;
        if removed > 0 {
            tracing::info!(removed, "removed files that a killed writer left half-written");
        }
    }
    let files = LocalFileSystem::new_with_prefix(&root)
        .map_err(|error| StoreError::from_object("open the data directory", error))?
        .with_fsync(fsync);
    Ok((Arc::new(files), lock))
}

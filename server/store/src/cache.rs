//! Blobs of a bucket kept on this machine's disk, so that a session that wakes here again does not fetch them.
//!
//! A copy is a file below the session's own folder, named by the blob. What it holds is believed only if it has the
//! blob's hash, so that the cache may be lost, damaged or shared with another process at any time. When it is full, what
//! was used longest ago goes first.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use bytes::Bytes;

use crate::blob_id::BlobId;
use crate::error::StoreError;
use crate::threads::blocking;

/// Where blobs are kept on this machine's disk, and how many bytes of them.
#[derive(Debug, Clone)]
pub struct CacheConfig {
    /// A directory of its own, made if absent.
    pub directory: PathBuf,
    /// Most bytes in it; a blob of more than a quarter of them is not kept.
    pub max_bytes: u64,
}

/// The directory, and what is in it.
#[derive(Debug)]
pub(crate) struct BlobCache {
    config: CacheConfig,
    known: Mutex<Known>,
    /// Parts of files under way, told apart.
    next_part: AtomicU64,
    has_failed: AtomicBool,
}

/// Files by their use.
#[derive(Debug, Default)]
struct Known {
    bytes: u64,
    next_use: u64,
    files: HashMap<PathBuf, (u64, u64)>,
    by_use: BTreeMap<u64, PathBuf>,
}

impl Known {
    /// Notes that a file of so many bytes is there and was used now.
    fn used(&mut self, file: PathBuf, num_bytes: u64) {
        self.forget(&file);
        let number = self.next_use;
        self.next_use += 1;
        self.bytes += num_bytes;
        self.by_use.insert(number, file.clone());
        self.files.insert(file, (num_bytes, number));
    }

    fn forget(&mut self, file: &Path) -> bool {
        let Some((num_bytes, number)) = self.files.remove(file) else { return false };
        self.by_use.remove(&number);
        self.bytes -= num_bytes;
        true
    }

    /// The files to delete until no more than `max_bytes` are left.
    fn beyond(&mut self, max_bytes: u64) -> Vec<PathBuf> {
        let mut gone = vec![];
        while self.bytes > max_bytes {
            let Some(file) = self.by_use.first_entry().map(|oldest| oldest.get().clone()) else { break };
            self.forget(&file);
            gone.push(file);
        }
        gone
    }
}

impl BlobCache {
    /// Opens the directory. Of what is in it stays only what lies below one of these folders.
    ///
    /// # Errors
    /// [`StoreError::CacheUnusable`].
    pub(crate) async fn open(config: CacheConfig, folders: HashSet<PathBuf>) -> Result<Arc<Self>, StoreError> {
        blocking(move || {
            let directory = config.directory.clone();
            let unusable = |error| StoreError::CacheUnusable { directory, source: Arc::new(error) };
            std::fs::create_dir_all(&config.directory).map_err(unusable.clone())?;
            let known = Known::default();
            let cache = Self {
                config,
                known: Mutex::new(known),
                next_part: AtomicU64::new(0),
                has_failed: AtomicBool::new(false),
            };
            cache.find(&folders).map_err(unusable)?;
            Ok(Arc::new(cache))
        })
        .await?
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, folders: &HashSet<PathBuf>) -> io::Result<()> {
        let root = &self.config.directory;
        let mut found: Vec<(SystemTime, PathBuf, u64)> = vec![];
        let mut open = vec![PathBuf::new()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(root.join(&folder))? {
                let entry = entry?;
                let (path, meta) = (folder.join(entry.file_name()), entry.metadata()?);
                if meta.is_dir() {
                    open.push(path);
                } else if folders.contains(&folder) && is_blob(&path) {
                    found.push((meta.modified()?, path, meta.len()));
                } else if is_ours(&path) {
                    std::fs::remove_file(root.join(&path))?;
                }
            }
        }
        found.sort();
        let mut known = self.known();
        found.into_iter().for_each(|(_, path, num_bytes)| known.used(path, num_bytes));
        let gone = known.beyond(self.config.max_bytes);
        drop(known);
        gone.iter().try_for_each(|file| std::fs::remove_file(root.join(file)))
    }

    fn write(&self, file: PathBuf, bytes: &[u8]) -> io::Result<()> {
        let root = &self.config.directory;
        let part = root.join(&file).with_extension(format!("part{}", self.next_part.fetch_add(1, Ordering::Relaxed)));
        part.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        let written = std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, root.join(&file)));
        if let Err(error) = written {
            let _ = std::fs::remove_file(&part);
            return Err(error);
        }
        let mut known = self.known();
        known.used(file, bytes.len() as u64);
        let gone = known.beyond(self.config.max_bytes);
        drop(known);
        // Another process that shares the directory may have been quicker.
        gone.iter().for_each(|file| drop(std::fs::remove_file(root.join(file))));
        Ok(())
    }

    fn delete(&self, file: &Path) {
        if self.known().forget(file) {
            let _ = std::fs::remove_file(self.config.directory.join(file));
        }
    }

    /// Deletes all of a folder.
    pub(crate) async fn delete_folder(self: Arc<Self>, folder: PathBuf) {
        let work = move || {
            let mut known = self.known();
            let files: Vec<_> = known.files.keys().filter(|file| file.starts_with(&folder)).cloned().collect();
            for file in files {
                known.forget(&file);
            }
            drop(known);
            let _ = std::fs::remove_dir_all(self.config.directory.join(folder));
        };
        let _ = blocking(work).await;
    }

    /// Says once that the cache does not work, until it does again.
    fn note(&self, outcome: &io::Result<()>) {
        match outcome {
            Ok(()) => self.has_failed.store(false, Ordering::Relaxed),
            Err(error) if !self.has_failed.swap(true, Ordering::Relaxed) => {
                let directory = self.config.directory.display();
                tracing::warn!(%directory, %error, "cannot write to the cache of blobs; they come from the bucket");
            }
            Err(_) => {}
        }
    }
}

/// The copies of one session's blobs.
#[derive(Debug, Clone)]
pub(crate) struct CachedBlobs {
    pub(crate) cache: Arc<BlobCache>,
    /// Below the cache's directory.
    pub(crate) folder: PathBuf,
}

impl CachedBlobs {
    /// The copy of a blob, if there is a whole one.
    pub(crate) async fn get(&self, id: BlobId) -> Option<Bytes> {
        let (cache, file) = (self.cache.clone(), self.folder.join(id.to_string()));
        let work = move || {
            let bytes = std::fs::read(cache.config.directory.join(&file)).ok()?;
            if BlobId::of(&bytes) != id {
                cache.known().used(file.clone(), 0);
                cache.delete(&file);
                return None;
            }
            cache.known().used(file, bytes.len() as u64);
            Some(Bytes::from(bytes))
        };
        blocking(work).await.ok().flatten()
    }

    /// Keeps a copy, if it can.
    pub(crate) async fn put(&self, id: BlobId, bytes: Bytes) {
        if bytes.len() as u64 > self.cache.config.max_bytes / 4 {
            return;
        }
        let (cache, file) = (self.cache.clone(), self.folder.join(id.to_string()));
        let work = move || {
            let outcome = cache.write(file, &bytes);
            cache.note(&outcome);
        };
        let _ = blocking(work).await;
    }

    /// Deletes the copy.
    pub(crate) async fn delete(&self, id: BlobId) {
        let (cache, file) = (self.cache.clone(), self.folder.join(id.to_string()));
        let _ = blocking(move || cache.delete(&file)).await;
    }
}

fn is_blob(path: &Path) -> bool {
    path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.parse::<BlobId>().is_ok())
}

/// A blob, or a part of one that was never finished. Nothing else is ever deleted.
fn is_ours(path: &Path) -> bool {
    let is_part = path.extension().and_then(|part| part.to_str()).is_some_and(|part| part.starts_with("part"));
    is_blob(path) || (is_part && is_blob(&path.with_extension("")))
}

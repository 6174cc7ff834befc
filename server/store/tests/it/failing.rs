//! A disk that fills up and is freed again: nothing is acknowledged meanwhile, all goes on afterwards.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use percept_store::{BlobId, SlateStore, Store, StoreConfig, StoreError};

use crate::{key, open, value};

const WELL: u8 = 0;
const FULL: u8 = 1;
const BROKEN: u8 = 2;
const HANGING: u8 = 3;

#[derive(Debug, Default)]
struct Failing {
    inner: InMemory,
    state: AtomicU8,
}

impl Failing {
    fn set(&self, state: u8) {
        self.state.store(state, Ordering::SeqCst);
    }

    async fn check(&self) -> Result<()> {
        let kind = match self.state.load(Ordering::SeqCst) {
            FULL => std::io::ErrorKind::StorageFull,
            BROKEN => std::io::ErrorKind::Other,
            HANGING => {
                while self.state.load(Ordering::SeqCst) == HANGING {
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
                return Ok(());
            }
            _ => return Ok(()),
        };
        Err(Error::Generic { store: "failing", source: Box::new(std::io::Error::from(kind)) })
    }
}

impl std::fmt::Display for Failing {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Failing")
    }
}

#[async_trait]
impl ObjectStore for Failing {
    async fn put_opts(&self, location: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        self.check().await?;
        self.inner.put_opts(location, payload, options).await
    }

    async fn put_multipart_opts(&self, at: &Path, options: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        self.check().await?;
        self.inner.put_multipart_opts(at, options).await
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

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}

async fn prepared() -> (Arc<Failing>, StoreConfig, SlateStore) {
    let objects = Arc::new(Failing::default());
    let mut config = StoreConfig::objects(objects.clone());
    config.commit_timeout = Duration::from_millis(400);
    let store = SlateStore::open(config.clone()).await.unwrap();
    store.put(key("before"), value("1")).await.unwrap();
    (objects, config, store)
}

/// Writes until one gets through, as a caller would that retries.
async fn put_until_acknowledged(store: &SlateStore, text: &str) {
    for _ in 0..100 {
        if store.put(key(text), value("1")).await.is_ok() {
            return;
        }
    }
    panic!("never recovered");
}

#[tokio::test]
async fn a_full_disk_is_said_and_goes_away_again() {
    let (objects, config, store) = prepared().await;
    objects.set(FULL);
    for _ in 0..3 {
        assert!(matches!(store.put(key("during"), value("1")).await, Err(StoreError::Full)));
    }
    assert!(matches!(store.put_blob(value("blob")).await, Err(StoreError::Full)));
    // What is not durable is not shown.
    assert_eq!(store.get(&key("during")).await.unwrap(), None);
    assert_eq!(store.get(&key("before")).await.unwrap(), Some(value("1")));
    objects.set(WELL);
    put_until_acknowledged(&store, "after").await;
    store.put_blob(value("blob")).await.unwrap();
    store.close().await.unwrap();
    let again = SlateStore::open(config).await.unwrap();
    for name in ["before", "after"] {
        assert_eq!(again.get(&key(name)).await.unwrap(), Some(value("1")));
    }
}

#[tokio::test]
async fn a_broken_or_hanging_disk_fails_the_write_in_time() {
    let (objects, _, store) = prepared().await;
    objects.set(BROKEN);
    assert!(matches!(store.put(key("a"), value("1")).await, Err(StoreError::Io { .. })));
    assert!(matches!(store.put_blob(value("blob")).await, Err(StoreError::Io { .. })));
    objects.set(WELL);
    put_until_acknowledged(&store, "b").await;
    let (objects, _, store) = prepared().await;
    objects.set(HANGING);
    assert!(matches!(store.put(key("a"), value("1")).await, Err(StoreError::Stalled { .. })));
    objects.set(WELL);
    put_until_acknowledged(&store, "b").await;
}

#[tokio::test]
async fn closing_on_a_full_disk_ends_and_keeps_what_was_acknowledged() {
    let (objects, config, store) = prepared().await;
    objects.set(FULL);
    assert!(store.put(key("during"), value("1")).await.is_err());
    assert!(store.close().await.is_err());
    objects.set(WELL);
    let again = SlateStore::open(config).await.unwrap();
    assert_eq!(again.get(&key("before")).await.unwrap(), Some(value("1")));
}

/// With `PERCEPT_SMALL_DISK` naming a directory on a file system of a few dozen megabytes.
#[tokio::test]
async fn a_really_full_disk_loses_nothing() {
    let Ok(disk) = std::env::var("PERCEPT_SMALL_DISK") else { return };
    let directory = tempfile::tempdir_in(disk).unwrap();
    let store = open(directory.path()).await;
    let mut kept: Vec<BlobId> = Vec::new();
    let full = loop {
        let content = Bytes::from(vec![kept.len() as u8; 1 << 20]);
        match store.put_blob(content).await {
            Ok(id) => kept.push(id),
            Err(error) => break error,
        }
        assert!(kept.len() < 200, "not a small disk");
    };
    assert!(matches!(full, StoreError::Full), "{full:?}");
    let mut written = 0u64;
    let full = loop {
        let record = (key("r").numbered(written).unwrap(), Bytes::from(vec![1; 100_000]));
        match store.put_batch(vec![record], vec![]).await {
            Ok(()) => written += 1,
            Err(error) => break error,
        }
    };
    assert!(matches!(full, StoreError::Full), "{full:?}");
    let freed = kept.pop().unwrap().to_string();
    std::fs::remove_file(directory.path().join("blobs").join(&freed[..2]).join(freed)).unwrap();
    put_until_acknowledged(&store, "after").await;
    store.close().await.unwrap();
    let store = open(directory.path()).await;
    assert!(store.scan_all(&key("r").prefix()).await.unwrap().len() as u64 >= written);
    assert!(store.get(&key("after")).await.unwrap().is_some());
    for id in kept {
        store.get_blob(id).await.unwrap();
    }
}

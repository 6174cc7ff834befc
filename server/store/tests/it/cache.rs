//! Copies of blobs on the local disk: they spare the way to the bucket, and nothing rests on them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt};
use percept_store::{BlobId, CacheConfig, RootConfig, Store, StoreError};

use crate::{Opened, open_with, value};

fn cached(bucket: &Arc<InMemory>, directory: &Path, max_bytes: u64) -> RootConfig {
    let cache = Some(CacheConfig { directory: directory.to_owned(), max_bytes });
    RootConfig { cache, ..RootConfig::objects(bucket.clone()) }
}

/// Takes a blob out of the bucket behind the store's back.
async fn lose(bucket: &InMemory, id: BlobId) {
    let objects: Vec<_> = bucket.list(None).try_collect().await.unwrap();
    let blob = objects.iter().find(|object| object.location.filename() == Some(&id.to_string())).unwrap();
    bucket.delete(&blob.location).await.unwrap();
}

/// All files below a directory.
fn files(directory: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

fn copy_of(directory: &Path, id: BlobId) -> PathBuf {
    files(directory).into_iter().find(|file| file.ends_with(id.to_string())).unwrap()
}

async fn prepared(directory: &Path, max_bytes: u64) -> (Arc<InMemory>, RootConfig, Opened) {
    let bucket = Arc::new(InMemory::new());
    let config = cached(&bucket, directory, max_bytes);
    let store = open_with(config.clone()).await;
    (bucket, config, store)
}

#[tokio::test]
async fn what_was_stored_or_read_is_read_from_here_also_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let (bucket, config, store) = prepared(directory.path(), 1 << 20).await;
    let id = store.put_blob(value("a scan")).await.unwrap();
    lose(&bucket, id).await;
    assert_eq!(store.get_blob(id).await.unwrap(), value("a scan"));
    let Opened { store, place, root } = store;
    store.close().await.unwrap();
    drop((store, root));
    let root = percept_store::DataRoot::open(config).await.unwrap();
    let store = root.open_session(&place).await.unwrap();
    assert_eq!(store.get_blob(id).await.unwrap(), value("a scan"));
    // Whether the data are whole is asked of the data.
    assert!(matches!(root.read_session(&place).get_blob(id).await, Err(StoreError::BlobMissing { .. })));
    // And a cache that was lost is filled again by reading.
    let other = store.put_blob(value("another")).await.unwrap();
    std::fs::remove_file(copy_of(directory.path(), other)).unwrap();
    assert_eq!(store.get_blob(other).await.unwrap(), value("another"));
    assert!(copy_of(directory.path(), other).exists());
}

#[tokio::test]
async fn a_damaged_copy_is_not_believed() {
    let directory = tempfile::tempdir().unwrap();
    let (_bucket, _config, store) = prepared(directory.path(), 1 << 20).await;
    let id = store.put_blob(value("precious")).await.unwrap();
    for damaged in [&b"preciouS"[..], b"prec", b""] {
        std::fs::write(copy_of(directory.path(), id), damaged).unwrap();
        assert_eq!(store.get_blob(id).await.unwrap(), value("precious"));
        assert_eq!(std::fs::read(copy_of(directory.path(), id)).unwrap(), b"precious");
    }
}

#[tokio::test]
async fn it_keeps_within_its_bytes_and_lets_go_first_of_what_was_used_longest_ago() {
    let directory = tempfile::tempdir().unwrap();
    let (bucket, _config, store) = prepared(directory.path(), 10_000).await;
    let mut ids = vec![];
    for i in 0..4u8 {
        ids.push(store.put_blob(Bytes::from(vec![i; 2_400])).await.unwrap());
    }
    store.get_blob(ids[0]).await.unwrap();
    ids.push(store.put_blob(Bytes::from(vec![4; 2_400])).await.unwrap());
    let size = |file: &PathBuf| std::fs::metadata(file).unwrap().len();
    assert!(files(directory.path()).iter().map(size).sum::<u64>() <= 10_000);
    for id in &ids {
        lose(&bucket, *id).await;
    }
    let mut is_here = vec![];
    for id in ids {
        is_here.push(store.get_blob(id).await.is_ok());
    }
    assert_eq!(is_here, [true, false, true, true, true]);
    // One that would take the place of all others is not kept.
    let large = store.put_blob(Bytes::from(vec![9; 5_000])).await.unwrap();
    assert_eq!(store.get_blob(large).await.unwrap().len(), 5_000);
    assert!(files(directory.path()).iter().all(|file| size(file) == 2_400));
}

#[tokio::test]
async fn nothing_of_a_deleted_session_stays() {
    let directory = tempfile::tempdir().unwrap();
    let (bucket, config, store) = prepared(directory.path(), 1 << 20).await;
    let id = store.put_blob(value("secret")).await.unwrap();
    let Opened { store, place, root } = store;
    store.close().await.unwrap();
    let copy = copy_of(directory.path(), id);
    root.bury(&place).await.unwrap();
    root.purge(&place).await.unwrap();
    assert!(!copy.exists());
    drop(root);
    // Nor if another server deleted it; and what is not ours is left alone.
    std::fs::create_dir_all(copy.parent().unwrap()).unwrap();
    std::fs::write(&copy, b"secret").unwrap();
    std::fs::write(copy.with_extension("part3"), b"sec").unwrap();
    std::fs::write(directory.path().join("notes.txt"), b"mine").unwrap();
    let _root = percept_store::DataRoot::open(cached(&bucket, directory.path(), 1 << 20)).await.unwrap();
    assert_eq!(files(directory.path()), [directory.path().join("notes.txt")]);
    drop(config);
}

#[tokio::test]
async fn a_cache_that_cannot_be_written_is_done_without() {
    let directory = tempfile::tempdir().unwrap();
    let (_bucket, _config, store) = prepared(directory.path(), 1 << 20).await;
    let first = store.put_blob(value("first")).await.unwrap();
    let folder = directory.path().join("sessions");
    std::fs::remove_dir_all(&folder).unwrap();
    std::fs::write(&folder, b"in the way").unwrap();
    let second = store.put_blob(value("second")).await.unwrap();
    assert_eq!(store.get_blob(first).await.unwrap(), value("first"));
    assert_eq!(store.get_blob(second).await.unwrap(), value("second"));
}

#[tokio::test]
async fn a_cache_that_cannot_be_made_is_said() {
    let directory = tempfile::tempdir().unwrap();
    let taken = directory.path().join("taken");
    std::fs::write(&taken, b"a file").unwrap();
    let error = percept_store::DataRoot::open(cached(&Arc::new(InMemory::new()), &taken, 1 << 20)).await.unwrap_err();
    assert!(matches!(&error, StoreError::CacheUnusable { directory, .. } if *directory == taken), "{error}");
    assert!(error.to_string().contains("name a directory that can be written"), "{error}");
}

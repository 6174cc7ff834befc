use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::TryStreamExt;
use percept_store::{BlobId, SlateStore, Store, StoreError};

use crate::{Opened, open, value};

fn file_of(store: &Opened, id: BlobId) -> PathBuf {
    store.folder().join("blobs").join(id.to_string())
}

fn make_old(path: &Path, age: Duration) {
    let file = std::fs::File::options().write(true).open(path).unwrap();
    file.set_modified(SystemTime::now() - age).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sixteen_writers_of_the_same_blob_agree() {
    let directory = tempfile::tempdir().unwrap();
    let store = Arc::new(open(directory.path()).await);
    for round in 0..10u8 {
        let content = Bytes::from(vec![round; 200_000]);
        let writers: Vec<_> = (0..16)
            .map(|_| {
                let (store, content) = (store.clone(), content.clone());
                tokio::spawn(async move { store.put_blob(content).await.unwrap() })
            })
            .collect();
        for writer in writers {
            assert_eq!(writer.await.unwrap(), BlobId::of(&content));
        }
        assert_eq!(store.get_blob(BlobId::of(&content)).await.unwrap(), content);
    }
    let blobs: Vec<_> = store.blobs().try_collect().await.unwrap();
    assert_eq!(blobs.len(), 10);
    assert!(blobs.iter().all(|(_, num_bytes)| *num_bytes == 200_000));
}

#[tokio::test]
async fn a_damaged_blob_is_detected_and_mended_by_storing_it_again() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path()).await;
    let id = store.put_blob(value("precious")).await.unwrap();
    let file = file_of(&store, id);
    for damaged in [&b"preciouS"[..], b"prec", b""] {
        std::fs::write(&file, damaged).unwrap();
        make_old(&file, Duration::from_secs(3600));
        let error = store.get_blob(id).await.unwrap_err();
        assert!(matches!(error, StoreError::BlobCorrupt { id: named } if named == id));
        assert_eq!(store.put_blob(value("precious")).await.unwrap(), id);
        assert_eq!(store.get_blob(id).await.unwrap(), value("precious"));
    }
    std::fs::remove_file(&file).unwrap();
    assert!(matches!(store.get_blob(id).await, Err(StoreError::BlobMissing { .. })));
    assert!(!store.blob_exists(id).await.unwrap());
}

#[tokio::test]
async fn garbage_is_what_is_neither_named_nor_young() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path()).await;
    let mut ids = Vec::new();
    for name in ["live", "old", "young", "again"] {
        ids.push(store.put_blob(value(name)).await.unwrap());
    }
    let [live, old, young, again] = ids[..] else { unreachable!() };
    for id in [live, old, again] {
        make_old(&file_of(&store, id), Duration::from_secs(7200));
    }
    let mark = store.mark();
    // Somebody is about to name this one again.
    store.put_blob(value("again")).await.unwrap();
    let report = store.collect_garbage(&HashSet::from([live]), mark, Duration::from_secs(3600)).await.unwrap();
    assert_eq!((report.num_seen, report.num_live, report.num_young, report.num_deleted), (4, 1, 2, 1));
    assert_eq!(report.deleted_bytes, 3);
    for (id, stays) in [(live, true), (old, false), (young, true), (again, true)] {
        assert_eq!(store.blob_exists(id).await.unwrap(), stays);
    }
    assert_eq!(store.put_blob(value("old")).await.unwrap(), old);
}

#[tokio::test]
async fn memory_has_the_same_blobs() {
    let store = SlateStore::in_memory().await.unwrap();
    let id = store.put_blob(value("x")).await.unwrap();
    assert_eq!(store.put_blob(value("x")).await.unwrap(), id);
    assert_eq!(store.get_blob(id).await.unwrap(), value("x"));
    assert!(matches!(store.get_blob(BlobId::of(b"y")).await, Err(StoreError::BlobMissing { .. })));
    let report = store.collect_garbage(&HashSet::new(), store.mark(), Duration::ZERO).await.unwrap();
    assert_eq!(report.num_deleted, 1);
}

#[tokio::test]
async fn what_is_stored_while_garbage_is_collected_stays_whatever_the_clocks_say() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path()).await;
    let before = store.put_blob(value("before")).await.unwrap();
    let mark = store.mark();
    let after = store.put_blob(value("after")).await.unwrap();
    // A clock that was set forward, a machine that was suspended: everything looks old.
    for id in [before, after] {
        make_old(&file_of(&store, id), Duration::from_secs(7200));
    }
    let report = store.collect_garbage(&HashSet::new(), mark, Duration::from_secs(120)).await.unwrap();
    assert_eq!((report.num_young, report.num_deleted), (1, 1));
    assert!(store.blob_exists(after).await.unwrap() && !store.blob_exists(before).await.unwrap());
}

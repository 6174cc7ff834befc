use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::ObjectStore;
use object_store::memory::InMemory;
use percept_store::{Key, Prefix, SlateStore, Store, StoreConfig, StoreError, keys};

use crate::{key, open, value};

fn texts(records: &[(Key, Bytes)]) -> Vec<&str> {
    records.iter().map(|(key, _)| key.as_str()).collect()
}

#[tokio::test]
async fn a_batch_deletes_first_and_the_last_value_stands() {
    let store = SlateStore::in_memory().await.unwrap();
    store.put_batch(vec![(key("a"), value("1")), (key("b"), value("1"))], vec![]).await.unwrap();
    let puts = vec![(key("a"), value("2")), (key("c"), value("1")), (key("c"), value("2"))];
    store.put_batch(puts, vec![key("a"), key("b"), key("never-there")]).await.unwrap();
    assert_eq!(store.get(&key("a")).await.unwrap(), Some(value("2")));
    assert_eq!(store.get(&key("b")).await.unwrap(), None);
    assert_eq!(store.get(&key("c")).await.unwrap(), Some(value("2")));
    store.put_batch(vec![], vec![]).await.unwrap();
    store.put(key("empty"), Bytes::new()).await.unwrap();
    assert_eq!(store.get(&key("empty")).await.unwrap(), Some(Bytes::new()));
}

#[tokio::test]
async fn a_scan_is_ordered_ends_at_the_prefix_and_pages() {
    let store = SlateStore::in_memory().await.unwrap();
    let numbers = [300u64, 2, 1, 1 << 40, 255, 256];
    let mut puts: Vec<_> = numbers.iter().map(|&number| (keys::keyframe(number), value(&number.to_string()))).collect();
    puts.extend([(key("keyframes2/3"), value("x")), (keys::meta(), value("meta")), (key("keyframes"), value("x"))]);
    store.put_batch(puts, vec![]).await.unwrap();
    store.confirm_ownership().await.unwrap();

    let keyframes = store.scan_all(&keys::keyframes()).await.unwrap();
    let found: Vec<u64> = keyframes.iter().map(|(key, _)| key.number().unwrap()).collect();
    assert_eq!(found, [1, 2, 255, 256, 300, 1 << 40]);
    let rest: Vec<_> = store.scan(&keys::keyframes(), Some(&keys::keyframe(256))).try_collect().await.unwrap();
    assert_eq!(rest, keyframes[4..]);
    assert_eq!(store.last(&keys::keyframes()).await.unwrap().unwrap().0, keys::keyframe(1 << 40));
    assert_eq!(store.last(&keys::trajectories()).await.unwrap(), None);

    // The store's own records are nobody else's.
    let all = store.scan_all(&Prefix::everything()).await.unwrap();
    assert_eq!(all.len(), 9);
    assert!(texts(&all).is_sorted());
    assert_eq!(store.last(&Prefix::everything()).await.unwrap().unwrap().0, keys::meta());
}

#[tokio::test]
async fn limits_are_refused_one_byte_above_and_nothing_is_written() {
    let mut config = StoreConfig::default();
    (config.max_record_bytes, config.max_batch_bytes, config.max_blob_bytes) = (100, 202, 10);
    let store = SlateStore::open(Arc::new(InMemory::new()), config).await.unwrap();
    let sized = |size: usize| Bytes::from(vec![7; size]);
    store.put_batch(vec![(key("a"), sized(100)), (key("b"), sized(100))], vec![]).await.unwrap();
    let error = store.put(key("c"), sized(101)).await.unwrap_err();
    assert!(matches!(error, StoreError::RecordTooLarge { num_bytes: 101, limit: 100, .. }));
    let error = store.put_batch(vec![(key("c"), sized(100)), (key("d"), sized(100))], vec![key("e")]).await;
    assert!(matches!(error, Err(StoreError::BatchTooLarge { num_bytes: 203, limit: 202 })));
    assert_eq!(store.get(&key("c")).await.unwrap(), None);
    store.put_blob(sized(10)).await.unwrap();
    let error = store.put_blob(sized(11)).await.unwrap_err();
    assert!(matches!(error, StoreError::BlobTooLarge { num_bytes: 11, limit: 10 }));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_callers_at_once_all_get_through() {
    let directory = tempfile::tempdir().unwrap();
    let store = Arc::new(open(directory.path()).await);
    let writers: Vec<_> = (0..32u64)
        .map(|writer| {
            let store = store.clone();
            tokio::spawn(async move {
                let own = key(&format!("w{writer}"));
                for number in 0..20 {
                    store.put(own.numbered(number).unwrap(), value("x")).await.unwrap();
                    assert!(store.get(&own.numbered(number).unwrap()).await.unwrap().is_some());
                }
            })
        })
        .collect();
    for writer in writers {
        writer.await.unwrap();
    }
    assert_eq!(store.scan_all(&Prefix::everything()).await.unwrap().len(), 640);
    store.close().await.unwrap();
}

#[test]
fn what_was_acknowledged_survives_a_drop_without_close() {
    let directory = tempfile::tempdir().unwrap();
    let run = || tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let runtime = run();
    runtime.block_on(async {
        let store = open(directory.path()).await;
        store.put(key("a/1"), value("one")).await.unwrap();
        store.put_blob(value("blob")).await.unwrap();
        // The process is gone, and its lock with it, before anything could be closed.
        drop(store.root);
        std::mem::forget(store.store);
    });
    // Every task is dropped where it stands.
    runtime.shutdown_background();
    run().block_on(async {
        let store = open(directory.path()).await;
        assert_eq!(store.get(&key("a/1")).await.unwrap(), Some(value("one")));
        let id = percept_store::BlobId::of(b"blob");
        assert_eq!(store.get_blob(id).await.unwrap(), value("blob"));
        // Dropped on a living runtime, it closes by itself and lets go of the directory.
        drop(store);
        assert_eq!(open(directory.path()).await.get(&key("a/1")).await.unwrap(), Some(value("one")));
    });
}

#[tokio::test]
async fn records_are_written_on_the_runtime_that_is_given() {
    let apart = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let config = StoreConfig { runtime: Some(apart.handle().clone()), ..StoreConfig::default() };
    let store = SlateStore::open(Arc::new(InMemory::new()), config).await.unwrap();
    store.put(key("a"), value("1")).await.unwrap();
    assert_eq!(store.get(&key("a")).await.unwrap(), Some(value("1")));
    // Nobody else writes. A runtime is down only once its threads are: waited for where blocking is allowed.
    let down = std::thread::spawn(move || apart.shutdown_timeout(Duration::from_secs(60)));
    tokio::task::spawn_blocking(move || down.join()).await.unwrap().unwrap();
    assert!(matches!(store.put(key("b"), value("2")).await, Err(StoreError::Closed)));
}

#[tokio::test]
async fn a_closed_store_says_so() {
    let objects: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
    let store = SlateStore::open(objects.clone(), StoreConfig::default()).await.unwrap();
    store.put(key("a"), value("1")).await.unwrap();
    store.close().await.unwrap();
    store.close().await.unwrap();
    assert!(matches!(store.put(key("b"), value("2")).await, Err(StoreError::Closed)));
    assert!(matches!(store.get(&key("a")).await, Err(StoreError::Closed)));
    let again = SlateStore::open(objects, StoreConfig::default()).await.unwrap();
    assert_eq!(again.get(&key("a")).await.unwrap(), Some(value("1")));
}

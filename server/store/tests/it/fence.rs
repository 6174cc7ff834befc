use std::sync::Arc;
use std::time::Duration;

use object_store::ObjectStore;
use object_store::memory::InMemory;
use percept_store::{DataRoot, RootConfig, SlateStore, Store, StoreConfig, StoreError};

use crate::{created, key, open, value};

#[tokio::test]
async fn the_older_of_two_writers_is_fenced() {
    let directory = tempfile::tempdir().unwrap();
    let mut config = RootConfig::directory(directory.path());
    config.lock_directory = false;
    for config in [RootConfig::in_memory(), config] {
        let root = DataRoot::open(config.clone()).await.unwrap();
        let place = root.create("a", b"").await.unwrap();
        let older = root.open_session(&place).await.unwrap();
        older.put(key("a"), value("older")).await.unwrap();
        let second = DataRoot::open(config).await.unwrap();
        let newer = second.open_session(&created(&second, "a").await.unwrap().0).await.unwrap();
        assert_eq!(newer.epoch(), older.epoch() + 1);
        let error = older.put(key("a"), value("too late")).await.unwrap_err();
        assert!(matches!(error, StoreError::Fenced { epoch } if epoch == older.epoch()), "{error:?}");
        assert!(matches!(older.confirm_ownership().await, Err(StoreError::Fenced { .. })));
        older.put_blob(value("garbage")).await.unwrap();
        let sweep = older.collect_garbage(&Default::default(), older.mark(), Duration::ZERO).await;
        assert!(matches!(sweep, Err(StoreError::Fenced { .. })));
        assert!(matches!(older.close().await, Err(StoreError::Fenced { .. })));
        assert_eq!(newer.get(&key("a")).await.unwrap(), Some(value("older")));
        newer.put(key("a"), value("newer")).await.unwrap();
        newer.close().await.unwrap();
        let third = root.open_session(&place).await.unwrap();
        assert_eq!(third.get(&key("a")).await.unwrap(), Some(value("newer")));
    }
}

#[tokio::test]
async fn an_expected_epoch_is_taken_by_one_only() {
    let objects: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
    let first = SlateStore::open(objects.clone(), StoreConfig::default()).await.unwrap();
    let claim = StoreConfig { expected_epoch: Some(first.epoch()), ..StoreConfig::default() };
    let claims = (0..8).map(|_| SlateStore::open(objects.clone(), claim.clone()));
    let claims = futures::future::join_all(claims).await;
    let won: Vec<_> = claims.iter().filter_map(|claim| claim.as_ref().ok()).collect();
    assert_eq!(won.len(), 1);
    assert_eq!(won[0].epoch(), first.epoch() + 1);
    let lost = claims.iter().filter(|claim| matches!(claim, Err(StoreError::Fenced { .. })));
    assert_eq!(lost.count(), 7);
    won[0].put(key("a"), value("1")).await.unwrap();
    assert!(matches!(first.put(key("a"), value("0")).await, Err(StoreError::Fenced { .. })));
}

#[tokio::test]
async fn a_directory_in_use_is_not_taken_over() {
    let directory = tempfile::tempdir().unwrap();
    let first = open(directory.path()).await;
    let mut config = RootConfig::directory(directory.path());
    config.lock_wait = Duration::from_millis(50);
    let error = DataRoot::open(config.clone()).await.unwrap_err();
    assert!(matches!(&error, StoreError::DirectoryInUse { path } if path == directory.path()), "{error}");
    first.put(key("a"), value("still the owner")).await.unwrap();
    first.close().await.unwrap();
    drop(first);
    DataRoot::open(config).await.unwrap();
}

#[tokio::test]
async fn data_of_a_newer_version_are_left_alone() {
    let directory = tempfile::tempdir().unwrap();
    open(directory.path()).await.close().await.unwrap();
    let format = directory.path().join("FORMAT");
    assert_eq!(std::fs::read_to_string(&format).unwrap(), "percept-store 2\n");
    let config = RootConfig::directory(directory.path());
    std::fs::write(&format, "percept-store 3\n").unwrap();
    let error = DataRoot::open(config.clone()).await.unwrap_err();
    assert!(matches!(error, StoreError::FormatTooNew { found: 3, supported: 2 }));
    for damaged in ["", "percept-store x\n", "percept-store 0\n", "\u{0}\u{0}"] {
        std::fs::write(&format, damaged).unwrap();
        let error = DataRoot::open(config.clone()).await.unwrap_err();
        assert!(matches!(error, StoreError::FormatUnreadable { .. }), "{damaged:?}: {error}");
    }
    std::fs::write(&format, "percept-store 2\n").unwrap();
    let root = DataRoot::open(config).await.unwrap();
    assert!(created(&root, "s").await.is_some());
}

//! A disk that fills up, breaks or hangs and is well again: nothing is acknowledged meanwhile, all goes on afterwards.

use std::sync::Arc;
use std::time::Duration;

use percept_store::{DataRoot, RootConfig, SlateStore, Store, StoreError};

use crate::faulty::{Faulty, Plan};
use crate::{Opened, created, key, open_with, value};

async fn prepared() -> (Faulty, RootConfig, Opened) {
    let objects = Faulty::new();
    let mut config = RootConfig::objects(Arc::new(objects.clone()));
    config.session.commit_timeout = Duration::from_millis(400);
    let store = open_with(config.clone()).await;
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
    objects.set(Plan::Full);
    for _ in 0..3 {
        assert!(matches!(store.put(key("during"), value("1")).await, Err(StoreError::Full)));
    }
    assert!(matches!(store.put_blob(value("blob")).await, Err(StoreError::Full)));
    // What is not durable is not shown.
    assert_eq!(store.get(&key("during")).await.unwrap(), None);
    assert_eq!(store.get(&key("before")).await.unwrap(), Some(value("1")));
    objects.set(Plan::Well);
    put_until_acknowledged(&store, "after").await;
    store.put_blob(value("blob")).await.unwrap();
    store.close().await.unwrap();
    let again = open_with(config).await;
    for name in ["before", "after"] {
        assert_eq!(again.get(&key(name)).await.unwrap(), Some(value("1")));
    }
}

#[tokio::test]
async fn a_broken_or_hanging_disk_fails_the_write_in_time() {
    let (objects, _, store) = prepared().await;
    objects.set(Plan::Broken);
    assert!(matches!(store.put(key("a"), value("1")).await, Err(StoreError::Io { .. })));
    assert!(matches!(store.put_blob(value("blob")).await, Err(StoreError::Io { .. })));
    objects.set(Plan::Well);
    put_until_acknowledged(&store, "b").await;
    let (objects, _, store) = prepared().await;
    objects.set(Plan::Hanging);
    assert!(matches!(store.put(key("a"), value("1")).await, Err(StoreError::Stalled { .. })));
    objects.set(Plan::Well);
    put_until_acknowledged(&store, "b").await;
}

#[tokio::test]
async fn closing_on_a_full_disk_ends_and_keeps_what_was_acknowledged() {
    let (objects, config, store) = prepared().await;
    objects.set(Plan::Full);
    assert!(store.put(key("during"), value("1")).await.is_err());
    assert!(store.close().await.is_err());
    objects.set(Plan::Well);
    let again = open_with(config).await;
    assert_eq!(again.get(&key("before")).await.unwrap(), Some(value("1")));
}

#[tokio::test]
async fn a_catalogue_on_a_full_disk_says_so_and_goes_on_afterwards() {
    let (objects, config, store) = prepared().await;
    let root = &store.root;
    objects.set(Plan::Full);
    assert!(matches!(root.create("b", b"").await, Err(StoreError::Full)));
    assert!(matches!(root.bury(&store.place).await, Err(StoreError::Full)));
    assert!(matches!(root.set_summary(&store.place, value("x")).await, Err(StoreError::Full)));
    assert!(matches!(root.probe().await, Err(StoreError::Full)));
    assert!(root.num_failures() >= 4);
    assert_eq!(root.list().await.unwrap().len(), 1);
    objects.set(Plan::Well);
    root.probe().await.unwrap();
    root.create("b", b"record").await.unwrap();
    root.bury(&store.place).await.unwrap();
    let again = DataRoot::open(config).await.unwrap();
    assert_eq!(created(&again, "b").await.unwrap().1, value("record"));
    assert!(created(&again, "s").await.is_none());
}

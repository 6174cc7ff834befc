//! Data of earlier formats open, whatever happens while they are brought to the current one.

use std::collections::HashMap;
use std::sync::Arc;

use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutPayload};
use percept_store::{BlobId, DataRoot, Prefix, RootConfig, SlateStore, Store, StoreConfig, StoreError};

use crate::faulty::{Faulty, Plan};
use crate::{created, key, value};

const SESSIONS: [&str; 3] = ["a", "b", "empty"];

/// What session `id` has, by key: two keyframes, of which the second is shared with all others, and two more records.
fn records(id: &str) -> HashMap<String, String> {
    if id == "empty" {
        return HashMap::new();
    }
    let keyframe = |content: &str| format!(r#"{{"pose":[1,2],"blob":"{}"}}"#, BlobId::of(content.as_bytes()));
    let records = [
        ("keyframes/0000000000000000".to_owned(), keyframe(&format!("scan of {id}"))),
        ("keyframes/0000000000000001".to_owned(), keyframe("scan of all")),
        ("state".to_owned(), format!("state of {id}")),
        ("objects".to_owned(), "[]".to_owned()),
    ];
    records.into()
}

/// The layout of format 1.
async fn format_1() -> Arc<InMemory> {
    let objects = Arc::new(InMemory::new());
    objects.put(&"FORMAT".into(), PutPayload::from_static(b"percept-store 1\n")).await.unwrap();
    let store = SlateStore::open(objects.clone(), StoreConfig::default()).await.unwrap();
    for id in SESSIONS {
        let mut puts = vec![(key(&format!("catalog/{id}")), value(&format!("record of {id}")))];
        puts.extend(records(id).iter().map(|(name, text)| (key(&format!("sessions/{id}/{name}")), value(text))));
        store.put_batch(puts, Vec::new()).await.unwrap();
    }
    store.close().await.unwrap();
    for content in ["scan of a", "scan of b", "scan of all", "nobody's"] {
        let id = BlobId::of(content.as_bytes()).to_string();
        let path = Path::from(format!("blobs/{}/{id}", &id[..2]));
        objects.put(&path, PutPayload::from(value(content))).await.unwrap();
    }
    objects
}

async fn check(root: &DataRoot) {
    assert_eq!(root.list().await.unwrap().len(), SESSIONS.len());
    for id in SESSIONS {
        let (place, record) = created(root, id).await.unwrap();
        assert_eq!(record, value(&format!("record of {id}")));
        let store = root.open_session(&place).await.unwrap();
        let found = store.scan_all(&Prefix::everything()).await.unwrap();
        let found = found.into_iter().map(|(key, text)| (key.to_string(), String::from_utf8(text.to_vec()).unwrap()));
        assert_eq!(found.collect::<HashMap<_, _>>(), records(id));
        if id != "empty" {
            for content in [&format!("scan of {id}"), "scan of all"] {
                assert_eq!(store.get_blob(BlobId::of(content.as_bytes())).await.unwrap(), value(content));
            }
        }
        store.close().await.unwrap();
    }
}

#[tokio::test]
async fn sessions_of_format_1_have_all_that_they_had() {
    let objects = format_1().await;
    let config = RootConfig::objects(objects.clone());
    for _ in 0..2 {
        check(&DataRoot::open(config.clone()).await.unwrap()).await;
    }
    let left = objects.list_with_delimiter(None).await.unwrap();
    let folders: Vec<_> = left.common_prefixes.iter().map(AsRef::as_ref).collect();
    assert_eq!(folders, ["catalogue", "sessions"]);
    let format = objects.get(&"FORMAT".into()).await.unwrap().bytes().await.unwrap();
    assert_eq!(format, value("percept-store 2\n"));
}

#[test]
fn a_migration_that_broke_off_at_any_write_loses_nothing() {
    let runtime = || tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let before = runtime().block_on(format_1());
    let mut write = 0;
    let mut finished = false;
    while !finished {
        for applied in [false, true] {
            let objects = Faulty::over(Arc::new(before.fork()));
            let config = RootConfig::objects(Arc::new(objects.clone()));
            objects.set(Plan::CutAt { write, applied });
            // All tasks of the process that was killed end with its runtime.
            finished = runtime().block_on(async {
                tokio::select! {
                    root = DataRoot::open(config.clone()) => root.is_ok(),
                    () = objects.cut() => false,
                }
            });
            objects.set(Plan::Well);
            runtime().block_on(async { check(&DataRoot::open(config).await.unwrap()).await });
        }
        write += 1;
    }
    assert!(write > 20, "too few to prove anything: {write}");
}

#[tokio::test]
async fn a_session_whose_scan_was_lost_before_is_kept_as_it_is() {
    let objects = format_1().await;
    let id = BlobId::of(b"scan of a").to_string();
    objects.delete(&Path::from(format!("blobs/{}/{id}", &id[..2]))).await.unwrap();
    let root = DataRoot::open(RootConfig::objects(objects)).await.unwrap();
    let (place, _) = created(&root, "a").await.unwrap();
    let store = root.open_session(&place).await.unwrap();
    assert_eq!(store.scan_all(&Prefix::everything()).await.unwrap().len(), 4);
    assert!(matches!(store.get_blob(BlobId::of(b"scan of a")).await, Err(StoreError::BlobMissing { .. })));
    store.get_blob(BlobId::of(b"scan of all")).await.unwrap();
}

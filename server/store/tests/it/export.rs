use bytes::Bytes;
use futures::TryStreamExt;
use percept_store::export::{BlobContent, export, import};
use percept_store::{Prefix, SlateStore, Store, StoreError, keys};

use crate::{key, value};

async fn filled() -> SlateStore {
    let store = SlateStore::in_memory().await.unwrap();
    let puts = (0..300u64).map(|number| (keys::keyframe(number), Bytes::from(vec![number as u8; 9_000]))).collect();
    store.put_batch(puts, vec![]).await.unwrap();
    store.put(keys::meta(), Bytes::new()).await.unwrap();
    for size in [0usize, 1, 3_000_000] {
        store.put_blob(Bytes::from(vec![1; size])).await.unwrap();
    }
    store.confirm_ownership().await.unwrap();
    store
}

async fn exported(store: &SlateStore, content: BlobContent) -> Vec<u8> {
    let mut bytes = Vec::new();
    let carried = export(store, &mut bytes, content).await.unwrap();
    assert_eq!((carried.num_records, carried.num_blobs), (301, 3));
    bytes
}

#[tokio::test]
async fn an_import_holds_what_was_exported() {
    let store = filled().await;
    let bytes = exported(&store, BlobContent::Included).await;
    let copy = SlateStore::in_memory().await.unwrap();
    let carried = import(&copy, &mut &bytes[..]).await.unwrap();
    assert_eq!((carried.num_records, carried.num_blobs, carried.missing_blobs.len()), (301, 3, 0));
    let everything = Prefix::everything();
    assert_eq!(copy.scan_all(&everything).await.unwrap(), store.scan_all(&everything).await.unwrap());
    let blobs: Vec<_> = store.blobs().try_collect().await.unwrap();
    for (id, _) in blobs {
        assert_eq!(copy.get_blob(id).await.unwrap(), store.get_blob(id).await.unwrap());
    }
    assert!(matches!(import(&copy, &mut &bytes[..]).await, Err(StoreError::NotEmpty)));
}

#[tokio::test]
async fn a_listing_says_which_blobs_are_missing() {
    let store = filled().await;
    let bytes = exported(&store, BlobContent::ListedOnly).await;
    let copy = SlateStore::in_memory().await.unwrap();
    let there = copy.put_blob(Bytes::from(vec![1; 1])).await.unwrap();
    let carried = import(&copy, &mut &bytes[..]).await.unwrap();
    assert_eq!(carried.missing_blobs.len(), 2);
    assert!(!carried.missing_blobs.contains(&there));
}

#[tokio::test]
async fn damaged_exports_are_refused_wherever_they_are_damaged() {
    let store = SlateStore::in_memory().await.unwrap();
    store.put(key("a/b"), value("12")).await.unwrap();
    store.put_blob(value("xyz")).await.unwrap();
    let mut bytes = Vec::new();
    export(&store, &mut bytes, BlobContent::Included).await.unwrap();
    for length in 0..bytes.len() {
        let target = SlateStore::in_memory().await.unwrap();
        let error = import(&target, &mut &bytes[..length]).await.unwrap_err();
        assert!(matches!(error, StoreError::ExportMalformed { .. }), "{length}: {error}");
    }
    for position in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x81;
        let target = SlateStore::in_memory().await.unwrap();
        assert!(import(&target, &mut &damaged[..]).await.is_err(), "byte {position}");
    }
}

//! What an operator does with sessions: check, export, import, back up.

use std::collections::HashSet;
use std::sync::Arc;

use futures::FutureExt;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStoreExt, PutPayload};
use percept_store::archive::{export_sessions, import_sessions};
use percept_store::backup::backup;
use percept_store::check::{Fault, Progress, check};
use percept_store::{BlobId, CatalogueEntry, DataRoot, Key, RootConfig, Store, StoreError};

use crate::{created, key, value};

/// Here a record that begins with `blob` holds a blob's id.
fn read(key: &Key, value: &[u8]) -> Result<Vec<BlobId>, String> {
    if !key.as_str().starts_with("blob") {
        return Ok(Vec::new());
    }
    let id = value.try_into().map_err(|_| "no id of a blob".to_owned())?;
    Ok(vec![BlobId::from_bytes(id)])
}

fn ignore(_: Progress) {}

/// Three sessions: two with records and a blob each, one that was never opened.
async fn filled() -> (Arc<InMemory>, DataRoot) {
    let objects = Arc::new(InMemory::new());
    let root = DataRoot::open(RootConfig::objects(objects.clone())).await.unwrap();
    for id in ["a", "b"] {
        let place = root.create(id, format!("record of {id}").as_bytes()).await.unwrap();
        let store = root.open_session(&place).await.unwrap();
        let blob = store.put_blob(value(&format!("scan of {id}"))).await.unwrap();
        let puts = vec![(key("blob/1"), blob.as_bytes().to_vec().into()), (key("x"), value("1"))];
        store.put_batch(puts, vec![]).await.unwrap();
        store.close().await.unwrap();
    }
    root.create("empty", b"").await.unwrap();
    let gone = root.create("gone", b"").await.unwrap();
    root.bury(&gone).await.unwrap();
    (objects, root)
}

async fn assert_same(one: &DataRoot, other: &DataRoot, ids: &[&str]) {
    for id in ids {
        let ((place, record), (copy, copied)) = (created(one, id).await.unwrap(), created(other, id).await.unwrap());
        assert_eq!(record, copied);
        let (reader, copy) = (one.read_session(&place), other.read_session(&copy));
        assert_eq!(reader.records().await.unwrap(), copy.records().await.unwrap());
        let blobs = reader.blobs().await.unwrap();
        let found: HashSet<_> = copy.blobs().await.unwrap().into_iter().collect();
        assert_eq!(blobs.iter().copied().collect::<HashSet<_>>(), found);
        for (blob, _) in blobs {
            copy.get_blob(blob).await.unwrap();
        }
    }
}

#[tokio::test]
async fn a_check_finds_what_is_damaged_and_where() {
    let (objects, root) = filled().await;
    let mut told = Vec::new();
    let reports = check(&root, &read, &mut |progress| told.push(progress.id)).await.unwrap();
    assert_eq!(told, ["a", "b", "empty"]);
    assert!(reports.iter().all(|report| report.faults.is_empty() && report.num_unnamed == 0), "{reports:?}");
    assert_eq!((reports[0].num_records, reports[0].num_blobs, reports[0].num_bytes), (2, 1, 9));

    let folder = |place: &percept_store::SessionPlace| format!("sessions/{}/{}", place.id(), place.generation());
    let (a, b) = (&reports[0].place, &reports[1].place);
    let (scan_a, scan_b) = (BlobId::of(b"scan of a"), BlobId::of(b"scan of b"));
    objects
        .put(&Path::from(format!("{}/blobs/{scan_a}", folder(a))), PutPayload::from_static(b"scan of A"))
        .await
        .unwrap();
    objects.delete(&Path::from(format!("{}/blobs/{scan_b}", folder(b)))).await.unwrap();
    objects.put(&"catalogue/c/0000000000000000".into(), PutPayload::from_static(b"?")).await.unwrap();
    let place = created(&root, "empty").await.unwrap().0;
    let store = root.open_session(&place).await.unwrap();
    store.put(key("blob/x"), value("?")).await.unwrap();
    store.close().await.unwrap();
    let reports = check(&root, &read, &mut ignore).await.unwrap();
    assert!(matches!(reports[0].faults[..], [Fault::BlobDamaged(id)] if id == scan_a), "{reports:?}");
    assert!(matches!(reports[1].faults[..], [Fault::BlobMissing(id)] if id == scan_b), "{reports:?}");
    assert!(matches!(reports[2].faults[..], [Fault::CatalogueDamaged]), "{reports:?}");
    assert!(matches!(&reports[3].faults[..], [Fault::Record(name, _)] if name.as_str() == "blob/x"), "{reports:?}");
}

#[tokio::test]
async fn sessions_in_use_are_read_without_being_taken() {
    let directory = tempfile::tempdir().unwrap();
    let root = DataRoot::open(RootConfig::directory(directory.path())).await.unwrap();
    let place = root.create("robot", b"").await.unwrap();
    let store = root.open_session(&place).await.unwrap();
    store.put(key("a"), value("1")).await.unwrap();
    let mut config = RootConfig::directory(directory.path());
    config.read_only = true;
    let looker = DataRoot::open(config).await.unwrap();
    for number in 0..5 {
        store.put(key("r").numbered(number).unwrap(), value("x")).await.unwrap();
        let found = looker.read_session(&place).records().await.unwrap();
        assert_eq!(found.len() as u64, number + 2);
        assert!(check(&looker, &read, &mut ignore).await.unwrap()[0].faults.is_empty());
    }
    store.put(key("a"), value("2")).await.unwrap();
    store.close().await.unwrap();
    let nowhere = tempfile::tempdir().unwrap();
    let mut config = RootConfig::directory(nowhere.path());
    config.read_only = true;
    assert!(DataRoot::open(config).await.is_err());
    assert_eq!(std::fs::read_dir(nowhere.path()).unwrap().count(), 0);
}

#[tokio::test]
async fn an_import_holds_the_sessions_that_were_exported() {
    let (_, root) = filled().await;
    let mut all = Vec::new();
    export_sessions(&root, None, &mut all, &read, &mut ignore).await.unwrap();
    let copy = DataRoot::in_memory().await.unwrap();
    let done = import_sessions(&copy, &mut &all[..], &mut ignore).await.unwrap();
    assert_eq!(done, ["a", "b", "empty"]);
    assert_same(&root, &copy, &["a", "b", "empty"]).await;
    let again = import_sessions(&copy, &mut &all[..], &mut ignore).await;
    assert!(matches!(again, Err(StoreError::AlreadyExists { id }) if id == "a"));

    let mut one = Vec::new();
    export_sessions(&root, Some(&["b".to_owned()]), &mut one, &read, &mut ignore).await.unwrap();
    let copy = DataRoot::in_memory().await.unwrap();
    assert_eq!(import_sessions(&copy, &mut &one[..], &mut ignore).await.unwrap(), ["b"]);
    let missing = export_sessions(&root, Some(&["gone".to_owned()]), &mut Vec::new(), &read, &mut ignore).await;
    assert!(matches!(missing, Err(StoreError::NoSession { id }) if id == "gone"));

    // Wherever it is damaged it is refused, and a session that is not whole is not there.
    for position in (0..one.len()).step_by(3) {
        let mut damaged = one.clone();
        damaged[position] ^= 0x81;
        for damaged in [&damaged[..], &one[..position]] {
            let copy = DataRoot::in_memory().await.unwrap();
            import_sessions(&copy, &mut &damaged[..], &mut ignore).await.unwrap_err();
            assert!(copy.list().await.unwrap().is_empty(), "byte {position}");
        }
    }
}

#[tokio::test]
async fn a_backup_copies_what_is_missing_and_no_more() {
    let (_, root) = filled().await;
    let directory = tempfile::tempdir().unwrap();
    let copy = DataRoot::open(RootConfig::directory(directory.path())).await.unwrap();
    let report = backup(&root, &copy, &read, &mut ignore).await.unwrap();
    assert_eq!((report.num_sessions, report.num_records, report.num_blobs), (3, 4, 2));
    assert_same(&root, &copy, &["a", "b", "empty"]).await;
    let report = backup(&root, &copy, &read, &mut ignore).await.unwrap();
    assert_eq!((report.num_sessions, report.num_records, report.num_blobs), (3, 0, 0));

    // One goes on while it is copied, one is replaced, one is deleted.
    let a = created(&root, "a").await.unwrap().0;
    let store = root.open_session(&a).await.unwrap();
    let blob = store.put_blob(value("second scan")).await.unwrap();
    store.put_batch(vec![(key("blob/2"), blob.as_bytes().to_vec().into())], vec![key("x")]).await.unwrap();
    root.set_summary(&a, value("summary")).await.unwrap();
    let b = created(&root, "b").await.unwrap().0;
    root.bury(&b).await.unwrap();
    root.purge(&b).await.unwrap();
    root.create("b", b"another").await.unwrap();
    root.bury(&created(&root, "empty").await.unwrap().0).await.unwrap();
    let report = backup(&root, &copy, &read, &mut ignore).await.unwrap();
    assert_eq!((report.num_sessions, report.num_records, report.num_blobs), (2, 2, 1));
    assert_same(&root, &copy, &["a", "b"]).await;
    assert_eq!(copy.summary(&created(&copy, "a").await.unwrap().0).await.unwrap(), Some(value("summary")));
    assert!(created(&copy, "empty").await.is_some());
    store.put(key("y"), value("still the writer")).await.unwrap();
    let listed = copy.list().await.unwrap();
    assert!(listed.iter().all(|entry| matches!(entry, CatalogueEntry::Created { .. })), "{listed:?}");
}

#[tokio::test]
async fn a_session_that_is_deleted_while_it_is_copied_leaves_nothing_half_in_the_copy() {
    let (objects, root) = filled().await;
    let (place, _) = created(&root, "b").await.unwrap();
    // The catalogue was read before; what the session stored goes under the copier's hands.
    let copy = DataRoot::in_memory().await.unwrap();
    let deleting = async {
        root.bury(&place).await.unwrap();
        root.purge(&place).await.unwrap();
    };
    let mut deleting = Some(deleting);
    let from = DataRoot::open(RootConfig::objects(objects)).await.unwrap();
    let (done, mut turn) = tokio::sync::mpsc::unbounded_channel();
    let mut tell = move |_: Progress| {
        let _ = done.send(());
    };
    let copying = backup(&from, &copy, &read, &mut tell);
    tokio::pin!(copying);
    let report = loop {
        tokio::select! {
            biased;
            // After the first session, before the second is read.
            Some(()) = turn.recv() => if let Some(deleting) = deleting.take() { deleting.await },
            report = &mut copying => break report,
        }
    };
    let report = report.unwrap();
    assert!(report.num_sessions >= 2, "{report:?}");
    let checked = check(&copy, &read, &mut ignore).await.unwrap();
    assert!(checked.iter().all(|report| report.faults.is_empty()), "{checked:?}");
    assert!(created(&copy, "b").await.is_none() || report.num_sessions == 3);
}

#[tokio::test]
async fn a_damaged_session_keeps_no_other_from_being_copied() {
    let (objects, root) = filled().await;
    let copy = DataRoot::in_memory().await.unwrap();
    backup(&root, &copy, &read, &mut ignore).await.unwrap();
    let damage = async |path: String| objects.put(&Path::from(path), PutPayload::from_static(b"?")).await.unwrap();
    let a = created(&root, "a").await.unwrap().0;
    // What the copy has already stays whole there; what is new and damaged is told.
    damage(format!("sessions/a/{}/blobs/{}", a.generation(), BlobId::of(b"scan of a"))).await;
    let store = root.open_session(&a).await.unwrap();
    let blob = store.put_blob(value("new scan")).await.unwrap();
    store.put(key("blob/2"), blob.as_bytes().to_vec().into()).await.unwrap();
    store.close().await.unwrap();
    objects.delete(&Path::from(format!("sessions/a/{}/blobs/{blob}", a.generation()))).await.unwrap();
    let b = created(&root, "b").await.unwrap().0;
    let store = root.open_session(&b).await.unwrap();
    store.put(key("y"), value("2")).await.unwrap();
    store.close().await.unwrap();
    damage("catalogue/empty/0000000000000000".to_owned()).await;

    let report = backup(&root, &copy, &read, &mut ignore).await.unwrap();
    assert_eq!(report.num_sessions, 1);
    let damaged: Vec<_> = report.damaged.iter().map(|(id, _)| id.as_str()).collect();
    assert_eq!(damaged, ["empty", "a"]);
    let faults = &report.damaged[1].1;
    assert!(faults.iter().any(|fault| matches!(fault, Fault::BlobMissing(id) if *id == blob)), "{faults:?}");
    let old = created(&copy, "a").await.unwrap().0;
    let old = copy.read_session(&old).get_blob(BlobId::of(b"scan of a")).await.unwrap();
    assert_eq!(old, value("scan of a"));
    let b = created(&copy, "b").await.unwrap().0;
    let records = copy.read_session(&b).records().await.unwrap();
    assert!(records.contains(&(key("y"), value("2"))), "{records:?}");
    // An export of all does not leave the damaged ones out silently.
    let refused = export_sessions(&root, None, &mut Vec::new(), &read, &mut ignore).await;
    assert!(matches!(refused, Err(StoreError::InSession { id, .. }) if id == "empty"));
    export_sessions(&root, Some(&["b".to_owned()]), &mut Vec::new(), &read, &mut ignore).await.unwrap();
}

#[tokio::test]
async fn a_session_that_gives_up_scans_while_it_is_copied_is_read_anew() {
    let (objects, root) = filled().await;
    let a = created(&root, "a").await.unwrap().0;
    let scan = value("scan of a");
    let path = Path::from(format!("sessions/a/{}/blobs/{}", a.generation(), BlobId::of(&scan)));
    for is_export in [false, true] {
        let calls = std::sync::atomic::AtomicUsize::new(0);
        // Between the records and the scans that they name the scan goes; when the records are read anew it is there.
        let read_and_meddle = |key: &Key, value: &[u8]| {
            if value == BlobId::of(&scan).as_bytes() {
                let is_first = calls.fetch_add(1, std::sync::atomic::Ordering::Relaxed) == 0;
                if is_first {
                    objects.delete(&path).now_or_never().unwrap().unwrap();
                } else {
                    objects.put(&path, scan.clone().into()).now_or_never().unwrap().unwrap();
                }
            }
            read(key, value)
        };
        let copy = DataRoot::in_memory().await.unwrap();
        if is_export {
            let mut bytes = Vec::new();
            export_sessions(&root, None, &mut bytes, &read_and_meddle, &mut ignore).await.unwrap();
            import_sessions(&copy, &mut &bytes[..], &mut ignore).await.unwrap();
        } else {
            let report = backup(&root, &copy, &read_and_meddle, &mut ignore).await.unwrap();
            assert!(report.damaged.is_empty(), "{report:?}");
        }
        assert!(calls.into_inner() >= 2);
        assert_same(&root, &copy, &["a", "b", "empty"]).await;
    }
}

//! Sessions that come and go, and come again under the same id.

use std::sync::Arc;

use futures::future::join_all;
use object_store::memory::InMemory;
use object_store::{ObjectStoreExt, PutPayload};
use percept_store::{CatalogueEntry, DataRoot, Prefix, RootConfig, Store, StoreError};

use crate::faulty::{Faulty, Plan};
use crate::{created, key, value};

/// On disk and in memory.
fn both() -> (tempfile::TempDir, [RootConfig; 2]) {
    let directory = tempfile::tempdir().unwrap();
    let configs = [RootConfig::directory(directory.path()), RootConfig::in_memory()];
    (directory, configs)
}

#[tokio::test]
async fn a_session_is_there_until_it_is_buried_and_leaves_nothing_behind() {
    let (directory, configs) = both();
    for config in configs {
        let root = DataRoot::open(config.clone()).await.unwrap();
        assert!(root.list().await.unwrap().is_empty());
        let place = root.create("robot", b"record").await.unwrap();
        let again = root.create("robot", b"other").await;
        assert!(matches!(again, Err(StoreError::AlreadyExists { id }) if id == "robot"));
        let store = root.open_session(&place).await.unwrap();
        store.put(key("a"), value("1")).await.unwrap();
        store.put_blob(value("blob")).await.unwrap();
        store.close().await.unwrap();
        root.set_summary(&place, value("first")).await.unwrap();
        root.set_summary(&place, value("second")).await.unwrap();
        assert_eq!(root.summary(&place).await.unwrap(), Some(value("second")));
        assert!(root.stored_bytes(&place).await.unwrap() > 10);
        drop(root);

        let root = DataRoot::open(config.clone()).await.unwrap();
        assert_eq!(created(&root, "robot").await, Some((place.clone(), value("record"))));
        root.bury(&place).await.unwrap();
        root.bury(&place).await.unwrap();
        drop(root);

        let root = DataRoot::open(config).await.unwrap();
        assert_eq!(root.list().await.unwrap(), [CatalogueEntry::Deleted { place: place.clone() }]);
        root.purge(&place).await.unwrap();
        root.purge(&place).await.unwrap();
        assert!(root.list().await.unwrap().is_empty());
        assert_eq!(root.stored_bytes(&place).await.unwrap(), 0);
    }
    for folder in ["sessions/robot", "catalogue/robot"] {
        assert!(!directory.path().join(folder).exists(), "{folder}");
    }
}

#[tokio::test]
async fn an_id_that_is_used_again_never_meets_its_past() {
    let (_directory, configs) = both();
    for config in configs {
        let root = DataRoot::open(config).await.unwrap();
        let mut past = Vec::new();
        for round in 0..4 {
            let place = root.create("robot", &[round]).await.unwrap();
            assert!(!past.contains(&place.generation().to_owned()));
            let store = root.open_session(&place).await.unwrap();
            assert!(store.scan_all(&Prefix::everything()).await.unwrap().is_empty());
            assert_eq!(root.summary(&place).await.unwrap(), None);
            store.put(key("a"), value("1")).await.unwrap();
            store.close().await.unwrap();
            root.set_summary(&place, value("x")).await.unwrap();
            root.bury(&place).await.unwrap();
            past.push(place.generation().to_owned());
            if round == 1 {
                root.purge(&place).await.unwrap();
            }
        }
        let place = root.create("robot", b"last").await.unwrap();
        assert_eq!(created(&root, "robot").await.unwrap(), (place, value("last")));
    }
}

#[tokio::test]
async fn purging_an_earlier_session_spares_the_present_one() {
    let (_directory, configs) = both();
    for config in configs {
        let root = DataRoot::open(config.clone()).await.unwrap();
        let old = root.create("robot", b"old").await.unwrap();
        root.bury(&old).await.unwrap();
        let new = root.create("robot", b"new").await.unwrap();
        let store = root.open_session(&new).await.unwrap();
        store.put(key("a"), value("1")).await.unwrap();
        store.close().await.unwrap();
        root.bury(&old).await.unwrap();
        root.purge(&old).await.unwrap();
        drop(root);
        let root = DataRoot::open(config).await.unwrap();
        assert_eq!(created(&root, "robot").await.unwrap(), (new.clone(), value("new")));
        let store = root.open_session(&new).await.unwrap();
        assert_eq!(store.get(&key("a")).await.unwrap(), Some(value("1")));
    }
}

#[tokio::test]
async fn burying_and_purging_once_more_spares_the_session_that_came_after() {
    let (_directory, configs) = both();
    for config in configs {
        let root = DataRoot::open(config).await.unwrap();
        let old = root.create("robot", b"old").await.unwrap();
        root.bury(&old).await.unwrap();
        root.purge(&old).await.unwrap();
        let new = root.create("robot", b"new").await.unwrap();
        root.bury(&old).await.unwrap();
        root.purge(&old).await.unwrap();
        assert_eq!(created(&root, "robot").await.unwrap(), (new, value("new")));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn of_sixteen_that_create_one_id_one_wins() {
    let (_directory, configs) = both();
    for mut config in configs {
        // As if they were processes of their own.
        config.lock_directory = false;
        let opened = join_all((0..16).map(|_| DataRoot::open(config.clone()))).await;
        let roots: Vec<_> = opened.into_iter().map(|root| Arc::new(root.unwrap())).collect();
        for round in 0..20 {
            let id = format!("robot-{round}");
            let racers = roots.iter().enumerate().map(|(number, root)| {
                let (root, id) = (root.clone(), id.clone());
                tokio::spawn(async move { root.create(&id, &[number as u8]).await })
            });
            let outcomes: Vec<_> = join_all(racers).await.into_iter().map(|outcome| outcome.unwrap()).collect();
            let winners: Vec<_> = (0..16).filter(|number| outcomes[*number].is_ok()).collect();
            assert_eq!(winners.len(), 1, "{id}");
            for outcome in outcomes.iter().filter_map(|outcome| outcome.as_ref().err()) {
                assert!(matches!(outcome, StoreError::AlreadyExists { .. }), "{outcome:?}");
            }
            let (place, record) = created(&roots[0], &id).await.unwrap();
            assert_eq!(record[..], [winners[0] as u8]);
            assert_eq!(place, *outcomes[winners[0]].as_ref().unwrap());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn creating_listing_and_purging_at_once_do_not_disturb_each_other() {
    let (_directory, configs) = both();
    for config in configs {
        let root = Arc::new(DataRoot::open(config).await.unwrap());
        root.create("stays", b"").await.unwrap();
        let churn = (0..4).map(|_| {
            let root = root.clone();
            tokio::spawn(async move {
                let mut num_made = 0;
                for _ in 0..30 {
                    if let Ok(place) = root.create("comes-and-goes", b"x").await {
                        assert_eq!(created(&root, "comes-and-goes").await.unwrap().0, place);
                        root.bury(&place).await.unwrap();
                        root.purge(&place).await.unwrap();
                        num_made += 1;
                    }
                }
                num_made
            })
        });
        let churn = tokio::spawn(join_all(churn.collect::<Vec<_>>()));
        while !churn.is_finished() {
            assert!(created(&root, "stays").await.is_some());
        }
        let made: u32 = churn.await.unwrap().into_iter().map(|made| made.unwrap()).sum();
        assert!(made > 0);
        assert_eq!(root.list().await.unwrap().len(), 1);
    }
}

/// One server purges what it has buried while another creates a session of that id: it is neither refused nor lost.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_can_be_created_while_its_predecessor_is_purged_elsewhere() {
    let directory = tempfile::tempdir().unwrap();
    let config = RootConfig { shared: true, ..RootConfig::directory(directory.path()) };
    let [ours, theirs] = [DataRoot::open(config.clone()).await.unwrap(), DataRoot::open(config).await.unwrap()];
    let theirs = Arc::new(theirs);
    let mut place = theirs.create("robot", b"first").await.unwrap();
    for round in 0..200u32 {
        theirs.bury(&place).await.unwrap();
        let purge = tokio::spawn({
            let (theirs, place) = (theirs.clone(), place.clone());
            async move { theirs.purge(&place).await }
        });
        let made = ours.create("robot", b"again").await.unwrap_or_else(|error| panic!("{round}: {error}"));
        purge.await.unwrap().unwrap();
        assert_eq!(created(&ours, "robot").await, Some((made.clone(), value("again"))), "{round}");
        ours.bury(&made).await.unwrap();
        ours.purge(&made).await.unwrap();
        place = theirs.create("robot", b"first").await.unwrap();
    }
}

#[tokio::test]
async fn a_damaged_entry_is_listed_as_damaged_and_harms_no_other() {
    let objects = Arc::new(InMemory::new());
    let root = DataRoot::open(RootConfig::objects(objects.clone())).await.unwrap();
    let good = root.create("good", b"g").await.unwrap();
    for damaged in
        [&b""[..], b"percept-sess", b"percept-session created \nx", b"percept-session created ../x\n", &[0; 64]]
    {
        let path = "catalogue/bad/0000000000000000".into();
        objects.put(&path, PutPayload::from(damaged.to_vec())).await.unwrap();
        let listed = root.list().await.unwrap();
        assert!(matches!(&listed[0], CatalogueEntry::Damaged { place } if place.id() == "bad"), "{listed:?}");
        assert!(matches!(&listed[1], CatalogueEntry::Created { place, .. } if *place == good));
        assert!(matches!(root.create("bad", b"").await, Err(StoreError::AlreadyExists { .. })));
        root.open_session(&good).await.unwrap().close().await.unwrap();
    }
    // Names that are none of the catalogue's.
    for foreign in ["catalogue/x", "catalogue/y/z", "catalogue/good/backup", "catalogue/a/b/c"] {
        objects.put(&foreign.into(), PutPayload::from_static(b"?")).await.unwrap();
    }
    assert_eq!(root.list().await.unwrap().len(), 2);
    let CatalogueEntry::Damaged { place } = root.list().await.unwrap().remove(0) else { unreachable!() };
    root.bury(&place).await.unwrap();
    root.purge(&place).await.unwrap();
    assert_eq!(root.list().await.unwrap().len(), 1);
    root.create("bad", b"whole again").await.unwrap();
}

#[tokio::test]
async fn ids_that_cannot_be_part_of_a_path_are_refused() {
    let root = DataRoot::in_memory().await.unwrap();
    for bad in ["", ".", "..", "a/b", "a b", "ä", "a\0", &"a".repeat(257)] {
        assert!(matches!(root.create(bad, b"").await, Err(StoreError::InvalidKey { .. })), "{bad:?}");
    }
    root.create(&"a".repeat(256), b"").await.unwrap();
}

#[tokio::test]
async fn a_purge_that_broke_off_anywhere_can_be_done_again() {
    let objects = Faulty::new();
    let root = DataRoot::open(RootConfig::objects(Arc::new(objects.clone()))).await.unwrap();
    root.create("stays", b"").await.unwrap();
    let place = root.create("goes", b"").await.unwrap();
    let store = root.open_session(&place).await.unwrap();
    store.put(key("a"), value("1")).await.unwrap();
    store.put_blob(value("blob")).await.unwrap();
    store.close().await.unwrap();
    root.bury(&place).await.unwrap();
    let before = objects.inner();
    for write in 0.. {
        for applied in [false, true] {
            let broken = Faulty::over(Arc::new(before.fork()));
            let config = RootConfig::objects(Arc::new(broken.clone()));
            let root = DataRoot::open(config.clone()).await.unwrap();
            broken.set(Plan::CutAt { write: broken.num_writes() + write, applied });
            tokio::select! {
                done = root.purge(&place) => {
                    done.unwrap();
                    assert!(write > 4, "too few to prove anything");
                    return;
                }
                () = broken.cut() => {}
            }
            broken.set(Plan::Well);
            let root = DataRoot::open(config).await.unwrap();
            assert!(created(&root, "goes").await.is_none(), "write {write}");
            root.purge(&place).await.unwrap();
            assert_eq!(root.list().await.unwrap().len(), 1, "write {write}");
            assert_eq!(root.stored_bytes(&place).await.unwrap(), 0);
            let again = root.create("goes", b"").await.unwrap();
            assert_ne!(again.generation(), place.generation());
        }
    }
}

//! Several nodes on one store: each session is one node's, and another's soon after that one is silent.
//!
//! Time is the test's own: it passes when everybody waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures::future::join_all;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};
use percept_store::{Claim, Clock, DataRoot, RootConfig, SessionPlace, SlateStore, Store, StoreError};
use tokio::time::Instant;

use crate::faulty::{Faulty, Plan};
use crate::{created, key, value};

/// A node with objects and a clock of its own, so that it can be cut off and stopped.
struct Node {
    objects: Faulty,
    stopped_ms: Arc<AtomicU64>,
    root: DataRoot,
}

impl Node {
    async fn start(shared: &Arc<InMemory>, address: &str) -> Self {
        let objects = Faulty::over(shared.clone());
        let mut config = RootConfig::objects(Arc::new(objects.clone()));
        let (start, stopped_ms) = (Instant::now(), Arc::new(AtomicU64::new(0)));
        let stopped = stopped_ms.clone();
        config.shared = true;
        config.address = address.to_owned();
        config.clock = Clock::new(move || start.elapsed() + Duration::from_millis(stopped.load(Ordering::SeqCst)));
        Self { objects, stopped_ms, root: DataRoot::open(config).await.unwrap() }
    }

    /// As if the process had been stopped for a minute.
    fn was_stopped(&self) {
        self.stopped_ms.fetch_add(60_000, Ordering::SeqCst);
    }

    async fn place(&self, id: &str) -> SessionPlace {
        created(&self.root, id).await.unwrap().0
    }

    async fn take(&self, id: &str) -> SlateStore {
        let place = self.place(id).await;
        assert_eq!(self.root.claim(&place).await.unwrap(), Claim::Ours);
        self.root.open_session(&place).await.unwrap()
    }

    /// Asks until the session is this node's; the time it took.
    async fn take_over(&self, place: &SessionPlace, from: &str) -> Duration {
        let start = Instant::now();
        loop {
            match self.root.claim(place).await.unwrap() {
                Claim::Ours => return start.elapsed(),
                Claim::Elsewhere { address } => assert_eq!(address, from),
                Claim::Gone => panic!("gone"),
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
            assert!(start.elapsed() < Duration::from_secs(60), "never");
        }
    }
}

async fn two() -> (Arc<InMemory>, Node, Node) {
    let shared = Arc::new(InMemory::new());
    let (a, b) = (Node::start(&shared, "a:1").await, Node::start(&shared, "b:1").await);
    (shared, a, b)
}

#[tokio::test(start_paused = true)]
async fn of_nodes_that_claim_a_session_at_once_one_gets_it() {
    let shared = Arc::new(InMemory::new());
    let nodes =
        join_all((0..8).map(|number| Node::start(&shared, ["a", "b", "c", "d", "e", "f", "g", "h"][number]))).await;
    for round in 0..20 {
        let place = nodes[0].root.create(&format!("robot-{round}"), b"").await.unwrap();
        for _ in 0..2 {
            let claims = join_all(nodes.iter().map(|node| node.root.claim(&place))).await;
            let claims: Vec<_> = claims.into_iter().map(Result::unwrap).collect();
            let won: Vec<_> = (0..8).filter(|number| claims[*number] == Claim::Ours).collect();
            assert_eq!(won.len(), 1, "{claims:?}");
            let address = ["a", "b", "c", "d", "e", "f", "g", "h"][won[0]].to_owned();
            let elsewhere = Claim::Elsewhere { address };
            assert_eq!(claims.iter().filter(|claim| **claim == elsewhere).count(), 7, "{claims:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_killed_nodes_session_is_anothers_within_ten_seconds_with_all_that_was_acknowledged() {
    let (_, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    let store = a.take("robot").await;
    for number in 0..50 {
        store.put(key("r").numbered(number).unwrap(), value("x")).await.unwrap();
    }
    // As long as it lives it keeps it, however long that is.
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!(b.root.claim(&place).await.unwrap(), Claim::Elsewhere { address: "a:1".to_owned() });
    std::mem::forget(store);
    drop(a);
    let took = b.take_over(&place, "a:1").await;
    assert!(took < Duration::from_secs(10), "{took:?}");
    let store = b.root.open_session(&place).await.unwrap();
    assert_eq!(store.scan_all(&key("r").prefix()).await.unwrap().len(), 50);
    store.put(key("after"), value("x")).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_session_given_back_and_one_of_a_node_that_left_can_be_taken_at_once() {
    let (shared, a, b) = two().await;
    let first = a.root.create("first", b"").await.unwrap();
    let second = a.root.create("second", b"").await.unwrap();
    let (one, two) = (a.take("first").await, a.take("second").await);
    assert!(matches!(b.root.claim(&first).await.unwrap(), Claim::Elsewhere { .. }));
    one.close().await.unwrap();
    a.root.release(&first).await.unwrap();
    b.take("first").await;
    // Given back once more by the one that has it no longer: nothing happens.
    a.root.release(&first).await.unwrap();
    assert_eq!(a.root.claim(&first).await.unwrap(), Claim::Elsewhere { address: "b:1".to_owned() });
    two.close().await.unwrap();
    a.root.leave().await.unwrap();
    assert!(matches!(a.root.claim(&second).await, Err(StoreError::NodeSilent)));
    // What B had not heard of A yet it reads; what it had, it reads with its next look.
    assert!(b.take_over(&second, "a:1").await <= Duration::from_secs(2));
    for _ in 0..20 {
        b.root.release(&second).await.unwrap();
        assert_eq!(b.root.claim(&second).await.unwrap(), Claim::Ours);
    }
    let folder = format!("sessions/second/{}/lease", second.generation());
    let leases = shared.list_with_delimiter(Some(&folder.as_str().into())).await.unwrap();
    assert_eq!(leases.objects.len(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_stopped_node_that_goes_on_confirms_nothing_and_is_told() {
    let (_, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    let old = a.take("robot").await;
    old.put(key("a"), value("1")).await.unwrap();
    let mut watch = a.root.watch_node().unwrap();
    let life = watch.borrow_and_update().life;
    a.was_stopped();
    // Before any task of its own has noticed.
    assert!(matches!(old.put(key("a"), value("2")).await, Err(StoreError::Fenced { .. })));
    assert!(!a.root.is_alive());
    assert!(matches!(a.root.claim(&place).await, Err(StoreError::NodeSilent)));
    assert!(matches!(a.root.set_summary(&place, value("stale")).await, Err(StoreError::NodeSilent)));
    let told = watch.wait_for(|state| state.life > life && state.is_alive).await.map(|state| *state).unwrap();
    assert_eq!(told.life, life + 1);
    assert!(a.root.is_alive());
    assert!(matches!(old.put(key("a"), value("3")).await, Err(StoreError::Fenced { .. })));
    // Its former life is dead, whoever asks; nobody else had taken the session.
    assert!(b.take_over(&place, "a:1").await <= Duration::from_secs(2));
    let new = b.root.open_session(&place).await.unwrap();
    assert_eq!(new.get(&key("a")).await.unwrap(), Some(value("1")));
    assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Elsewhere { address: "b:1".to_owned() });
}

#[tokio::test(start_paused = true)]
async fn a_node_cut_off_from_the_store_loses_its_sessions_and_comes_back() {
    let (_, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    let old = a.take("robot").await;
    old.put(key("a"), value("1")).await.unwrap();
    a.objects.set(Plan::Hanging);
    let took = b.take_over(&place, "a:1").await;
    assert!(took < Duration::from_secs(10), "{took:?}");
    assert!(!a.root.is_alive(), "both would own it");
    let new = b.root.open_session(&place).await.unwrap();
    assert_eq!(new.get(&key("a")).await.unwrap(), Some(value("1")));
    new.put(key("a"), value("2")).await.unwrap();
    a.objects.set(Plan::Well);
    assert!(matches!(old.put(key("a"), value("3")).await, Err(StoreError::Fenced { .. })));
    let _ = old.close().await;
    let mut watch = a.root.watch_node().unwrap();
    watch.wait_for(|state| state.is_alive).await.unwrap();
    assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Elsewhere { address: "b:1".to_owned() });
    new.put(key("b"), value("2")).await.unwrap();
    new.close().await.unwrap();
    b.root.release(&place).await.unwrap();
    let again = a.take("robot").await;
    assert_eq!(again.get(&key("a")).await.unwrap(), Some(value("2")));
    assert_eq!(again.get(&key("b")).await.unwrap(), Some(value("2")));
}

#[tokio::test(start_paused = true)]
async fn a_node_that_fails_a_few_beats_keeps_its_sessions() {
    let (_, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    let store = a.take("robot").await;
    for _ in 0..20 {
        a.objects.set(Plan::Broken);
        tokio::time::sleep(Duration::from_millis(2500)).await;
        a.objects.set(Plan::Well);
        tokio::time::sleep(Duration::from_millis(2500)).await;
        assert!(matches!(b.root.claim(&place).await.unwrap(), Claim::Elsewhere { .. }));
    }
    store.put(key("a"), value("1")).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn only_the_owner_deletes_a_session() {
    let (shared, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    let store = a.take("robot").await;
    let error = b.root.bury(&place).await.unwrap_err();
    assert!(matches!(&error, StoreError::Elsewhere { address } if address == "a:1"), "{error}");
    assert!(created(&b.root, "robot").await.is_some());
    store.close().await.unwrap();
    a.root.bury(&place).await.unwrap();
    a.root.bury(&place).await.unwrap();
    assert_eq!(b.root.claim(&place).await.unwrap(), Claim::Gone);
    a.root.purge(&place).await.unwrap();
    assert_eq!(b.root.claim(&place).await.unwrap(), Claim::Gone);
    assert!(b.root.list().await.unwrap().is_empty());
    let folder = format!("sessions/robot/{}", place.generation());
    assert!(shared.list_with_delimiter(Some(&folder.as_str().into())).await.unwrap().objects.is_empty());
    // The id again, at the other node; the one before is not buried any more.
    let again = b.root.create("robot", b"again").await.unwrap();
    a.root.bury(&place).await.unwrap();
    a.root.purge(&place).await.unwrap();
    assert_eq!(created(&a.root, "robot").await.unwrap(), (again, value("again")));
}

#[tokio::test(start_paused = true)]
async fn a_deletion_that_broke_off_is_finished_by_whoever_asks_for_the_session() {
    for write in 0..4 {
        let (_, a, b) = two().await;
        let place = a.root.create("robot", b"").await.unwrap();
        assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Ours);
        a.objects.set(Plan::CutAt { write: a.objects.num_writes() + write, applied: true });
        tokio::select! {
            outcome = a.root.bury(&place) => outcome.unwrap(),
            () = a.objects.cut() => {}
        }
        drop(a);
        let start = Instant::now();
        let gone = loop {
            match b.root.claim(&place).await.unwrap() {
                Claim::Elsewhere { .. } => tokio::time::sleep(Duration::from_millis(100)).await,
                claim => break claim == Claim::Gone,
            }
            assert!(start.elapsed() < Duration::from_secs(60), "never");
        };
        assert_eq!(gone, created(&b.root, "robot").await.is_none());
        if gone {
            b.root.purge(&place).await.unwrap();
            b.root.create("robot", b"").await.unwrap();
        }
    }
}

/// A claimant that read the leases long ago creates a number that was taken, left and removed meanwhile.
#[tokio::test(start_paused = true)]
async fn a_claim_that_comes_late_is_withdrawn() {
    let (shared, a, b) = two().await;
    let place = a.root.create("robot", b"").await.unwrap();
    for _ in 0..3 {
        assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Ours);
        a.root.release(&place).await.unwrap();
    }
    assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Ours);
    let late = format!("sessions/robot/{}/lease/0000000000000002", place.generation());
    let options = PutOptions::from(PutMode::Create);
    shared.put_opts(&late.as_str().into(), PutPayload::from_static(b"percept-lease held b\n"), options).await.unwrap();
    assert_eq!(a.root.claim(&place).await.unwrap(), Claim::Ours);
    assert_eq!(b.root.claim(&place).await.unwrap(), Claim::Elsewhere { address: "a:1".to_owned() });
    shared.delete(&late.as_str().into()).await.unwrap();
}

#[tokio::test]
async fn data_that_are_not_shared_are_always_ours() {
    let objects = Faulty::new();
    let root = DataRoot::open(RootConfig::objects(Arc::new(objects.clone()))).await.unwrap();
    let place = root.create("robot", b"").await.unwrap();
    let before = objects.num_writes();
    assert_eq!(root.claim(&place).await.unwrap(), Claim::Ours);
    root.release(&place).await.unwrap();
    root.leave().await.unwrap();
    assert!(root.is_alive() && root.watch_node().is_none());
    assert_eq!(objects.num_writes(), before);
}

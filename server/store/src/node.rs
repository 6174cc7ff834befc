//! Who lives: the heartbeat of this node, and what it sees of the others'.
//!
//! A node overwrites `nodes/<id>` every second. Nobody compares clocks of different machines: a node holds itself for
//! dead once [`SURE_FOR`] went by without a confirmed beat, counted from before that beat was written; the others hold
//! it for dead after its object stood still for [`DEAD_AFTER`] before their eyes. So whoever takes over comes later
//! than whoever stopped, and what a dead node held is lost to it for good: it goes on under another id, as a new
//! [`Life`].

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures::TryStreamExt;
use object_store::path::Path;
use object_store::{Error, ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload};
use tokio::sync::watch;

use crate::clock::Clock;
use crate::error::StoreError;

/// Folder of the heartbeats.
const FOLDER: &str = "nodes";
/// First words of a heartbeat; the count of beats follows, then a line with the node's address.
const TITLE: &str = "percept-node ";
/// From one beat to the next.
const BEAT: Duration = Duration::from_secs(1);
/// From a beat that failed to the next.
const BEAT_AGAIN: Duration = Duration::from_millis(250);
/// How long one request of a beat may take.
const REQUEST: Duration = Duration::from_secs(2);
/// How long a confirmed beat makes a node sure of itself.
const SURE_FOR: Duration = Duration::from_secs(4);
/// How long a heartbeat stands still until its node is dead.
const DEAD_AFTER: Duration = Duration::from_secs(6);
/// When a dead node's heartbeat is removed.
const REMOVED_AFTER: Duration = Duration::from_secs(600);

/// Whether this node may hold sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NodeState {
    /// Counts the lives of the node. Whatever was claimed in an earlier one may be another node's now.
    pub life: u64,
    /// False from the loss of one life until the first beat of the next.
    pub is_alive: bool,
}

/// From a node's first beat until it may be dead in the eyes of the others.
#[derive(Debug)]
pub(crate) struct Life {
    /// The node's id, random and of this life alone.
    pub(crate) node: String,
    clock: Clock,
    sure_until_ns: AtomicU64,
    is_over: AtomicBool,
}

impl Life {
    fn new(clock: Clock) -> Arc<Self> {
        let node = random_name();
        Arc::new(Self { node, clock, sure_until_ns: AtomicU64::new(0), is_over: AtomicBool::new(false) })
    }

    /// Whether nobody can have taken over what was claimed in this life. Once it is false it stays so.
    pub(crate) fn is_alive(&self) -> bool {
        if self.is_over.load(Ordering::Acquire) {
            return false;
        }
        let is_sure = nanoseconds(self.clock.now()) < self.sure_until_ns.load(Ordering::Acquire);
        if !is_sure {
            self.is_over.store(true, Ordering::Release);
        }
        is_sure
    }

    /// A beat that was begun then is written. One that was begun too late proves nothing.
    fn confirm(&self, begun: Duration) {
        let longer =
            |until| (until == 0 || nanoseconds(begun) < until).then(|| until.max(nanoseconds(begun + SURE_FOR)));
        if self.sure_until_ns.fetch_update(Ordering::AcqRel, Ordering::Acquire, longer).is_err() {
            self.is_over.store(true, Ordering::Release);
        }
    }
}

/// Another node's heartbeat as it was seen.
#[derive(Debug, Clone)]
struct Seen {
    mark: String,
    address: String,
    /// When this mark was first seen: after that look.
    first: Duration,
    /// When it was last seen: before that look.
    last: Duration,
}

impl Seen {
    fn silent_for(&self) -> Duration {
        self.last.saturating_sub(self.first)
    }
}

/// This node among the others.
#[derive(Debug)]
pub(crate) struct Node {
    objects: Arc<dyn ObjectStore>,
    address: String,
    clock: Clock,
    life: Mutex<Arc<Life>>,
    past: Mutex<HashSet<String>>,
    others: Mutex<HashMap<String, Seen>>,
    num_beats: AtomicU64,
    state: watch::Sender<NodeState>,
}

impl Node {
    /// Gives the first beat.
    pub(crate) async fn start(
        objects: Arc<dyn ObjectStore>,
        address: String,
        clock: Clock,
    ) -> Result<Arc<Self>, StoreError> {
        let node = Arc::new(Self {
            objects,
            address,
            life: Mutex::new(Life::new(clock.clone())),
            clock,
            past: Mutex::default(),
            others: Mutex::default(),
            num_beats: AtomicU64::new(0),
            state: watch::channel(NodeState { life: 0, is_alive: true }).0,
        });
        node.beat(&node.life()).await?;
        Ok(node)
    }

    /// Beats and looks at the others until it is dropped.
    pub(crate) async fn run(self: Arc<Self>) {
        let mut pause = BEAT;
        loop {
            tokio::time::sleep(pause).await;
            let life = self.life();
            if !life.is_alive() {
                self.begin_again(&life).await;
                pause = BEAT;
                continue;
            }
            let (beat, seen) = tokio::join!(self.beat(&life), self.look());
            pause = if beat.is_ok() { BEAT } else { BEAT_AGAIN };
            for error in beat.err().into_iter().chain(seen.err()) {
                tracing::warn!(%error, "the heartbeat of this node, or a look at the others', failed");
            }
        }
    }

    pub(crate) fn life(&self) -> Arc<Life> {
        locked(&self.life).clone()
    }

    pub(crate) fn watch(&self) -> watch::Receiver<NodeState> {
        self.state.subscribe()
    }

    /// Says to the others that this node is gone, so that they need not wait.
    pub(crate) async fn stop(&self) -> Result<(), StoreError> {
        let life = self.life();
        life.is_over.store(true, Ordering::Release);
        self.state.send_modify(|state| state.is_alive = false);
        self.remove(&life.node).await
    }

    /// The address of a node that may be alive; `None` if it is dead for certain.
    pub(crate) async fn address_of(&self, node: &str) -> Result<Option<String>, StoreError> {
        if locked(&self.past).contains(node) {
            return Ok(None);
        }
        if let Some(seen) = locked(&self.others).get(node) {
            return Ok((seen.silent_for() < DEAD_AFTER).then(|| seen.address.clone()));
        }
        let begun = self.clock.now();
        let Some((mark, address)) = self.read(node).await? else { return Ok(None) };
        let seen = Seen { mark, address: address.clone(), first: self.clock.now(), last: begun };
        locked(&self.others).entry(node.to_owned()).or_insert(seen);
        Ok(Some(address))
    }

    /// The life that is over ends for everyone, and another begins.
    async fn begin_again(&self, old: &Life) {
        locked(&self.past).insert(old.node.clone());
        if self.state.borrow().is_alive {
            tracing::error!("this node was silent for too long: its sessions may be another node's now");
        }
        self.state.send_modify(|state| state.is_alive = false);
        let new = Life::new(self.clock.clone());
        if let Err(error) = self.beat(&new).await {
            tracing::warn!(%error, "no heartbeat yet");
            return;
        }
        *locked(&self.life) = new;
        self.state.send_modify(|state| *state = NodeState { life: state.life + 1, is_alive: true });
        if let Err(error) = self.remove(&old.node).await {
            tracing::debug!(%error, "an old heartbeat stays until others remove it");
        }
    }

    async fn beat(&self, life: &Life) -> Result<(), StoreError> {
        let begun = self.clock.now();
        let count = self.num_beats.fetch_add(1, Ordering::Relaxed);
        let beat = PutPayload::from(format!("{TITLE}{count}\n{}\n", self.address));
        let path = path(&life.node);
        let written = in_time(self.objects.put(&path, beat)).await?;
        written.map_err(|error| StoreError::from_object("write the heartbeat", error))?;
        life.confirm(begun);
        Ok(())
    }

    /// Looks at all heartbeats.
    async fn look(&self) -> Result<(), StoreError> {
        let begun = self.clock.now();
        let folder = Path::from(FOLDER);
        let listed = self.objects.list(Some(&folder)).try_collect::<Vec<ObjectMeta>>();
        let listed = in_time(listed).await?.map_err(|error| StoreError::from_object("list heartbeats", error))?;
        let own = self.life().node.clone();
        let mut known = locked(&self.others).clone();
        let mut dead = Vec::new();
        let mut seen = HashMap::with_capacity(listed.len());
        for meta in listed {
            let Some(node) = meta.location.filename().filter(|node| *node != own).map(str::to_owned) else { continue };
            let mark = mark(&meta);
            let found = match known.remove(&node) {
                Some(before) if before.mark == mark => Seen { last: before.last.max(begun), ..before },
                Some(before) => Seen { mark, first: self.clock.now(), last: begun, ..before },
                None => match self.read(&node).await {
                    Ok(Some((mark, address))) => Seen { mark, address, first: self.clock.now(), last: begun },
                    _ => continue,
                },
            };
            if found.silent_for() > REMOVED_AFTER {
                dead.push(node);
            } else {
                seen.insert(node, found);
            }
        }
        *locked(&self.others) = seen;
        for node in dead {
            self.remove(&node).await?;
        }
        Ok(())
    }

    async fn read(&self, node: &str) -> Result<Option<(String, String)>, StoreError> {
        let io = |error| StoreError::from_object("read a heartbeat", error);
        let read = async {
            let found = self.objects.get(&path(node)).await?;
            let mark = mark(&found.meta);
            Ok((mark, found.bytes().await?))
        };
        match in_time(read).await? {
            Ok((mark, bytes)) => {
                let text = String::from_utf8_lossy(&bytes);
                Ok(Some((mark, text.lines().nth(1).unwrap_or_default().to_owned())))
            }
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(io(error)),
        }
    }

    async fn remove(&self, node: &str) -> Result<(), StoreError> {
        match in_time(self.objects.delete(&path(node))).await? {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::from_object("remove a heartbeat", error)),
        }
    }
}

/// What differs from beat to beat.
fn mark(meta: &ObjectMeta) -> String {
    format!("{} {} {}", meta.e_tag.as_deref().unwrap_or_default(), meta.last_modified.timestamp_micros(), meta.size)
}

fn path(node: &str) -> Path {
    Path::from_iter([FOLDER, node])
}

async fn in_time<T>(request: impl Future<Output = T>) -> Result<T, StoreError> {
    tokio::time::timeout(REQUEST, request).await.map_err(|_| StoreError::Stalled { waited: REQUEST })
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Nothing that is done under these locks can panic half-way.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// 16 hexadecimal digits that no other process has: the standard library seeds its hashers from the system.
pub(crate) fn random_name() -> String {
    use std::hash::{BuildHasher, Hasher};
    let seeded = std::collections::hash_map::RandomState::new().build_hasher();
    format!("{:016x}", seeded.finish())
}

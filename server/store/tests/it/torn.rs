//! Storage that fails, hangs and does what it says it did not, under processes that are killed at
//! any write: what was acknowledged is there, what was deleted stays away, and nothing else appears.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use percept_store::{BlobId, CatalogueEntry, DataRoot, Key, Prefix, RootConfig, SessionPlace, SlateStore, Store};

use crate::faulty::{Faulty, Plan};
use crate::{Random, key};

const IDS: [&str; 3] = ["a", "b", "c"];
const STEPS: u64 = 30;
const LIVES: u64 = 3;
/// How long a commit waits; what hangs takes longer.
const COMMIT_TIMEOUT: Duration = Duration::from_millis(300);
/// How long opening and closing may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// What the caller was told.
#[derive(Default)]
struct Told {
    /// Sessions whose creation was acknowledged and whose deletion was not even asked for.
    present: HashMap<&'static str, SessionPlace>,
    /// Ids of which a creation or deletion was neither acknowledged nor refused.
    unsure: BTreeSet<&'static str>,
    /// Generations whose deletion was acknowledged.
    buried: BTreeSet<String>,
    /// By generation: records acknowledged.
    records: HashMap<String, BTreeMap<Key, Bytes>>,
    /// By generation: records that may be there.
    tried: HashMap<String, BTreeMap<Key, Bytes>>,
}

struct Life<'a> {
    root: DataRoot,
    told: &'a mut Told,
    random: Random,
    /// Open ones, by generation.
    stores: HashMap<String, SlateStore>,
}

impl Life<'_> {
    async fn step(&mut self) {
        let id = IDS[self.random.below(3) as usize];
        match (self.random.below(10), self.told.present.get(id).cloned()) {
            (_, None) => self.create(id).await,
            (0, Some(place)) => self.bury(id, &place).await,
            (1, Some(place)) => {
                let Some(store) = self.stores.remove(place.generation()) else { return };
                let _ = tokio::time::timeout(PATIENCE, store.close()).await;
            }
            (_, Some(place)) => self.write(&place).await,
        }
    }

    async fn create(&mut self, id: &'static str) {
        let record = self.random.next().to_le_bytes();
        // Until it is answered: the process may be killed meanwhile.
        self.told.unsure.insert(id);
        if let Ok(place) = self.root.create(id, &record).await {
            assert!(!self.told.records.contains_key(place.generation()), "a generation came twice");
            self.told.unsure.remove(id);
            self.told.records.insert(place.generation().to_owned(), BTreeMap::new());
            self.told.present.insert(id, place);
        }
    }

    async fn bury(&mut self, id: &'static str, place: &SessionPlace) {
        if self.random.below(2) == 0 {
            self.stores.remove(place.generation());
        }
        self.told.present.remove(id);
        self.told.unsure.insert(id);
        if self.root.bury(place).await.is_err() {
            return;
        }
        self.told.unsure.remove(id);
        self.stores.remove(place.generation());
        self.told.buried.insert(place.generation().to_owned());
        if self.random.below(2) == 0 {
            let _ = self.root.purge(place).await;
        }
    }

    /// A record, or a blob and the record that names it.
    async fn write(&mut self, place: &SessionPlace) {
        let generation = place.generation().to_owned();
        if !self.stores.contains_key(&generation) {
            match tokio::time::timeout(PATIENCE, self.root.open_session(place)).await {
                Ok(Ok(store)) => drop(self.stores.insert(generation.clone(), store)),
                _ => return,
            }
        }
        let store = &self.stores[&generation];
        let name = key(if self.random.below(2) == 0 { "blob" } else { "plain" }).numbered(self.random.next()).unwrap();
        let content = Bytes::from(vec![self.random.next() as u8; 1 + self.random.below(5000) as usize]);
        let mut value = content.clone();
        if name.as_str().starts_with("blob") {
            let Ok(blob) = store.put_blob(content).await else { return };
            value = Bytes::copy_from_slice(blob.as_bytes());
        }
        self.told.tried.entry(generation.clone()).or_default().insert(name.clone(), value.clone());
        if store.put(name.clone(), value.clone()).await.is_ok() {
            self.told.records.entry(generation).or_default().insert(name, value);
        }
    }
}

/// Opens, lives for a while on bad storage, and dies where the storage does.
async fn live(objects: &Faulty, told: &mut Told, mut random: Random) {
    let mut config = RootConfig::objects(Arc::new(objects.clone()));
    config.session.commit_timeout = COMMIT_TIMEOUT;
    let Ok(root) = DataRoot::open(config).await else { return };
    let mut life = Life { root, told, random: Random(random.next()), stores: HashMap::new() };
    objects.set(match random.below(3) {
        0 => {
            let write = objects.num_writes() + random.below(80);
            Plan::CutAt { write, applied: random.below(2) == 0 }
        }
        _ => Plan::Random { random: Random(random.next()), percent: 2 + random.below(25) },
    });
    let steps = async {
        for _ in 0..STEPS {
            life.step().await;
        }
    };
    tokio::select! {
        () = steps => {}
        () = objects.cut() => {}
    }
}

/// On good storage again: is everything as it was told?
async fn check(objects: &Faulty, told: &mut Told) {
    let root = DataRoot::open(RootConfig::objects(Arc::new(objects.clone()))).await.unwrap();
    let mut listed: HashMap<String, SessionPlace> = HashMap::new();
    for entry in root.list().await.unwrap() {
        match entry {
            CatalogueEntry::Created { place, .. } => drop(listed.insert(place.id().to_owned(), place)),
            CatalogueEntry::Deleted { place } => root.purge(&place).await.unwrap(),
            CatalogueEntry::Damaged { place } => panic!("{place:?} is damaged"),
        }
    }
    for id in IDS {
        let found = listed.get(id);
        if let Some(place) = found {
            assert!(!told.buried.contains(place.generation()), "{place:?} came back");
        }
        if let Some(place) = told.present.get(id) {
            // A creation that was refused or broke off while the session was there changes nothing.
            assert_eq!(found, Some(place), "acknowledged and gone");
        } else if !told.unsure.contains(id) {
            assert_eq!(found, None, "nobody made it");
        }
        told.unsure.remove(id);
        let Some(place) = found.cloned() else { continue };
        told.present.insert(id, place.clone());
        let store = root.open_session(&place).await.unwrap();
        let found: BTreeMap<_, _> = store.scan_all(&Prefix::everything()).await.unwrap().into_iter().collect();
        let acknowledged = told.records.entry(place.generation().to_owned()).or_default();
        for (name, value) in acknowledged.iter() {
            assert_eq!(found.get(name), Some(value), "{name} was acknowledged");
        }
        let tried = told.tried.entry(place.generation().to_owned()).or_default();
        for (name, value) in &found {
            assert_eq!(tried.get(name), Some(value), "{name} came from nowhere");
            if name.as_str().starts_with("blob") {
                store.get_blob(BlobId::from_bytes(value[..].try_into().unwrap())).await.unwrap();
            }
        }
        *acknowledged = found;
        store.close().await.unwrap();
    }
}

/// One store over several lives; how many records and deletions were acknowledged.
fn round(seed: u64) -> (usize, usize) {
    let runtime = || tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let objects = Faulty::new();
    let mut told = Told::default();
    for life in 0..LIVES {
        // Ends with all its tasks, as if killed.
        runtime().block_on(live(&objects, &mut told, Random(seed << 8 | life)));
        objects.set(Plan::Well);
        runtime().block_on(check(&objects, &mut told));
    }
    (told.records.values().map(BTreeMap::len).sum(), told.buried.len())
}

/// `PERCEPT_TORN_ROUNDS` says how many stores are tried, all at once.
#[test]
fn on_bad_storage_what_was_acknowledged_is_there_and_what_was_deleted_stays_away() {
    let rounds = std::env::var("PERCEPT_TORN_ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(24);
    let threads: Vec<_> = (0..rounds).map(|seed| std::thread::spawn(move || round(seed))).collect();
    let (mut num_records, mut num_buried) = (0, 0);
    for (seed, thread) in threads.into_iter().enumerate() {
        let done = thread.join();
        let (records, buried) = done.unwrap_or_else(|_| panic!("seed {seed} of {rounds}, see above"));
        (num_records, num_buried) = (num_records + records, num_buried + buried);
    }
    println!("{num_records} records, {num_buried} deletions");
    assert!(num_records as u64 > 10 * rounds && num_buried as u64 >= rounds / 2, "too few to prove anything");
}

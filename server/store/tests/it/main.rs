//! The store as its callers see it, on a real directory and in memory.

// The exemption for tests does not reach their helpers.
#![allow(clippy::unwrap_used, clippy::panic)]

mod blobs;
mod cache;
mod catalogue;
mod clock_back;
mod crash;
mod failing;
mod faulty;
mod fence;
mod files;
mod lease;
mod migration;
mod records;
mod s3;
mod small_disk;
mod tools;
mod torn;

use std::ops::Deref;
use std::path::PathBuf;

use bytes::Bytes;
use percept_store::{CatalogueEntry, DataRoot, Key, RootConfig, SessionPlace, SlateStore};

/// A key from its text.
pub(crate) fn key(text: &str) -> Key {
    Key::parse(text).unwrap()
}

/// Bytes of a text.
pub(crate) fn value(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

/// A session's store, with the data that it is part of.
#[derive(Debug)]
pub(crate) struct Opened {
    pub(crate) store: SlateStore,
    pub(crate) place: SessionPlace,
    pub(crate) root: DataRoot,
}

impl Deref for Opened {
    type Target = SlateStore;

    fn deref(&self) -> &SlateStore {
        &self.store
    }
}

impl Opened {
    /// Where the session's files are.
    pub(crate) fn folder(&self) -> PathBuf {
        let root = self.root.directory().unwrap();
        root.join("sessions").join(self.place.id()).join(self.place.generation())
    }
}

/// The session `s` of a directory, with the settings of production; made new if it is not there.
pub(crate) async fn open(root: &std::path::Path) -> Opened {
    open_with(RootConfig::directory(root)).await
}

/// The session `s` of any data.
pub(crate) async fn open_with(config: RootConfig) -> Opened {
    let root = DataRoot::open(config).await.unwrap();
    let place = match created(&root, "s").await {
        Some((place, _)) => place,
        None => root.create("s", b"").await.unwrap(),
    };
    let store = root.open_session(&place).await.unwrap();
    Opened { store, place, root }
}

/// A session's place and record, if the catalogue says that it exists.
pub(crate) async fn created(root: &DataRoot, id: &str) -> Option<(SessionPlace, Bytes)> {
    root.list().await.unwrap().into_iter().find_map(|entry| match entry {
        CatalogueEntry::Created { place, record } if place.id() == id => Some((place, record)),
        _ => None,
    })
}

/// A generator good enough for tests: SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Debug, Clone)]
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// A number from 0 up to, but not including `bound`.
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}

/// Bits well mixed: the last step of SplitMix64.
pub(crate) fn mix(seed: u64) -> u64 {
    let mut z = seed;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

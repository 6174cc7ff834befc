//! The store as its callers see it, on a real directory and in memory.

// The exemption for tests does not reach their helpers.
#![allow(clippy::unwrap_used, clippy::panic)]

mod blobs;
mod crash;
mod export;
mod failing;
mod fence;
mod records;

use bytes::Bytes;
use percept_store::{Key, SlateStore, StoreConfig};

/// A key from its text.
pub(crate) fn key(text: &str) -> Key {
    Key::parse(text).unwrap()
}

/// Bytes of a text.
pub(crate) fn value(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

/// Opens a directory with the settings of production.
pub(crate) async fn open(root: &std::path::Path) -> SlateStore {
    SlateStore::open(StoreConfig::directory(root)).await.unwrap()
}

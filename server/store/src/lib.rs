//! What survives a crash: small ordered records, large immutable blobs, and the fence between writers.
//!
//! Comes in: batches of records under [`Key`]s and blobs of bytes. Goes out: the same, after `kill -9`,
//! power loss, a full disk or a second writer; nothing is acknowledged that could still be lost.
//! It knows nothing of what the bytes mean, and it has no clock but the one that ages blobs.
//!
//! - [`Store`] is the trait that the service speaks; `Arc<dyn Store>` is what it holds.
//! - [`SlateStore`] is the one implementation: records in SlateDB, blobs as content-addressed objects
//!   beside it, both over `object_store`; a local directory now, memory for tests, any object store that
//!   has an atomic create later.
//! - [`keys`] says where a session keeps what; [`export`] carries a whole store elsewhere.
//!
//! A directory holds `LOCK` (advisory, one process), `FORMAT` (a number in a line), `records/` and
//! `blobs/<first two hex digits>/<sha256>`.
//!
//! The rule for readers and writers: write the blobs first, then one batch of records that names them,
//! and acknowledge after the batch. A crash in between leaves blobs that nobody names, which
//! [`Store::collect_garbage`] removes.

mod blobs;
mod committer;
mod config;
mod directory;
mod error;
pub mod export;
mod format;
pub mod keys;
mod observed;
mod slate;
mod store;

pub use blobs::{BlobId, GarbageReport};
pub use config::{Location, StoreConfig};
pub use error::StoreError;
pub use keys::{Key, Prefix, SessionKeys};
pub use slate::SlateStore;
pub use store::{Record, Store};

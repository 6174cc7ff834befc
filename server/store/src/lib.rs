//! What survives a crash: small ordered records, large immutable blobs, and the fence between writers.
//!
//! Comes in: batches of records under [`Key`]s and blobs of bytes. Goes out: the same, after `kill -9`,
//! power loss, a full disk or a second writer; nothing is acknowledged that could still be lost.
//! It knows nothing of what the bytes mean, and it has no clock but the one that ages blobs.
//!
//! - [`DataRoot`] is all data of a server: a catalogue of sessions, and a store of its own for each.
//! - [`Store`] is the trait that a session keeps its state behind; `Arc<dyn Store>` is what the service holds.
//! - [`SlateStore`] is its one implementation: records in SlateDB, blobs as content-addressed objects
//!   beside it, both over `object_store`: a local directory, memory for tests, any object store that has an
//!   atomic create.
//! - [`keys`] says where a session keeps what; [`archive`] and [`backup`] carry sessions elsewhere, [`check`] looks
//!   whether they are whole.
//!
//! A directory holds `LOCK` (advisory, one process), `FORMAT` (a number in a line), `catalogue/<id>/<n>` and, for
//! every session, `sessions/<id>/<generation>/` with `records/`, `blobs/<sha256>` and `summary`. What belongs to a tenant
//! and to no session lies in `files/<kind>/<tenant>/<name>`.
//!
//! Where several processes share the data there are also `nodes/<id>`, their heartbeats, and for every session
//! `lease/<n>`, which says whose it is; see [`Claim`].
//!
//! The rule for readers and writers: write the blobs first, then one batch of records that names them,
//! and acknowledge after the batch. A crash in between leaves blobs that nobody names, which
//! [`Store::collect_garbage`] removes.

pub mod archive;
pub mod backup;
mod blob_id;
mod blobs;
mod cache;
mod catalogue;
pub mod check;
mod clock;
mod committer;
mod config;
mod directory;
mod error;
mod files;
mod format;
mod framing;
pub mod keys;
mod lease;
mod location;
mod migrate;
mod node;
mod observed;
mod reader;
mod room;
mod root;
mod slate;
mod store;
mod threads;
mod ticks;
mod trial;

pub use blob_id::{BlobId, InvalidBlobId};
pub use blobs::{GarbageReport, Mark};
pub use cache::CacheConfig;
pub use catalogue::{CatalogueEntry, SessionPlace};
pub use clock::Clock;
pub use config::{RootConfig, StoreConfig};
pub use error::StoreError;
pub use files::{DETECTORS, FilePlace};
pub use keys::{Key, Prefix};
pub use lease::Claim;
pub use location::{Location, S3Options};
pub use node::NodeState;
pub use reader::SessionReader;
pub use room::check_room;
pub use root::DataRoot;
pub use slate::SlateStore;
pub use store::{Record, Store};

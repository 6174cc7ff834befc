//! The contract in Rust: compiled protos, and their conversion to and from the types of the house.
//!
//! Comes in: decoded protobuf messages. Goes out: checked domain types, or a `service::Error` that names the
//! field. And back. One file a noun in `convert`. [`params`] lays what was sent over the defaults; [`json`]
//! reads and writes any message as JSON; [`parts`] cuts large answers; [`expansion`] refuses what would swell when it is read. No door is known here.

pub mod codec;
pub mod convert;
pub mod expansion;
pub mod json;
pub mod params;
pub mod parts;

/// Generated from `proto/percept/v1`.
#[allow(missing_docs, clippy::all, clippy::pedantic)]
pub mod v1 {
    tonic::include_proto!("percept.v1");
}

/// Encoded `FileDescriptorSet` of the contract, comments included.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// Re-exported so that doors name one version of the field error.
pub use percept_service::{Error, Result};

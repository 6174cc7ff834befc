//! A session: one writer, a bounded queue, snapshots for readers, records for the time after a crash.
//!
//! [`actor`] owns the pipeline; [`handle`] is what doors hold of it; [`persist`] makes its results durable; [`registry`] finds and wakes sessions.

pub(crate) mod actor;
pub(crate) mod events;
pub(crate) mod handle;
pub(crate) mod keyframe_codec;
pub(crate) mod meta;
pub(crate) mod persist;
pub(crate) mod recover;
pub(crate) mod refusal;
pub(crate) mod registry;
pub(crate) mod sensor_book;

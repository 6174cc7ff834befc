//! A session: one writer, a bounded queue, snapshots for readers, records for the time after a crash.
//!
//! - [`open`] begins. [`registry`] knows which sessions there are and gives handles on them; [`listing`] says what they are without waking
//!   them, [`changing`] changes what is set of them. [`slot`] is one session's state machine,
//!   [`life`] holds its steps, [`keeper`] puts to sleep what nobody uses, [`sharing`] follows those who share the data.
//! - [`actor`] owns the pipeline of a session that is awake; [`handle`] is what callers hold of it; [`events`] tells
//!   watchers, awake or not.
//! - [`sensor_book`] counts what sensors send, [`verdict`] says how their streams fare.
//! - [`persist`] makes results durable, [`writer`] turns them into [`records`] and blobs ([`keyframe_codec`]), [`recover`]
//!   reads them again, [`inspect`] one by one without running anything. [`fault`] says which troubles pass and which set a
//!   session apart. [`recording`] writes down what comes in, in files that [`recordings`] knows. [`scratch`] takes what of the map does not fit into memory.

pub(crate) mod actor;
pub(crate) mod annotations;
pub(crate) mod changing;
pub(crate) mod command;
pub(crate) mod event;
pub(crate) mod events;
pub(crate) mod fault;
pub(crate) mod fleet;
pub(crate) mod frame_look;
pub(crate) mod handle;
pub(crate) mod history;
pub(crate) mod inspect;
pub(crate) mod job;
pub(crate) mod keeper;
pub(crate) mod keyframe_codec;
pub(crate) mod life;
pub(crate) mod listing;
pub(crate) mod meta;
pub(crate) mod open;
pub(crate) mod persist;
pub(crate) mod recording;
pub(crate) mod recordings;
pub(crate) mod records;
pub(crate) mod recover;
pub(crate) mod refusal;
pub(crate) mod registry;
pub(crate) mod scratch;
pub(crate) mod sensor_book;
pub(crate) mod sharing;
pub(crate) mod shelf;
pub(crate) mod slot;
pub(crate) mod state;
pub(crate) mod stream_figures;
#[cfg(test)]
mod tests;
pub(crate) mod verdict;
pub(crate) mod writer;

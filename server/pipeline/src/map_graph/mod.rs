//! The map's poses: how the first is found level, and the back end that corrects them beside the frames.

pub(crate) mod level;
pub(crate) mod worker;

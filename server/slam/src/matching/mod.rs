//! What planar scans are matched with, in odometry and in loop closing alike: a likelihood field, searches in it, and what
//! contradicts a match.

pub(crate) mod branch_and_bound;
pub(crate) mod field;
pub(crate) mod search;
pub(crate) mod sight;

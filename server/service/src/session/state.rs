//! Where a session is in its life.

/// Where a session is in its life, as callers see it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SessionState {
    /// Not yet durable.
    Creating,
    /// Stored, not in memory; the first use wakes it.
    Asleep,
    /// On its way into memory.
    Waking,
    /// In memory.
    Awake,
    /// Set apart: its data are damaged, or it failed again and again.
    Faulted,
    /// On its way out.
    Deleting,
}

//! A bounded history that is read by many and waited for: the writer never waits, and a reader that falls behind is told
//! how much is missing.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Entries numbered by tokens that grow by one.
pub(crate) struct History<T> {
    ring: Mutex<Ring<T>>,
    changed: Notify,
}

struct Ring<T> {
    entries: VecDeque<T>,
    first_token: u64,
    next_token: u64,
    capacity: usize,
    /// Whether there was nothing before the first token.
    is_whole: bool,
    closed: bool,
}

/// What comes after a token.
#[derive(Debug, PartialEq)]
pub(crate) enum Read<T> {
    /// Entries with their tokens, oldest first.
    Entries(Vec<(u64, T)>),
    /// Entries are missing; how many, 0 if unknown. Go on from the token.
    Missed {
        /// Of the last entry that is missing.
        token: u64,
        /// How many are.
        missed: u64,
    },
}

impl<T: Clone> History<T> {
    /// A history that keeps `capacity` entries, the first of which gets `first_token`. Entries are not stored: one that
    /// comes back must start above all tokens it gave before, or a reader that resumes would miss some and not be told.
    pub(crate) fn starting_at(first_token: u64, capacity: usize) -> Self {
        let (entries, capacity) = (VecDeque::new(), capacity.max(1));
        let next_token = first_token;
        let ring = Ring { entries, first_token, next_token, capacity, is_whole: false, closed: false };
        Self { ring: Mutex::new(ring), changed: Notify::new() }
    }

    /// The same of what had no entry before: a reader who resumes from 0 gets it from the very first.
    pub(crate) fn beginning_at(first_token: u64, capacity: usize) -> Self {
        let history = Self::starting_at(first_token, capacity);
        history.lock().is_whole = true;
        history
    }

    fn lock(&self) -> MutexGuard<'_, Ring<T>> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends entries and wakes the readers.
    pub(crate) fn publish(&self, entries: impl IntoIterator<Item = T>) {
        let mut ring = self.lock();
        for entry in entries {
            ring.next_token += 1;
            if ring.entries.len() == ring.capacity {
                ring.entries.pop_front();
            }
            ring.entries.push_back(entry);
        }
        drop(ring);
        self.changed.notify_waiters();
    }

    /// Forgets the entries, not where it was: a reader who resumes from before is told that some are missing.
    pub(crate) fn forget(&self) {
        let mut ring = self.lock();
        ring.entries = VecDeque::new();
        ring.first_token = ring.next_token;
        ring.is_whole = false;
    }

    /// Nothing more will come: readers end.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_waiters();
    }

    /// Token of the newest entry; one less than that of the first if there was none.
    pub(crate) fn newest_token(&self) -> u64 {
        self.lock().next_token - 1
    }

    /// The newest entry that is kept.
    pub(crate) fn newest(&self) -> Option<T> {
        self.lock().entries.back().cloned()
    }

    /// What comes after `token`, at most `limit` entries; waits until there is some. `None` when the history is closed and
    /// everything was read.
    pub(crate) async fn after(&self, token: u64, limit: usize) -> Option<Read<T>> {
        loop {
            let changed = self.changed.notified();
            tokio::pin!(changed);
            // Registered before the look, so that an entry between look and wait is not missed.
            changed.as_mut().enable();
            {
                let ring = self.lock();
                if let Some(read) = ring.after(token, limit) {
                    return Some(read);
                }
                if ring.closed {
                    return None;
                }
            }
            changed.await;
        }
    }
}

impl<T: Clone> Ring<T> {
    fn after(&self, token: u64, limit: usize) -> Option<Read<T>> {
        let newest = self.next_token - 1;
        let oldest = self.next_token - self.entries.len() as u64;
        let token = if token == 0 && self.is_whole { self.first_token - 1 } else { token };
        // A token from before a restart, or none of ours: nobody knows how many entries are missing.
        if token > newest || token + 1 < self.first_token {
            let token = if token > newest { newest } else { oldest - 1 };
            return Some(Read::Missed { token, missed: 0 });
        }
        if token == newest {
            return None;
        }
        if token + 1 < oldest {
            return Some(Read::Missed { token: oldest - 1, missed: oldest - token - 1 });
        }
        let start = (token + 1 - oldest) as usize;
        let entries = self.entries.iter().skip(start).take(limit).cloned();
        Some(Read::Entries((token + 1..).zip(entries).collect()))
    }
}

//! Events of a session: numbered, kept for a while, handed to watchers without ever waiting for one.

use percept_geometry::Timestamp;
use std::collections::VecDeque;
use std::sync::Mutex;
use tokio::sync::Notify;

/// What happened.
#[derive(Debug, Clone)]
pub enum EventKind {
    /// A frame was registered.
    Pose(Box<percept_pipeline::PoseEstimate>),
    /// A frame became a keyframe.
    Keyframe(percept_pipeline::KeyframeInfo),
    /// An object changed; with it as it is now, if it is still there.
    Object(Box<(percept_scene::ObjectChange, Option<percept_scene::Object>)>),
    /// A loop was found or changed its state.
    Loop(Box<percept_pipeline::Loop>),
    /// The map has a new version.
    MapVersion(u64),
    /// Events are missing; how many.
    Resync(u64),
}

/// An event with its place in the order.
#[derive(Debug, Clone)]
pub struct Event {
    /// Grows by one with every event.
    pub token: u64,
    /// Stamp of the frame that caused it.
    pub stamp: Timestamp,
    /// What happened.
    pub kind: EventKind,
}

/// A bounded history with a wake-up for watchers: the writer never waits, a reader that falls behind the
/// history gets one `Resync`.
pub struct EventLog {
    ring: Mutex<Ring>,
    changed: Notify,
}

struct Ring {
    events: VecDeque<Event>,
    first_token: u64,
    next_token: u64,
    capacity: usize,
    closed: bool,
}

impl EventLog {
    /// A log that keeps `capacity` events, of a session that had none before.
    pub fn new(capacity: usize) -> Self {
        // Tokens start at 1, so that 0 can mean 'from the very first'.
        Self::starting_at(1, capacity)
    }

    /// A log whose first event gets `first_token`. Events are not stored: a session that comes back must start
    /// above all tokens it gave before, or a watcher that resumes would miss events and not be told.
    pub fn starting_at(first_token: u64, capacity: usize) -> Self {
        let (events, capacity) = (VecDeque::new(), capacity.max(1));
        let ring = Ring { events, first_token, next_token: first_token, capacity, closed: false };
        Self { ring: Mutex::new(ring), changed: Notify::new() }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Ring> {
        self.ring.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Appends events and wakes the watchers.
    pub fn publish(&self, stamp: Timestamp, kinds: impl IntoIterator<Item = EventKind>) {
        let mut ring = self.lock();
        for kind in kinds {
            let token = ring.next_token;
            ring.next_token += 1;
            if ring.events.len() == ring.capacity {
                ring.events.pop_front();
            }
            ring.events.push_back(Event { token, stamp, kind });
        }
        drop(ring);
        self.changed.notify_waiters();
    }

    /// Forgets the history, not where it was: a watcher who resumes from before is told that events are missing.
    pub fn forget(&self) {
        let mut ring = self.lock();
        ring.events = VecDeque::new();
        ring.first_token = ring.next_token;
    }

    /// No more events will come: watchers end.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_waiters();
    }

    /// Token of the newest event, 0 if none.
    pub fn newest_token(&self) -> u64 {
        self.lock().next_token - 1
    }

    /// Events after `token`, at most `limit`; waits until there is one. `None` when the log is closed and
    /// everything was read.
    pub async fn after(&self, token: u64, limit: usize) -> Option<Vec<Event>> {
        loop {
            let changed = self.changed.notified();
            tokio::pin!(changed);
            // Registered before the look, so that an event between look and wait is not missed.
            changed.as_mut().enable();
            {
                let ring = self.lock();
                if let Some(events) = ring.after(token, limit) {
                    return Some(events);
                }
                if ring.closed {
                    return None;
                }
            }
            changed.await;
        }
    }
}

impl Ring {
    fn after(&self, token: u64, limit: usize) -> Option<Vec<Event>> {
        let newest = self.next_token - 1;
        // A token from before a restart, or none of ours: nobody knows how many events are missing.
        if token > newest || token + 1 < self.first_token {
            let token = if token > newest { newest } else { self.next_token - 1 - self.events.len() as u64 };
            return Some(vec![Event { token, stamp: self.newest_stamp(), kind: EventKind::Resync(0) }]);
        }
        if token == newest {
            return None;
        }
        let oldest = self.next_token - self.events.len() as u64;
        if token + 1 < oldest {
            let missed = oldest - token - 1;
            let resync = Event { token: oldest - 1, stamp: self.newest_stamp(), kind: EventKind::Resync(missed) };
            return Some(vec![resync]);
        }
        let start = (token + 1 - oldest) as usize;
        Some(self.events.iter().skip(start).take(limit).cloned().collect())
    }

    fn newest_stamp(&self) -> Timestamp {
        self.events.back().map(|e| e.stamp).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(events: &[Event]) -> Vec<u64> {
        events.iter().map(|e| e.token).collect()
    }

    #[tokio::test]
    async fn a_watcher_resumes_where_it_stopped() {
        let log = EventLog::new(10);
        log.publish(Timestamp(1), (0..5).map(EventKind::MapVersion));
        assert_eq!(tokens(&log.after(2, 2).await.unwrap()), [3, 4]);
        assert_eq!(tokens(&log.after(4, 9).await.unwrap()), [5]);
    }

    #[tokio::test]
    async fn a_slow_watcher_gets_one_resync_and_then_what_is_left() {
        let log = EventLog::new(3);
        log.publish(Timestamp(1), (0..10).map(EventKind::MapVersion));
        let events = log.after(1, 100).await.unwrap();
        assert!(matches!(events[..], [Event { token: 7, kind: EventKind::Resync(6), .. }]));
        assert_eq!(tokens(&log.after(7, 100).await.unwrap()), [8, 9, 10]);
    }

    #[tokio::test]
    async fn a_token_from_before_a_restart_gets_a_resync_and_then_all_that_is_new() {
        let log = EventLog::starting_at(1000, 10);
        let events = log.after(3, 100).await.unwrap();
        assert!(matches!(events[..], [Event { token: 999, kind: EventKind::Resync(0), .. }]));
        log.publish(Timestamp(1), (0..2).map(EventKind::MapVersion));
        let events = log.after(3, 100).await.unwrap();
        assert!(matches!(events[..], [Event { token: 999, kind: EventKind::Resync(0), .. }]));
        assert_eq!(tokens(&log.after(999, 100).await.unwrap()), [1000, 1001]);
    }

    #[tokio::test]
    async fn closing_ends_the_watch_after_the_last_event() {
        let log = EventLog::new(3);
        log.publish(Timestamp(1), [EventKind::MapVersion(1)]);
        log.close();
        assert_eq!(log.after(0, 10).await.unwrap().len(), 1);
        assert!(log.after(1, 10).await.is_none());
    }
}

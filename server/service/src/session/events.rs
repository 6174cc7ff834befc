//! Events of a session: numbered, kept for a while, handed to watchers without ever waiting for one.

use super::event::{Event, EventKind};
use super::fleet::FleetLink;
use super::history::{History, Read};
use percept_geometry::Timestamp;
use tokio::sync::watch;

/// The events of a session; the writer never waits, a reader that falls behind gets one `Resync`.
pub struct EventLog {
    history: History<(Timestamp, EventKind)>,
    /// Those who watch all sessions are told as well.
    fleet: Option<FleetLink>,
    /// That what callers set is another now, which is no event of the session's own.
    settings: watch::Sender<()>,
}

impl EventLog {
    /// A log that keeps `capacity` events, of a session that had none before.
    pub fn new(capacity: usize) -> Self {
        Self::beginning_at(1, capacity)
    }

    /// A log whose first event gets `first_token`: above all that were given before.
    pub fn starting_at(first_token: u64, capacity: usize) -> Self {
        Self { history: History::starting_at(first_token, capacity), fleet: None, settings: watch::Sender::new(()) }
    }

    /// The same of a session that had no events before: 0 means from the very first.
    pub fn beginning_at(first_token: u64, capacity: usize) -> Self {
        Self { history: History::beginning_at(first_token, capacity), ..Self::starting_at(first_token, 1) }
    }

    /// The same, which tells those who watch all sessions, too.
    pub(super) fn told_to(self, fleet: FleetLink) -> Self {
        Self { fleet: Some(fleet), ..self }
    }

    /// Those who watch all sessions, for what is no event of the session's own.
    pub(super) fn fleet(&self) -> Option<&FleetLink> {
        self.fleet.as_ref()
    }

    /// What callers set is another now.
    pub(super) fn settings_changed(&self) {
        self.settings.send_replace(());
    }

    /// Changes whenever what callers set does.
    pub fn settings(&self) -> watch::Receiver<()> {
        self.settings.subscribe()
    }

    /// Appends events and wakes the watchers.
    pub fn publish(&self, stamp: Timestamp, kinds: impl IntoIterator<Item = EventKind>) {
        let kinds: Vec<EventKind> = kinds.into_iter().collect();
        if let Some(fleet) = &self.fleet {
            fleet.happened(stamp, &kinds);
        }
        self.history.publish(kinds.into_iter().map(|kind| (stamp, kind)));
    }

    /// Forgets the history, not where it was: a watcher who resumes from before is told that events are missing.
    pub fn forget(&self) {
        self.history.forget();
    }

    /// No more events will come: watchers end.
    pub fn close(&self) {
        self.history.close();
    }

    /// Token of the newest event, 0 if none.
    pub fn newest_token(&self) -> u64 {
        self.history.newest_token()
    }

    /// Events after `token`, at most `limit`; waits until there is one. `None` when the log is closed and
    /// everything was read.
    pub async fn after(&self, token: u64, limit: usize) -> Option<Vec<Event>> {
        Some(match self.history.after(token, limit).await? {
            Read::Entries(entries) => {
                entries.into_iter().map(|(token, (stamp, kind))| Event { token, stamp, kind }).collect()
            }
            Read::Missed { token, missed } => {
                let stamp = self.history.newest().map(|(stamp, _)| stamp).unwrap_or_default();
                vec![Event { token, stamp, kind: EventKind::Resync(missed) }]
            }
        })
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
    async fn nothing_is_missing_from_the_very_first_of_a_new_session() {
        let log = EventLog::beginning_at(1000, 10);
        log.publish(Timestamp(1), (0..2).map(EventKind::MapVersion));
        assert_eq!(tokens(&log.after(0, 100).await.unwrap()), [1000, 1001]);
        // Of another session of that name.
        assert!(matches!(log.after(3, 100).await.unwrap()[..], [Event { kind: EventKind::Resync(0), .. }]));
        log.forget();
        assert!(matches!(log.after(0, 100).await.unwrap()[..], [Event { kind: EventKind::Resync(0), .. }]));
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

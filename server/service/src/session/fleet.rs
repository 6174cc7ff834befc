//! What happens in all sessions of this server, for those who watch a fleet: one bounded history, of which each reader sees
//! what it may.

use super::event::EventKind;
use super::history::{History, Read};
use super::state::SessionState;
use percept_geometry::Timestamp;
use std::sync::Arc;

/// Something that happened in a session.
#[derive(Debug, Clone)]
pub struct FleetEvent {
    /// Grows by one with every event of any session.
    pub token: u64,
    /// The session; empty if events of unknown sessions are missing.
    pub session: Arc<str>,
    /// Whose it is.
    pub tenant: Arc<str>,
    /// Stamp of the frame that caused it; zero if none did.
    pub stamp: Timestamp,
    /// What happened.
    pub kind: FleetKind,
}

/// What happened in a session, or to it.
#[derive(Debug, Clone)]
pub enum FleetKind {
    /// An event of the session's own.
    Session(EventKind),
    /// It was created.
    Created,
    /// Where it is in its life changed.
    State(SessionState),
    /// What callers set was changed; its new etag.
    Updated(Arc<str>),
    /// It is gone.
    Deleted,
    /// Events are missing; how many of all sessions', 0 if unknown.
    Resync(u64),
}

#[derive(Debug, Clone)]
struct Entry {
    session: Arc<str>,
    tenant: Arc<str>,
    stamp: Timestamp,
    kind: FleetKind,
}

/// What happened in all sessions.
pub struct FleetLog(History<Entry>);

impl FleetLog {
    /// A log that keeps `capacity` events, the first of which gets `first_token`: above all that were given before.
    pub(super) fn starting_at(first_token: u64, capacity: usize) -> Self {
        Self(History::starting_at(first_token, capacity))
    }

    /// Token of the newest event.
    pub fn newest_token(&self) -> u64 {
        self.0.newest_token()
    }

    /// Events after `token` among the next `limit`, those that `is_wanted`, and the token up to which was looked: there
    /// may be none. Waits until something happened. `None` when nothing more will come.
    pub async fn after(
        &self,
        token: u64,
        limit: usize,
        is_wanted: impl Fn(&FleetEvent) -> bool,
    ) -> Option<(Vec<FleetEvent>, u64)> {
        Some(match self.0.after(token, limit).await? {
            Read::Entries(entries) => {
                let end = entries.last().map_or(token, |(token, _)| *token);
                let event = |(token, Entry { session, tenant, stamp, kind })| FleetEvent {
                    token,
                    session,
                    tenant,
                    stamp,
                    kind,
                };
                (entries.into_iter().map(event).filter(is_wanted).collect(), end)
            }
            Read::Missed { token, missed } => {
                let nobody: Arc<str> = Arc::from("");
                let kind = FleetKind::Resync(missed);
                let (session, stamp) = (Arc::clone(&nobody), Timestamp::default());
                // Whoever watches has to know.
                (vec![FleetEvent { token, session, tenant: nobody, stamp, kind }], token)
            }
        })
    }

    /// Nothing more will come: watchers end.
    pub(super) fn close(&self) {
        self.0.close();
    }
}

/// Tells those who watch all sessions of one of them.
#[derive(Clone)]
pub(crate) struct FleetLink {
    log: Arc<FleetLog>,
    session: Arc<str>,
    tenant: Arc<str>,
}

impl FleetLink {
    pub(super) fn new(log: &Arc<FleetLog>, session: &str, tenant: &str) -> Self {
        Self { log: Arc::clone(log), session: Arc::from(session), tenant: Arc::from(tenant) }
    }

    fn tell(&self, stamp: Timestamp, kinds: impl Iterator<Item = FleetKind>) {
        let entry = |kind| Entry { session: Arc::clone(&self.session), tenant: Arc::clone(&self.tenant), stamp, kind };
        self.log.0.publish(kinds.map(entry));
    }

    /// The session's own events.
    pub(super) fn happened(&self, stamp: Timestamp, kinds: &[EventKind]) {
        self.tell(stamp, kinds.iter().cloned().map(FleetKind::Session));
    }

    /// What callers set is another now.
    pub(super) fn updated(&self, etag: &str) {
        self.tell(Timestamp::default(), std::iter::once(FleetKind::Updated(Arc::from(etag))));
    }

    /// The session has gone from one state to another. What never came to be is not told.
    pub(super) fn moved(&self, from: SessionState, to: SessionState, is_gone: bool) {
        let kind = match (from, to) {
            (SessionState::Creating, SessionState::Deleting) => return,
            (_, SessionState::Deleting) if is_gone => FleetKind::Deleted,
            (SessionState::Creating, _) => FleetKind::Created,
            (from, to) if from == to => return,
            (_, to) => FleetKind::State(to),
        };
        self.tell(Timestamp::default(), std::iter::once(kind));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fleet(capacity: usize) -> (Arc<FleetLog>, FleetLink, FleetLink) {
        let log = Arc::new(FleetLog::starting_at(1, capacity));
        let (a, b) = (FleetLink::new(&log, "a", "ours"), FleetLink::new(&log, "b", "theirs"));
        (log, a, b)
    }

    #[tokio::test]
    async fn a_watcher_sees_what_it_wants_and_its_token_goes_on_past_the_rest() {
        let (log, a, b) = fleet(10);
        for version in 0..3 {
            a.happened(Timestamp(1), &[EventKind::MapVersion(version)]);
            b.happened(Timestamp(1), &[EventKind::MapVersion(version)]);
        }
        let ours = |event: &FleetEvent| &*event.tenant == "ours";
        let (events, end) = log.after(0, 4, ours).await.unwrap();
        assert_eq!((events.iter().map(|e| e.token).collect::<Vec<_>>(), end), (vec![1, 3], 4));
        let (events, end) = log.after(5, 4, ours).await.unwrap();
        assert_eq!((events.len(), end), (0, 6));
    }

    #[tokio::test]
    async fn a_watcher_that_falls_behind_is_told_so_whatever_it_wants() {
        let (log, a, _) = fleet(3);
        a.happened(Timestamp(1), &(0..10).map(EventKind::MapVersion).collect::<Vec<_>>());
        let (events, end) = log.after(1, 100, |_| false).await.unwrap();
        assert!(matches!(events[..], [FleetEvent { token: 7, kind: FleetKind::Resync(6), .. }]), "{events:?}");
        assert_eq!(end, 7);
    }

    #[tokio::test]
    async fn lives_are_told_once_and_what_never_came_to_be_is_not() {
        use SessionState::{Asleep, Awake, Creating, Deleting};
        let (log, a, b) = fleet(10);
        let steps = [(Creating, Asleep), (Asleep, Awake), (Awake, Awake), (Awake, Deleting), (Deleting, Deleting)];
        for (i, (from, to)) in steps.into_iter().enumerate() {
            a.moved(from, to, i == 4);
        }
        b.moved(Creating, Deleting, true);
        let (events, _) = log.after(0, 100, |_| true).await.unwrap();
        let told: Vec<FleetKind> = events.into_iter().map(|e| e.kind).collect();
        assert!(
            matches!(
                told[..],
                [FleetKind::Created, FleetKind::State(Awake), FleetKind::State(Deleting), FleetKind::Deleted]
            ),
            "{told:?}"
        );
    }
}

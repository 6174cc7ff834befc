//! One session's place in the registry: what is known of it at all times, and the state machine of its life.
//!
//! ```text
//! Creating ─► Asleep ─► Waking ─► Awake ─► Retiring ─► Asleep
//!                          └───────► Faulted (set apart: read, as far as it is whole)
//! Asleep, Awake, Faulted ─► Deleting ─► Gone
//! ```
//!
//! Every transition is made by a task of the registry, never by a request: whoever asked may leave, what was begun is
//! finished.

use super::events::EventLog;
use super::fault::Fault;
use super::handle::Session;
use super::recording::SessionRecording;
use super::recordings::Recordings;
use super::records::Counts;
use super::state::SessionState;
use crate::{Error, Result, observe};
use percept_store::SessionPlace;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;
use tokio::sync::watch;

/// Where a session is in its life.
#[derive(Clone)]
pub(super) enum Phase {
    /// Its catalogue entry is being written.
    Creating,
    /// Only stored. With the error that the last try to wake it met, if that may pass.
    Asleep(Option<Error>),
    /// Being read from the store.
    Waking,
    /// In memory, with its actor.
    Awake(Arc<Session>),
    /// Being put to sleep.
    Retiring(Arc<Session>),
    /// Set apart; readable if something of it is whole.
    Faulted(Fault, Option<Arc<Session>>),
    /// Its end is being written down.
    Deleting,
    /// It is no more, or never came to be.
    Gone(Result<()>),
}

impl Phase {
    /// Whether nothing is under way.
    pub(super) fn is_settled(&self) -> bool {
        !matches!(self, Self::Creating | Self::Waking | Self::Retiring(_) | Self::Deleting)
    }

    /// As callers see it.
    pub(super) fn state(&self) -> SessionState {
        match self {
            Self::Creating => SessionState::Creating,
            Self::Asleep(_) => SessionState::Asleep,
            Self::Waking => SessionState::Waking,
            Self::Awake(_) | Self::Retiring(_) => SessionState::Awake,
            Self::Faulted(..) => SessionState::Faulted,
            Self::Deleting | Self::Gone(_) => SessionState::Deleting,
        }
    }
}

/// What is known of a session without waking it: little, for there may be many thousands.
#[derive(Debug, Clone)]
pub(super) struct Known {
    pub(super) tenant: String,
    pub(super) display_name: String,
    pub(super) labels: BTreeMap<String, String>,
    pub(super) revision: u64,
    pub(super) request_id: String,
    pub(super) create_time_ns: i64,
    pub(super) is_ingest_only: bool,
    /// None until its summary was read.
    pub(super) counts: Option<Counts>,
}

/// A session's place in the registry.
pub(super) struct Slot {
    pub(super) id: String,
    /// Set once it is created.
    pub(super) place: OnceLock<SessionPlace>,
    phase: watch::Sender<Phase>,
    known: Mutex<Known>,
    pub(super) events: Arc<EventLog>,
    pub(super) recording: Arc<SessionRecording>,
    /// Server's clock, nanoseconds: what callers are told.
    last_used_ns: AtomicI64,
    /// The same by a clock that nobody sets, milliseconds since the process began: what sleep goes by.
    last_used_ms: AtomicU64,
    /// Somebody deletes it: nobody finds it any more.
    doomed: AtomicBool,
    /// Why the last deletion was not done.
    deletion_error: Mutex<Option<Error>>,
    /// Held by whoever has the session's store open.
    pub(super) storing: Arc<tokio::sync::Mutex<()>>,
    /// Of its store, when it was last opened here; 0 if it was not.
    epoch: AtomicU64,
    /// The life of this node in which it was last claimed; so that a node that lost its claims claims anew.
    pub(super) claimed_in: AtomicU64,
    /// When its pipeline failed, the newest last.
    failures: Mutex<Vec<i64>>,
    /// Held while its summary is written: the newest is written last.
    pub(super) noting: tokio::sync::Mutex<()>,
}

impl Slot {
    pub(super) fn new(
        id: &str,
        phase: Phase,
        known: Known,
        events: EventLog,
        recordings: &Arc<Recordings>,
    ) -> Arc<Self> {
        observe::session_moved(None, Some(phase.state()));
        Arc::new(Self {
            id: id.to_owned(),
            place: OnceLock::new(),
            phase: watch::channel(phase).0,
            recording: SessionRecording::of(recordings, &known.tenant, id),
            known: Mutex::new(known),
            events: Arc::new(events),
            last_used_ns: AtomicI64::new(crate::clock::now_ns()),
            last_used_ms: AtomicU64::new(uptime_ms()),
            epoch: AtomicU64::new(0),
            doomed: AtomicBool::new(false),
            deletion_error: Mutex::default(),
            storing: Arc::default(),
            claimed_in: AtomicU64::new(0),
            failures: Mutex::default(),
            noting: tokio::sync::Mutex::default(),
        })
    }

    pub(super) fn phase(&self) -> Phase {
        self.phase.borrow().clone()
    }

    pub(super) fn set(&self, phase: Phase) {
        let now = phase.state();
        let is_gone = matches!(phase, Phase::Gone(_));
        let before = self.phase.send_replace(phase).state();
        self.moved(before, now, is_gone);
    }

    fn moved(&self, from: SessionState, to: SessionState, is_gone: bool) {
        observe::session_moved(Some(from), Some(to));
        if let Some(fleet) = self.events.fleet() {
            fleet.moved(from, to, is_gone);
        }
    }

    /// Takes the next step if `step` gives one for the phase as it is; whether it did.
    pub(super) fn step(&self, step: impl FnOnce(&Phase) -> Option<Phase>) -> bool {
        self.phase.send_if_modified(|phase| match step(phase) {
            Some(next) => {
                self.moved(phase.state(), next.state(), matches!(next, Phase::Gone(_)));
                *phase = next;
                true
            }
            None => false,
        })
    }

    /// Waits for a phase that fits.
    pub(super) async fn until(&self, fits: impl FnMut(&Phase) -> bool) -> Phase {
        let mut phases = self.phase.subscribe();
        // The sender is this slot's own, which is borrowed: it cannot be gone.
        let found = phases.wait_for(fits).await;
        found.map_or_else(|_| Phase::Gone(Ok(())), |phase| phase.clone())
    }

    pub(super) fn known(&self) -> Known {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn update_known(&self, change: impl FnOnce(&mut Known)) {
        change(&mut self.known.lock().unwrap_or_else(PoisonError::into_inner));
    }

    pub(super) fn touch(&self) {
        self.last_used_ns.store(crate::clock::now_ns(), Ordering::Relaxed);
        self.last_used_ms.store(uptime_ms(), Ordering::Relaxed);
    }

    /// How long nobody has used it, milliseconds.
    pub(super) fn unused_ms(&self) -> u64 {
        uptime_ms().saturating_sub(self.last_used_ms.load(Ordering::Relaxed))
    }

    /// Notes an opening of its store; whether somebody else has opened it since the last one here.
    pub(super) fn opened_as(&self, epoch: u64) -> bool {
        let last = self.epoch.swap(epoch, Ordering::SeqCst);
        last != 0 && epoch != last + 1
    }

    pub(super) fn last_used_ns(&self) -> i64 {
        self.last_used_ns.load(Ordering::Relaxed)
    }

    /// Claims the deletion; false if somebody else has.
    pub(super) fn doom(&self) -> bool {
        !self.doomed.swap(true, Ordering::SeqCst)
    }

    pub(super) fn spare(&self) {
        self.doomed.store(false, Ordering::SeqCst);
    }

    pub(super) fn is_doomed(&self) -> bool {
        self.doomed.load(Ordering::SeqCst)
    }

    pub(super) fn set_deletion_error(&self, error: Error) {
        *self.deletion_error.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
    }

    pub(super) fn deletion_error(&self) -> Option<Error> {
        self.deletion_error.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Notes that the pipeline failed; how often it did within `window_ns`.
    pub(super) fn failed(&self, window_ns: i64) -> usize {
        let now = crate::clock::now_ns();
        let mut failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
        failures.retain(|at| now - at < window_ns);
        failures.push(now);
        failures.len()
    }
}

fn uptime_ms() -> u64 {
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    u64::try_from(BEGAN.get_or_init(Instant::now).elapsed().as_millis()).unwrap_or(u64::MAX)
}

impl Drop for Slot {
    fn drop(&mut self) {
        observe::session_moved(Some(self.phase.borrow().state()), None);
    }
}

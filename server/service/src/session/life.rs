//! The steps of a session's life, each a task of its own that no caller can break off.

use super::actor::{Ending, start};
use super::event::EventKind;
use super::fault::{Fault, Trouble, store_error};
use super::handle::Session;
use super::meta::SessionMeta;
use super::persist::Persister;
use super::recording::{Recording, RecordingEnd};
use super::records::{Counts, MetaRecord, SummaryRecord, json};
use super::recover::recover;
use super::registry::Registry;
use super::scratch::Scratch;
use super::sharing::Unclaimed;
use super::slot::{Phase, Slot};
use super::writer::{GRACE, Writer, collect_garbage};
use crate::reason;
use crate::{Error, Result, observe};
use percept_geometry::Timestamp;
use percept_scene::ObjectState;
use percept_store::{SessionPlace, Store};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A pipeline that fails so often within [`FAILURE_WINDOW_NS`] is not tried any more.
const MOST_FAILURES: usize = 3;
const FAILURE_WINDOW_NS: i64 = 600 * 1_000_000_000;
/// Time that a session may take to store its last frames before it is left awake.
const RETIRE_PATIENCE: Duration = Duration::from_secs(10);
/// Time that an ended recording's last bytes may take: a disk that hangs holds no session.
const RECORDING_PATIENCE: Duration = Duration::from_secs(10);
/// Tries to remove what a deleted session has left, and the pause between them.
const PURGE_TRIES: u32 = 5;
const PURGE_PAUSE: Duration = Duration::from_secs(2);

impl Registry {
    /// Writes a new session's catalogue entry. The slot is in the registry already.
    pub(super) async fn bring_to_life(self: Arc<Self>, slot: Arc<Slot>, meta: SessionMeta) {
        let created = async {
            let record = json(&MetaRecord::of(&meta)?)?;
            match self.root.create(&slot.id, &record).await {
                Err(percept_store::StoreError::AlreadyExists { .. }) => self.created_before(&meta).await,
                created => created.map_err(|e| store_error(&e)),
            }
        };
        match created.await {
            Ok(place) => {
                let _ = slot.place.set(place);
                slot.update_known(|known| known.counts = Some(Counts::default()));
                slot.set(Phase::Asleep(None));
            }
            Err(error) => {
                self.remove(&slot);
                slot.set(Phase::Gone(Err(error)));
            }
        }
    }

    /// Reads a session from the store. The slot is `Waking`.
    pub(super) async fn wake(self: Arc<Self>, slot: Arc<Slot>) {
        let Ok(_turn) = self.waking.acquire().await else {
            return slot.set(Phase::Asleep(Some(super::registry::stopping())));
        };
        let began = Instant::now();
        let woken = tokio::spawn(Arc::clone(&self).read(Arc::clone(&slot))).await;
        let outcome =
            woken.unwrap_or_else(|panic| Err(Trouble::Lasting(Fault::new(reason::NOT_RESTORABLE, panic.to_string()))));
        let phase = match outcome {
            Ok(phase) => phase,
            Err(Trouble::Lasting(fault)) => {
                tracing::error!(session = slot.id, reason = fault.reason, fault.message, "session set apart");
                Phase::Faulted(fault, None)
            }
            Err(trouble) => Phase::Asleep(Some(trouble.error())),
        };
        let outcome = match &phase {
            Phase::Faulted(fault, _) => {
                observe::session_faulted(fault.reason);
                Err(fault.reason)
            }
            Phase::Asleep(Some(error)) => Err(error.reason),
            _ => Ok(()),
        };
        observe::session_woken(began.elapsed(), outcome);
        if let Phase::Gone(_) = phase {
            tracing::info!(session = slot.id, place = ?slot.place.get(), "a session was deleted elsewhere before it woke");
            self.remove(&slot);
            slot.events.close();
        }
        slot.set(phase);
        self.check_claim(&slot).await;
    }

    async fn read(self: Arc<Self>, slot: Arc<Slot>) -> std::result::Result<Phase, Trouble> {
        let (place, created) = match self.claim(&slot).await {
            Ok(claimed) => claimed,
            Err(Unclaimed::Gone) => return Ok(Phase::Gone(Ok(()))),
            Err(Unclaimed::Trouble(trouble)) => return Err(trouble),
        };
        let read = self.read_claimed(&slot, &place, created).await;
        if !matches!(read, Ok(Phase::Awake(_))) {
            self.release(&slot).await;
        }
        read
    }

    async fn read_claimed(
        self: &Arc<Self>,
        slot: &Arc<Slot>,
        place: &SessionPlace,
        created: MetaRecord,
    ) -> std::result::Result<Phase, Trouble> {
        let storing = Arc::clone(&slot.storing).lock_owned().await;
        let store: Arc<dyn Store> = Arc::new(self.root.open_session(place).await?);
        let is_another = slot.opened_as(store.epoch());
        let scratch = Scratch::in_directory(self.root.directory(), &self.room);
        let recovered =
            match recover(Arc::clone(&store), (&self.compute, &self.shelf), created, &self.defaults, scratch).await {
                Ok(recovered) => recovered,
                Err(trouble) => {
                    let _ = store.close().await;
                    return Err(trouble);
                }
            };
        let (meta, stored, scratch) = (recovered.meta, recovered.stored, recovered.scratch);
        let state = stored.state.clone();
        let events = Arc::clone(&slot.events);
        if let Some(fault) = recovered.damage {
            tracing::error!(
                session = slot.id,
                reason = fault.reason,
                fault.message,
                "session set apart; what is whole can be read"
            );
            let _ = store.close().await;
            let session = Session::read_only(meta, &recovered.pipeline, &state, fault.clone(), &self.limits, events);
            return Ok(Phase::Faulted(fault, Some(session)));
        }
        // Before the first frame stores its scan.
        let mark = store.mark();
        let persister = Persister::start(Writer::new(Arc::clone(&store), stored), &state);
        let (compute, specs) = (self.compute.clone(), meta.sensors.iter().map(|s| &s.spec));
        let recording = Recording::of(&slot.recording, specs);
        let kept = (persister, scratch, recording);
        let (session, actor) = start(meta, recovered.pipeline, &state, kept, compute, &self.limits, events);
        let attended = Arc::clone(self).attend(Arc::clone(slot), Arc::clone(&session), actor, Arc::clone(&store));
        tokio::spawn(async move {
            attended.await;
            drop(storing);
        });
        tokio::spawn(async move {
            if let Err(error) = collect_garbage(store.as_ref(), mark, GRACE).await {
                tracing::debug!(?error, "scans that nobody needs were not looked for");
            }
        });
        self.note(slot, &session);
        if is_another {
            // It went on elsewhere since it was here: watchers read it anew.
            slot.events.publish(Timestamp::default(), [EventKind::Resync(0)]);
        }
        Ok(Phase::Awake(session))
    }

    /// Runs a session's actor and does what its end asks for.
    pub(super) async fn attend(
        self: Arc<Self>,
        slot: Arc<Slot>,
        session: Arc<Session>,
        actor: impl Future<Output = Ending> + Send + 'static,
        store: Arc<dyn Store>,
    ) {
        let ending = match tokio::spawn(actor).await {
            Ok(ending) => ending,
            Err(panic) => {
                tracing::error!(session = slot.id, %panic, "a session's actor failed");
                Ending::Panicked
            }
        };
        slot.recording.end(RecordingEnd::Slept, RECORDING_PATIENCE).await;
        self.note(&slot, &session);
        if !matches!(ending, Ending::Discarded) {
            self.write_summary(&slot, &session).await;
        }
        if let Err(error) = store.close().await {
            tracing::warn!(session = slot.id, %error, "a session's store did not close cleanly; what was acknowledged is safe");
        }
        self.release(&slot).await;
        if !matches!(ending, Ending::Retired) && !slot.is_doomed() {
            // It goes on from what is stored, which may be less than what was told: watchers read the state anew.
            slot.events.publish(Timestamp::default(), [EventKind::Resync(0)]);
        }
        let next = match ending {
            Ending::Retired | Ending::Discarded => Phase::Asleep(None),
            Ending::Panicked if slot.failed(FAILURE_WINDOW_NS) >= MOST_FAILURES => {
                let fault = Fault::new(
                    reason::PIPELINE_FAILED,
                    "its pipeline failed again and again; the server's log has the cause",
                );
                Phase::Faulted(fault, Some(session))
            }
            Ending::Panicked => Phase::Asleep(None),
            Ending::Unstorable(Trouble::Lasting(fault)) => Phase::Faulted(fault, Some(session)),
            Ending::Unstorable(trouble) => Phase::Asleep(Some(trouble.error())),
        };
        if let Phase::Faulted(fault, Some(session)) = &next {
            tracing::error!(session = slot.id, reason = fault.reason, fault.message, "session set apart");
            session.set_apart(fault.clone());
        }
        // A deletion has its own end; one that is not done puts the session back as it found it, and this one has ended.
        slot.until(|phase| !matches!(phase, Phase::Deleting)).await;
        slot.step(|phase| matches!(phase, Phase::Awake(_) | Phase::Retiring(_)).then_some(next));
    }

    /// Puts a session to sleep, if it is awake and what it has taken in can be stored.
    ///
    /// # Errors
    /// Why it was not stored; it is awake still.
    pub(super) async fn retire(
        self: &Arc<Self>,
        slot: &Arc<Slot>,
        patience: Duration,
    ) -> std::result::Result<(), Trouble> {
        let mut taken = None;
        let begun = slot.step(|phase| match phase {
            Phase::Awake(session) => {
                taken = Some(Arc::clone(session));
                Some(Phase::Retiring(Arc::clone(session)))
            }
            _ => None,
        });
        let Some(session) = taken.filter(|_| begun) else { return Ok(()) };
        let retired = session.retire(patience).await;
        match &retired {
            Ok(()) => {
                observe::session_slept();
                drop(session);
                slot.until(|phase| !matches!(phase, Phase::Retiring(_))).await;
                if matches!(slot.phase(), Phase::Asleep(_)) {
                    slot.events.forget();
                }
            }
            Err(trouble) => {
                tracing::warn!(session = slot.id, ?trouble, "a session stays awake: its last frames cannot be stored");
                slot.step(|phase| matches!(phase, Phase::Retiring(_)).then(|| Phase::Awake(Arc::clone(&session))));
            }
        }
        retired
    }

    /// Puts a session to sleep in the background.
    pub(super) fn retire_soon(self: &Arc<Self>, slot: &Arc<Slot>) {
        let (this, slot) = (Arc::clone(self), Arc::clone(slot));
        tokio::spawn(async move {
            let _ = this.retire(&slot, RETIRE_PATIENCE).await;
        });
    }

    /// Ends a session: first its end is written down, then all else goes. The slot is doomed already.
    pub(super) async fn end(self: Arc<Self>, slot: Arc<Slot>) {
        let mut before = None;
        loop {
            if let Phase::Gone(_) = slot.until(Phase::is_settled).await {
                return;
            }
            let begun = slot.step(|phase| {
                let may = phase.is_settled() && !matches!(phase, Phase::Gone(_));
                may.then(|| {
                    before = Some(phase.clone());
                    Phase::Deleting
                })
            });
            if begun {
                break;
            }
        }
        let before = before.unwrap_or(Phase::Asleep(None));
        let buried = match slot.place.get() {
            Some(place) => self.bury(place).await,
            None => Ok(()),
        };
        if let Err(error) = buried {
            slot.spare();
            self.fail_deletion(&slot, before, &store_error(&error));
            return;
        }
        if let Phase::Awake(session) = &before {
            session.discard().await;
        }
        drop(before);
        self.remove(&slot);
        slot.events.close();
        slot.set(Phase::Gone(Ok(())));
        // What is still being written would be left over.
        drop(slot.storing.lock().await);
        if let Some(place) = slot.place.get() {
            self.purge(place).await;
        }
    }

    /// Writes down that a session is gone. Once that is decided it is tried until it is written: a session must not go on,
    /// and be gone all the same at the next start.
    async fn bury(&self, place: &SessionPlace) -> std::result::Result<(), percept_store::StoreError> {
        loop {
            let Err(error) = self.root.bury(place).await else { return Ok(()) };
            if !self.root.is_decided(place).await {
                return Err(error);
            }
            tracing::warn!(session = place.id(), %error, "a deletion is not written down yet");
            tokio::time::sleep(PURGE_PAUSE).await;
        }
    }

    fn fail_deletion(&self, slot: &Slot, before: Phase, error: &Error) {
        tracing::warn!(session = slot.id, %error, "a session was not deleted");
        slot.set_deletion_error(error.clone());
        slot.set(before);
    }

    /// Removes what a deleted session has left; what does not go now goes at the next start.
    pub(super) async fn purge(&self, place: &SessionPlace) {
        for attempt in 1..=PURGE_TRIES {
            match self.root.purge(place).await {
                Ok(()) => return,
                Err(error) => {
                    tracing::warn!(session = place.id(), attempt, %error, "a deleted session's data are still there")
                }
            }
            tokio::time::sleep(PURGE_PAUSE * attempt).await;
        }
    }

    /// Notes what a session has gathered, for the time when it sleeps; whether what callers set is another than was noted.
    pub(super) fn note(&self, slot: &Slot, session: &Session) -> bool {
        let (meta, counts) = (session.meta(), counts(session));
        let mut is_new = false;
        slot.update_known(|known| {
            is_new = known.revision != meta.revision;
            known.display_name = meta.display_name;
            known.labels = meta.labels;
            known.revision = meta.revision;
            known.counts = Some(counts);
        });
        is_new
    }

    /// Notes it durably; a failure costs no more than older figures in a list.
    pub(super) async fn write_summary(&self, slot: &Slot, session: &Session) {
        let Some(place) = slot.place.get() else { return };
        let _newest_last = slot.noting.lock().await;
        let written: Result<()> = async {
            let (last_stamps, frame_counts) = session.streams();
            let meta = MetaRecord::of(&session.meta())?;
            let summary = SummaryRecord { meta, counts: counts(session), last_stamps, frame_counts };
            self.root.set_summary(place, json(&summary)?).await.map_err(|e| store_error(&e))
        }
        .await;
        if let Err(error) = written {
            tracing::warn!(session = slot.id, %error, "a session's summary was not written");
        }
    }
}

/// How much a session has gathered.
pub(super) fn counts(session: &Session) -> Counts {
    let snapshot = session.snapshot();
    Counts {
        num_keyframes: snapshot.living_keyframes().count() as u64,
        num_objects: snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone).count() as u64,
        map_version: snapshot.map_version,
        last_stamp_ns: snapshot.pose.as_ref().map_or(0, |p| p.stamp.nanos()),
    }
}

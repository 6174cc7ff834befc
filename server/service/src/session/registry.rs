//! Which sessions there are, and how to get hold of one; the steps of their lives are elsewhere.

use super::events::EventLog;
use super::fault::{Fault, store_error};
use super::fleet::{FleetLink, FleetLog};
use super::handle::Session;
use super::meta::{SessionMeta, SessionMode};
use super::recordings::{RecordingSettings, Recordings};
use super::records::{Counts, MetaRecord, parse};
use super::shelf::{OwnDetectors, Shelf};
use super::slot::{Known, Phase, Slot};
use crate::reason;
use crate::{ComputePool, Error, ErrorCode, Limits, Result};
use percept_pipeline::PipelineParams;
use percept_store::{CatalogueEntry, DataRoot, SessionPlace};
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use tokio::sync::Semaphore;

/// Sessions that wake at a time; more wait their turn.
const WAKES_AT_ONCE: usize = 4;
/// Time that a session may take to store its last frames when the server stops.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

pub(crate) struct Registry {
    pub(super) root: DataRoot,
    pub(super) compute: ComputePool,
    pub(super) limits: Arc<Limits>,
    pub(super) defaults: PipelineParams,
    pub(super) recordings: Arc<Recordings>,
    /// Learned detectors that sessions may use.
    pub(crate) shelf: Arc<Shelf>,
    pub(super) waking: Semaphore,
    /// Of the events of sessions that were there before this process.
    first_token: u64,
    /// Bytes that each session may take now.
    pub(super) room: Arc<AtomicUsize>,
    /// What happens in all sessions.
    pub(crate) fleet: Arc<FleetLog>,
    sessions: RwLock<Sessions>,
}

#[derive(Default)]
pub(super) struct Sessions {
    pub(super) by_id: BTreeMap<String, Arc<Slot>>,
    /// Tenant and request id to session id.
    by_request: HashMap<(String, String), String>,
    /// How many.
    by_tenant: HashMap<String, usize>,
    is_stopping: bool,
}

impl Registry {
    /// Reads the catalogue. Sessions found there sleep until they are used; the places of those whose deletion broke off.
    pub(super) async fn of_catalogue(
        root: DataRoot,
        compute: ComputePool,
        limits: Arc<Limits>,
        (defaults, recordings): (PipelineParams, RecordingSettings),
        detectors: OwnDetectors,
    ) -> Result<(Arc<Self>, Vec<SessionPlace>)> {
        let first_token = token_above_all();
        let waking = Semaphore::new(WAKES_AT_ONCE);
        let fleet = Arc::new(FleetLog::starting_at(first_token, limits.fleet_event_history));
        let sessions = RwLock::default();
        let (shelf, recordings) = (Arc::new(Shelf::new(detectors)), Recordings::of(recordings));
        let room = Arc::new(AtomicUsize::new(limits.max_session_memory_mb << 20));
        let registry =
            Self { root, compute, limits, defaults, recordings, shelf, waking, first_token, room, fleet, sessions };
        let mut buried = Vec::new();
        let take_in = |entry| match entry {
            CatalogueEntry::Deleted { place } => buried.push(place),
            CatalogueEntry::Created { place, record } => registry.take_in(place, &record),
            CatalogueEntry::Damaged { place } => registry.take_in_damaged(place),
        };
        registry.root.for_each(take_in).await.map_err(|e| store_error(&e))?;
        Ok((Arc::new(registry), buried))
    }

    /// Makes a session known that the catalogue has, unless its id is known already.
    pub(super) fn take_in(&self, place: SessionPlace, record: &[u8]) {
        match parse::<MetaRecord>("the catalogue entry", record) {
            Ok(record) => self.insert(place, Phase::Asleep(None), known(&record)),
            Err(error) => self.insert(place, unreadable(&error), Known::nothing()),
        }
    }

    /// The same for one whose entry cannot be read.
    pub(super) fn take_in_damaged(&self, place: SessionPlace) {
        self.insert(place, unreadable(&"its catalogue entry cannot be read"), Known::nothing());
    }

    fn insert(&self, place: SessionPlace, phase: Phase, known: Known) {
        let link = FleetLink::new(&self.fleet, place.id(), &known.tenant);
        let events = EventLog::starting_at(self.first_token, self.limits.event_history).told_to(link);
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        if !sessions.by_id.contains_key(place.id()) {
            let slot = Slot::new(place.id(), phase, known, events, &self.recordings);
            let _ = slot.place.set(place);
            sessions.add(&slot);
        }
    }

    pub(crate) fn defaults(&self) -> &PipelineParams {
        &self.defaults
    }

    /// The slot of an id, even of a session that is being deleted.
    pub(super) fn slot(&self, id: &str) -> Option<Arc<Slot>> {
        self.read_sessions().by_id.get(id).cloned()
    }

    pub(super) fn find(&self, id: &str) -> Result<Arc<Slot>> {
        self.slot(id).filter(|slot| !slot.is_doomed()).ok_or_else(|| not_found(id))
    }

    /// Waits until it is decided whether a session that somebody deletes is gone: who was told so must not see it again,
    /// not even after a crash.
    pub(crate) async fn decided(&self, id: &str) {
        if let Some(slot) = self.slot(id).filter(|slot| slot.is_doomed()) {
            slot.until(|phase| matches!(phase, Phase::Gone(_)) || !slot.is_doomed()).await;
        }
    }

    /// Whose a session is, if there is one.
    pub(crate) fn tenant(&self, id: &str) -> Option<String> {
        self.find(id).ok().map(|slot| slot.known().tenant)
    }

    /// Sessions of a tenant, by id, those that are being deleted left out.
    pub(super) fn ids_of(&self, tenant: &str) -> Vec<String> {
        let own = self.slots().into_iter().filter(|slot| !slot.is_doomed() && slot.known().tenant == tenant);
        own.map(|slot| slot.id.clone()).collect()
    }

    /// To be held while a session begins to name a learned detector, so that it is not deleted meanwhile; none if it names none.
    pub(crate) async fn naming(&self, is_named: bool) -> Option<tokio::sync::RwLockReadGuard<'_, ()>> {
        if !is_named {
            return None;
        }
        self.refresh_detectors().await;
        Some(self.shelf.naming.read().await)
    }

    /// All slots, in the order of ids.
    pub(super) fn slots(&self) -> Vec<Arc<Slot>> {
        self.read_sessions().by_id.values().cloned().collect()
    }

    /// The session, woken if it slept. A caller who leaves does not stop the waking.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `SESSION_FAULTED`; faults of the storage.
    pub(crate) async fn get(self: &Arc<Self>, id: &str) -> Result<Arc<Session>> {
        let mut has_waited = false;
        // The same one throughout: another of this id may be another tenant's.
        let slot = self.find(id)?;
        loop {
            if slot.is_doomed() {
                slot.until(|phase| matches!(phase, Phase::Gone(_)) || !slot.is_doomed()).await;
            }
            slot.touch();
            match slot.phase() {
                Phase::Awake(session) | Phase::Faulted(_, Some(session)) => return Ok(session),
                Phase::Faulted(fault, None) => return Err(fault.error()),
                Phase::Asleep(Some(error)) if has_waited => return Err(error),
                Phase::Gone(_) => return Err(not_found(id)),
                Phase::Asleep(_) => {
                    if self.read_sessions().is_stopping {
                        return Err(stopping());
                    }
                    if slot.step(|phase| matches!(phase, Phase::Asleep(_)).then_some(Phase::Waking)) {
                        tokio::spawn(Arc::clone(self).wake(Arc::clone(&slot)));
                    }
                    has_waited = true;
                }
                Phase::Creating | Phase::Waking | Phase::Retiring(_) | Phase::Deleting => {}
            }
            slot.until(Phase::is_settled).await;
        }
    }

    /// Waits until a session whose actor has ended is no longer given out: asking again before would find the same one.
    pub(crate) async fn left(&self, id: &str, session: &Arc<Session>) {
        if let Ok(slot) = self.find(id) {
            slot.until(|phase| !matches!(phase, Phase::Awake(there) if Arc::ptr_eq(there, session))).await;
        }
    }

    /// The events of a session, awake or not: watching does not keep it awake.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub(crate) fn events(&self, id: &str) -> Result<Arc<EventLog>> {
        Ok(Arc::clone(&self.find(id)?.events))
    }

    /// Creates a session, durably; it sleeps until it is used. The same request id gives the session of the first call. A
    /// caller who leaves does not stop it.
    ///
    /// # Errors
    /// `SESSION_EXISTS`, `TOO_MANY_SESSIONS` of the server or of the tenant; faults of the storage.
    pub(crate) async fn create(self: &Arc<Self>, meta: SessionMeta) -> Result<String> {
        loop {
            let slot = match self.reserve(&meta)? {
                Reserved::New(slot) => {
                    tokio::spawn(Arc::clone(self).bring_to_life(Arc::clone(&slot), meta.clone()));
                    slot
                }
                Reserved::Before(slot) => slot,
                Reserved::Leaving(slot) => {
                    slot.until(|phase| matches!(phase, Phase::Gone(_)) || !slot.is_doomed()).await;
                    continue;
                }
            };
            return match slot.until(|phase| !matches!(phase, Phase::Creating)).await {
                Phase::Gone(outcome) => outcome.and_then(|()| Err(not_found(&slot.id))),
                _ => Ok(slot.id.clone()),
            };
        }
    }

    /// Takes an id and a request id in one step.
    fn reserve(&self, meta: &SessionMeta) -> Result<Reserved> {
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        if sessions.is_stopping {
            return Err(stopping());
        }
        let request = (meta.tenant.clone(), meta.request_id.clone());
        let before = (!request.1.is_empty()).then(|| sessions.by_request.get(&request)).flatten();
        if let Some(slot) = before.and_then(|id| sessions.by_id.get(id)) {
            let slot = Arc::clone(slot);
            return Ok(if slot.is_doomed() { Reserved::Leaving(slot) } else { Reserved::Before(slot) });
        }
        if let Some(slot) = sessions.by_id.get(&meta.id) {
            return if slot.is_doomed() { Ok(Reserved::Leaving(Arc::clone(slot))) } else { Err(exists(&meta.id)) };
        }
        if sessions.by_id.len() >= self.limits.max_sessions {
            let message = format!("this server holds {} sessions, its limit; delete some", sessions.by_id.len());
            return Err(Error::exhausted(reason::TOO_MANY_SESSIONS, "", message));
        }
        let (own, most) = (sessions.of_tenant(&meta.tenant), self.compute.admission().max_sessions(&meta.tenant));
        if most > 0 && own >= most {
            let message = format!("the tenant holds {own} sessions, its quota; delete some");
            return Err(Error::exhausted(reason::TOO_MANY_SESSIONS, "", message));
        }
        let known = Known {
            tenant: meta.tenant.clone(),
            display_name: meta.display_name.clone(),
            labels: meta.labels.clone(),
            revision: meta.revision,
            request_id: meta.request_id.clone(),
            create_time_ns: meta.create_time_ns,
            is_ingest_only: meta.mode == SessionMode::IngestOnly,
            counts: Some(Counts::default()),
        };
        let link = FleetLink::new(&self.fleet, &meta.id, &meta.tenant);
        // Nobody resumes from a token of another session of that name: one that was deleted, or that other servers tell of.
        let first = token_above_all();
        let events = EventLog::beginning_at(first, self.limits.event_history).told_to(link);
        let slot = Slot::new(&meta.id, Phase::Creating, known, events, &self.recordings);
        sessions.add(&slot);
        Ok(Reserved::New(slot))
    }

    /// Takes a slot out, unless another one has taken its place.
    pub(super) fn remove(&self, slot: &Arc<Slot>) {
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        if sessions.by_id.get(&slot.id).is_some_and(|there| Arc::ptr_eq(there, slot)) {
            sessions.by_id.remove(&slot.id);
            let known = slot.known();
            if let Some(count) = sessions.by_tenant.get_mut(&known.tenant) {
                *count -= 1;
                if *count == 0 {
                    sessions.by_tenant.remove(&known.tenant);
                }
            }
            sessions.by_request.remove(&(known.tenant, known.request_id));
        }
    }

    /// Deletes a session. It is gone, durably, when this returns; what it stored goes soon after. A caller who leaves does
    /// not stop it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, faults of the storage.
    pub(crate) async fn delete(self: &Arc<Self>, id: &str) -> Result<()> {
        let slot = self.slot(id).ok_or_else(|| not_found(id))?;
        while !slot.doom() {
            // Somebody else deletes it; that may fail.
            if let Phase::Gone(_) = slot.until(|phase| matches!(phase, Phase::Gone(_)) || !slot.is_doomed()).await {
                return Err(not_found(id));
            }
        }
        tokio::spawn(Arc::clone(self).end(Arc::clone(&slot)));
        let end = slot.until(|phase| matches!(phase, Phase::Gone(_)) || !slot.is_doomed()).await;
        match end {
            Phase::Gone(outcome) => outcome,
            _ => Err(slot.deletion_error().unwrap_or_else(|| Error::internal("a deletion failed without a reason"))),
        }
    }

    /// Stores what every session has taken in and ends them, all at once.
    ///
    /// # Errors
    /// The last fault, if something that was accepted could not be stored.
    pub(crate) async fn stop(self: &Arc<Self>) -> Result<()> {
        self.sessions.write().unwrap_or_else(PoisonError::into_inner).is_stopping = true;
        let slots = self.slots();
        let ends = slots.iter().map(|slot| async {
            // What is being read, created or deleted has nothing in memory that was acknowledged.
            if tokio::time::timeout(STOP_PATIENCE, slot.until(Phase::is_settled)).await.is_err() {
                tracing::warn!(session = slot.id, "the storage did not let a session come to rest");
            }
            let retired = self.retire(slot, STOP_PATIENCE).await;
            slot.events.close();
            retired.map_err(|trouble| trouble.error())
        });
        let ends = futures::future::join_all(ends).await;
        self.fleet.close();
        if let Err(error) = self.root.leave().await {
            tracing::warn!(%error, "other servers learn only by its silence that this one is gone");
        }
        ends.into_iter().filter_map(Result::err).next_back().map_or(Ok(()), Err)
    }

    pub(super) fn read_sessions(&self) -> std::sync::RwLockReadGuard<'_, Sessions> {
        self.sessions.read().unwrap_or_else(PoisonError::into_inner)
    }
}

enum Reserved {
    /// To be created by the caller.
    New(Arc<Slot>),
    /// Created by an earlier call with the same request id.
    Before(Arc<Slot>),
    /// On its way out: wait, then try again.
    Leaving(Arc<Slot>),
}

impl Sessions {
    fn of_tenant(&self, tenant: &str) -> usize {
        self.by_tenant.get(tenant).copied().unwrap_or_default()
    }

    fn add(&mut self, slot: &Arc<Slot>) {
        let known = slot.known();
        *self.by_tenant.entry(known.tenant.clone()).or_default() += 1;
        if !known.request_id.is_empty() {
            self.by_request.insert((known.tenant, known.request_id), slot.id.clone());
        }
        self.by_id.insert(slot.id.clone(), Arc::clone(slot));
    }
}

impl Known {
    /// Of a session whose catalogue entry cannot be read.
    fn nothing() -> Self {
        let tenant = super::meta::DEFAULT_TENANT.to_owned();
        let (display_name, request_id) = (String::new(), String::new());
        let (labels, revision, create_time_ns) = (BTreeMap::new(), 0, 0);
        Self { tenant, display_name, labels, revision, request_id, create_time_ns, is_ingest_only: false, counts: None }
    }
}

fn known(record: &MetaRecord) -> Known {
    Known {
        tenant: record.tenant.clone(),
        display_name: record.display_name.clone(),
        labels: record.labels.clone(),
        revision: record.revision,
        request_id: record.request_id.clone(),
        create_time_ns: record.create_time_ns,
        is_ingest_only: record.mode == SessionMode::IngestOnly,
        counts: None,
    }
}

fn unreadable(why: &dyn std::fmt::Display) -> Phase {
    Phase::Faulted(Fault::new(reason::DATA_DAMAGED, why.to_string()), None)
}

pub(super) fn exists(id: &str) -> Error {
    let message = format!("session_id {id:?} exists; choose another, or use it");
    let code = ErrorCode::AlreadyExists;
    Error { field: "session_id".to_owned(), ..Error::new(code, reason::SESSION_EXISTS, message) }
}

pub(super) fn stopping() -> Error {
    Error::new(ErrorCode::Unavailable, reason::STOPPING, "the server is stopping; try again")
}

pub(crate) fn not_found(id: &str) -> Error {
    let shown: String = id.chars().take(80).collect();
    Error::not_found(
        reason::SESSION_NOT_FOUND,
        "session_id",
        format!("session_id {shown:?} does not exist; create it, or list the sessions"),
    )
}

/// Above every token given before: events come far slower than one a microsecond.
fn token_above_all() -> u64 {
    u64::try_from(crate::clock::now_ns() / 1000).unwrap_or(1).max(1)
}

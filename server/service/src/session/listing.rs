//! What is said of sessions without waking them: one, a page, all.

use super::fault::{Fault, Trouble, store_error};
use super::handle::Session;
use super::meta::{SessionMeta, SessionMode};
use super::recording::RecordingStatus;
use super::records::{Counts, MetaRecord, StateRecord, SummaryRecord, parse};
use super::registry::{Registry, not_found};
use super::sensor_book::SensorStatus;
use super::slot::{Phase, Slot};
use super::state::SessionState;
use crate::{Result, reason};
use futures::stream::StreamExt;
use percept_store::{CatalogueEntry, SessionPlace, keys};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Summaries read at a time for a page of a list: each read of a local file takes a thread.
const READS_AT_ONCE: usize = 8;

/// What can be said of a session without waking it.
#[derive(Clone)]
pub struct SessionView {
    /// Its id.
    pub id: String,
    /// Whose it is.
    pub tenant: String,
    /// For people.
    pub display_name: String,
    /// For programs.
    pub labels: BTreeMap<String, String>,
    /// Names the state of what callers set.
    pub etag: String,
    /// What it does with frames.
    pub mode: SessionMode,
    /// Server's clock, nanoseconds since the Unix epoch.
    pub create_time_ns: i64,
    /// Where it is in its life.
    pub state: SessionState,
    /// Why it is set apart.
    pub fault: Option<Fault>,
    /// What it has gathered; of one that sleeps as it was when it last fell asleep.
    pub counts: Counts,
    /// Server's clock, nanoseconds since the Unix epoch: when it was last used, by this process.
    pub last_used_ns: i64,
    /// How it is recorded.
    pub recording: RecordingStatus,
    /// The session, if it is in memory.
    pub live: Option<Arc<Session>>,
}

impl Registry {
    /// What can be said of a session without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub(crate) async fn view(&self, id: &str) -> Result<SessionView> {
        let slot = self.find(id)?;
        self.read_counts(&slot).await;
        Ok(view(&slot))
    }

    /// What a session was created with and what was changed since, without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `SESSION_FAULTED` if that cannot be read; faults of the storage.
    pub(crate) async fn meta(&self, id: &str) -> Result<SessionMeta> {
        let slot = self.find(id)?;
        match view(&slot).live {
            Some(session) => Ok(session.meta()),
            None => Ok(self.stored_meta(id, &slot).await?.0),
        }
    }

    /// Health of every sensor, without waking it.
    ///
    /// # Errors
    /// As [`Registry::meta`].
    pub(crate) async fn sensors(&self, id: &str) -> Result<Vec<SensorStatus>> {
        let slot = self.find(id)?;
        if let Some(session) = view(&slot).live {
            return Ok(session.sensors());
        }
        let (meta, state) = self.stored_meta(id, &slot).await?;
        Ok(meta.sensors.into_iter().map(|declaration| SensorStatus::stored(declaration, &state)).collect())
    }

    /// What a session that sleeps was created with, and how far its streams have come.
    async fn stored_meta(&self, id: &str, slot: &Slot) -> Result<(SessionMeta, StateRecord)> {
        // Of one that is being created it can be said as soon as it is.
        slot.until(|phase| !matches!(phase, Phase::Creating)).await;
        let place = slot.place.get().ok_or_else(|| not_found(id))?;
        let noted = self.root.summary(place).await.map_err(|e| store_error(&e))?;
        let noted = noted.and_then(|bytes| parse::<SummaryRecord>("the summary", &bytes).ok());
        let (record, state) = match noted {
            Some(SummaryRecord { meta, last_stamps, frame_counts, .. }) => {
                (meta, StateRecord { last_stamps, frame_counts, ..StateRecord::default() })
            }
            None => (self.unsummarised(place).await?, StateRecord::default()),
        };
        let meta = record.into_meta(&self.defaults);
        Ok((meta.map_err(|e| Fault::new(reason::DATA_DAMAGED, e.to_string()).error())?, state))
    }

    /// The same of a session that has no summary: it has never been awake, or was brought here from elsewhere.
    async fn unsummarised(&self, place: &SessionPlace) -> Result<MetaRecord> {
        let records = self.root.read_session(place).records().await.map_err(|e| store_error(&e))?;
        let stored = records.into_iter().find(|(key, _)| *key == keys::meta());
        let read = match (stored, self.root.entry(place.id()).await.map_err(|e| store_error(&e))?) {
            (Some((_, value)), _) => parse("meta", &value),
            (None, Some(CatalogueEntry::Created { place: found, record })) if found == *place => {
                parse("the catalogue entry", &record)
            }
            _ => return Err(not_found(place.id())),
        };
        read.map_err(|e| Trouble::from(e).error())
    }

    /// Sessions that `is_wanted`, with what is noted of them. How many there are is how many summaries are read, once after
    /// the start; [`Self::list`] reads those of a page.
    pub(crate) async fn list_all(&self, is_wanted: impl Fn(&SessionView) -> bool) -> Vec<SessionView> {
        let found: Vec<Arc<Slot>> =
            self.slots().into_iter().filter(|slot| !slot.is_doomed() && is_wanted(&view(slot))).collect();
        futures::stream::iter(&found).for_each_concurrent(READS_AT_ONCE, |slot| self.read_counts(slot)).await;
        found.iter().map(|slot| view(slot)).collect()
    }

    /// Sessions in the order of ids, after `after`, those that `is_wanted`, at most `limit`.
    pub(crate) async fn list(
        &self,
        after: &str,
        limit: usize,
        is_wanted: impl Fn(&SessionView) -> bool,
    ) -> Vec<SessionView> {
        let found: Vec<Arc<Slot>> = {
            let sessions = self.read_sessions();
            let from = (std::ops::Bound::Excluded(after.to_owned()), std::ops::Bound::Unbounded);
            let slots = sessions.by_id.range(from).map(|(_, slot)| slot);
            slots.filter(|slot| !slot.is_doomed() && is_wanted(&view(slot))).take(limit).cloned().collect()
        };
        futures::stream::iter(&found).for_each_concurrent(READS_AT_ONCE, |slot| self.read_counts(slot)).await;
        found.iter().map(|slot| view(slot)).collect()
    }

    /// Reads what is noted of a session that has not been awake since the start.
    async fn read_counts(&self, slot: &Slot) {
        let Some(place) = slot.place.get() else { return };
        // Another server may have gathered more since.
        if slot.known().counts.is_some() && !self.root.is_shared() {
            return;
        }
        let Ok(noted) = self.root.summary(place).await else { return };
        let noted = noted.and_then(|bytes| parse::<SummaryRecord>("the summary", &bytes).ok());
        slot.update_known(|known| {
            known.counts = Some(noted.as_ref().map(|n| n.counts).unwrap_or_default());
            if let Some(noted) = noted {
                known.display_name = noted.meta.display_name;
                known.labels = noted.meta.labels;
                known.revision = noted.meta.revision;
            }
        });
    }

    /// How many sessions are in each state.
    pub(crate) fn census(&self) -> HashMap<SessionState, usize> {
        let mut counts = HashMap::new();
        for slot in self.slots() {
            *counts.entry(slot.phase().state()).or_default() += 1;
        }
        counts
    }
}

fn view(slot: &Slot) -> SessionView {
    let (known, phase) = (slot.known(), slot.phase());
    let live = match &phase {
        Phase::Awake(session) | Phase::Retiring(session) | Phase::Faulted(_, Some(session)) => {
            Some(Arc::clone(session))
        }
        _ => None,
    };
    let counts = live.as_ref().map(|session| super::life::counts(session)).or(known.counts).unwrap_or_default();
    let (display_name, labels, revision) = match live.as_ref().map(|session| session.meta()) {
        Some(meta) => (meta.display_name, meta.labels, meta.revision),
        None => (known.display_name, known.labels, known.revision),
    };
    SessionView {
        id: slot.id.clone(),
        tenant: known.tenant,
        display_name,
        labels,
        etag: super::meta::etag(known.create_time_ns, revision),
        mode: if known.is_ingest_only { SessionMode::IngestOnly } else { SessionMode::Mapping },
        create_time_ns: known.create_time_ns,
        state: phase.state(),
        fault: if let Phase::Faulted(fault, _) = phase { Some(fault) } else { None },
        counts,
        last_used_ns: slot.last_used_ns(),
        recording: slot.recording.status(),
        live,
    }
}

//! Which sessions there are, which are awake; creates, wakes, deletes.

use super::events::EventLog;
use super::handle::Session;
use super::meta::{SensorDeclaration, SessionMeta};
use super::persist::{Persister, json, store_error};
use super::recover::recover;
use crate::{ComputePool, Error, ErrorCode, Limits, Result};
use percept_pipeline::PipelineParams;
use percept_store::{BlobId, Key, Prefix, SessionKeys, Store};
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, RwLock};

/// A catalogue entry; asleep until first used.
struct Slot {
    meta: SessionMeta,
    awake: Option<Arc<Session>>,
    /// Token of its first event once awake.
    first_token: u64,
}

pub(crate) struct Registry {
    store: Arc<dyn Store>,
    compute: ComputePool,
    limits: Arc<Limits>,
    defaults: PipelineParams,
    slots: RwLock<BTreeMap<String, Arc<Mutex<Slot>>>>,
    /// Creations one at a time, so that ids and request ids are checked and taken in one step.
    creating: Mutex<()>,
}

fn catalog_key(id: &str) -> Result<Key> {
    Key::new(["catalog", id]).map_err(|e| store_error(&e))
}

impl Registry {
    pub(crate) async fn open(
        store: Arc<dyn Store>,
        compute: ComputePool,
        limits: Arc<Limits>,
        defaults: PipelineParams,
    ) -> Result<Self> {
        let prefix = Prefix::new(["catalog"]).map_err(|e| store_error(&e))?;
        let mut slots = BTreeMap::new();
        // Events come far slower than one a microsecond, so that this lies above every token given before.
        let first_token = u64::try_from(crate::ops::sessions::now_ns() / 1000).unwrap_or(1).max(1);
        for (_, bytes) in store.scan_all(&prefix).await.map_err(|e| store_error(&e))? {
            let meta: SessionMeta = serde_json::from_slice(&bytes).map_err(Error::internal)?;
            slots.insert(meta.id.clone(), Arc::new(Mutex::new(Slot { meta, awake: None, first_token })));
        }
        let slots = RwLock::new(slots);
        Ok(Self { store, compute, limits, defaults, slots, creating: Mutex::default() })
    }

    pub(crate) fn defaults(&self) -> &PipelineParams {
        &self.defaults
    }

    /// Ids in order, after `after`, at most `limit`.
    pub(crate) async fn ids(&self, after: &str, limit: usize) -> Vec<String> {
        let slots = self.slots.read().await;
        let from = (std::ops::Bound::Excluded(after.to_owned()), std::ops::Bound::Unbounded);
        slots.range(from).take(limit).map(|(id, _)| id.clone()).collect()
    }

    /// The session, woken if it slept.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub(crate) async fn get(&self, id: &str) -> Result<Arc<Session>> {
        let slot = self.slots.read().await.get(id).cloned().ok_or_else(|| not_found(id))?;
        let mut slot = slot.lock().await;
        if let Some(session) = &slot.awake {
            return Ok(Arc::clone(session));
        }
        let (pipeline, state) = recover(&self.store, &self.compute, &slot.meta).await?;
        let stamps = state.last_stamps.clone();
        let persister = Persister::start(Arc::clone(&self.store), id, state)?;
        let events = EventLog::starting_at(slot.first_token, self.limits.event_history);
        let session =
            Session::start(slot.meta.clone(), pipeline, &stamps, persister, self.compute.clone(), &self.limits, events);
        slot.awake = Some(Arc::clone(&session));
        Ok(session)
    }

    /// Creates a session, durably. The same request id gives the session of the first call.
    ///
    /// # Errors
    /// `SESSION_EXISTS`, `TOO_MANY_SESSIONS`; faults of the storage.
    pub(crate) async fn create(&self, meta: SessionMeta) -> Result<Arc<Session>> {
        let _one_at_a_time = self.creating.lock().await;
        if let Some(id) = self.created_by(&meta.request_id).await {
            return self.get(&id).await;
        }
        {
            let slots = self.slots.read().await;
            if slots.contains_key(&meta.id) {
                let message = format!("session_id {:?} exists; choose another, or use it", meta.id);
                let code = ErrorCode::AlreadyExists;
                return Err(Error { code, reason: "SESSION_EXISTS", message, field: "session_id".to_owned() });
            }
            if slots.len() >= self.limits.max_sessions {
                let message = format!("this server holds {} sessions, its limit; delete some", slots.len());
                return Err(Error::exhausted("TOO_MANY_SESSIONS", "", message));
            }
        }
        self.store.put(catalog_key(&meta.id)?, json(&meta)?).await.map_err(|e| store_error(&e))?;
        let id = meta.id.clone();
        self.slots.write().await.insert(id.clone(), Arc::new(Mutex::new(Slot { meta, awake: None, first_token: 1 })));
        self.get(&id).await
    }

    async fn created_by(&self, request_id: &str) -> Option<String> {
        if request_id.is_empty() {
            return None;
        }
        for (id, slot) in self.slots.read().await.iter() {
            if slot.lock().await.meta.request_id == request_id {
                return Some(id.clone());
            }
        }
        None
    }

    /// Declares a sensor, durably.
    ///
    /// # Errors
    /// `SENSOR_IN_USE` if it has sent frames under another declaration, `TOO_MANY_SENSORS`.
    pub(crate) async fn declare(&self, id: &str, declaration: SensorDeclaration) -> Result<Arc<Session>> {
        let session = self.get(id).await?;
        let known = session.sensors().into_iter().find(|s| s.declaration.spec.id == declaration.spec.id);
        if known.as_ref().is_some_and(|s| s.declaration == declaration) {
            return Ok(session);
        }
        if known.as_ref().is_some_and(|s| s.last_stamp.is_some()) {
            let message = format!(
                "sensor_id {:?} has sent frames already; declare the changed sensor under another name",
                declaration.spec.id.0
            );
            return Err(Error {
                field: "sensor_id".to_owned(),
                ..Error::new(ErrorCode::FailedPrecondition, "SENSOR_IN_USE", message)
            });
        }
        if known.is_none() && session.num_sensors() >= self.limits.max_sensors_per_session {
            let limit = self.limits.max_sensors_per_session;
            return Err(Error::exhausted(
                "TOO_MANY_SENSORS",
                "sensor_id",
                format!("a session has at most {limit} sensors"),
            ));
        }
        session.declare(declaration).await?;
        let meta = session.meta();
        self.store.put(catalog_key(id)?, json(&meta)?).await.map_err(|e| store_error(&e))?;
        Ok(session)
    }

    /// Deletes a session and its records.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub(crate) async fn delete(&self, id: &str) -> Result<()> {
        let slot = self.slots.write().await.remove(id).ok_or_else(|| not_found(id))?;
        if let Some(session) = slot.lock().await.awake.take() {
            session.stop().await;
        }
        let keys = SessionKeys::new(id).map_err(|e| store_error(&e))?;
        let records = self.store.scan_all(&keys.all()).await.map_err(|e| store_error(&e))?;
        // The catalogue entry goes last: a crash in between leaves a session that can be deleted again.
        for chunk in records.chunks(1000) {
            let deletes = chunk.iter().map(|(k, _)| k.clone()).collect();
            self.store.put_batch(vec![], deletes).await.map_err(|e| store_error(&e))?;
        }
        self.store.delete(catalog_key(id)?).await.map_err(|e| store_error(&e))
    }

    /// Removes blobs that no keyframe names any more and that are older than an hour.
    pub(crate) async fn collect_garbage(&self) -> Result<()> {
        let mut live: HashSet<BlobId> = HashSet::new();
        for id in self.ids("", usize::MAX).await {
            let keys = SessionKeys::new(&id).map_err(|e| store_error(&e))?;
            for (_, bytes) in self.store.scan_all(&keys.keyframes()).await.map_err(|e| store_error(&e))? {
                let record: super::persist::KeyframeRecord = serde_json::from_slice(&bytes).map_err(Error::internal)?;
                if let Some(blob) = record.blob {
                    live.insert(blob.parse().map_err(|e| store_error(&e))?);
                }
            }
        }
        let grace = Duration::from_secs(3600);
        self.store.collect_garbage(&live, grace).await.map(|_| ()).map_err(|e| store_error(&e))
    }

    /// Stops every session that is awake, then the store.
    pub(crate) async fn stop(&self) {
        let slots: Vec<_> = self.slots.read().await.values().cloned().collect();
        for slot in slots {
            if let Some(session) = slot.lock().await.awake.take() {
                session.stop().await;
            }
        }
        if let Err(error) = self.store.close().await {
            tracing::error!(%error, "the store did not close cleanly; what was acknowledged is safe");
        }
    }
}

fn not_found(id: &str) -> Error {
    let shown: String = id.chars().take(80).collect();
    Error::not_found(
        "SESSION_NOT_FOUND",
        "session_id",
        format!("session_id {shown:?} does not exist; create it, or list the sessions"),
    )
}

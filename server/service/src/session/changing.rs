//! Changes of what is declared and set of a session, durably.

use super::handle::Session;
use super::meta::{SensorDeclaration, SessionMeta};
use super::registry::Registry;
use crate::{Error, Result, reason};
use std::sync::Arc;

impl Registry {
    /// Declares a sensor, durably.
    ///
    /// # Errors
    /// `SENSOR_IN_USE` if it has sent frames under another declaration, `TOO_MANY_SENSORS`.
    pub(crate) async fn declare(self: &Arc<Self>, id: &str, declaration: SensorDeclaration) -> Result<Arc<Session>> {
        let limit = self.limits.max_sensors_per_session;
        self.change(id, |session, meta| {
            let spec = &declaration.spec;
            if meta.sensors.contains(&declaration) {
                return Ok(None);
            }
            let known = session.sensors().into_iter().find(|s| s.declaration.spec.id == spec.id);
            if known.as_ref().is_some_and(|s| s.last_stamp.is_some()) {
                return Err(Error {
                    field: "sensor_id".to_owned(),
                    ..crate::ops::changes::in_use(&spec.id, "declaration")
                });
            }
            if known.is_none() && meta.sensors.len() >= limit {
                let message = format!("a session has at most {limit} sensors");
                return Err(Error::exhausted(reason::TOO_MANY_SENSORS, "sensor_id", message));
            }
            meta.sensors.retain(|s| s.spec.id != spec.id);
            meta.sensors.push(declaration.clone());
            meta.sensors.sort_by(|a, b| a.spec.id.cmp(&b.spec.id));
            Ok(Some(declaration.clone()))
        })
        .await
    }

    /// Changes what is declared and set of a session, durably.
    ///
    /// # Errors
    /// Those of `change`; `SESSION_NOT_FOUND`, `SESSION_FAULTED`; faults of the storage.
    pub(crate) async fn change(
        self: &Arc<Self>,
        id: &str,
        change: impl Fn(&Session, &mut SessionMeta) -> Result<Option<SensorDeclaration>>,
    ) -> Result<Arc<Session>> {
        let session = self.awake(id, |session| {
            let (change, shelf) = (&change, &self.shelf);
            let learned = |meta: &SessionMeta| shelf.named(&meta.tenant, &meta.params.detection.learned);
            async move { session.change(|meta| change(&session, meta), learned).await.map(|()| session) }
        });
        let session = session.await?;
        // What lists and sleeping sessions say is this from now on, also after a restart.
        if let Ok(slot) = self.find(id) {
            let (this, session) = (Arc::clone(self), Arc::clone(&session));
            let noted = tokio::spawn(async move {
                let is_new = this.note(&slot, &session);
                if let Some(fleet) = slot.events.fleet().filter(|_| is_new) {
                    fleet.updated(&session.meta().etag());
                }
                slot.events.settings_changed();
                this.write_summary(&slot, &session).await;
            });
            let _ = noted.await;
        }
        Ok(session)
    }

    /// Does something with a session that is awake; once more if it has just been put to sleep.
    ///
    /// # Errors
    /// Those of `get` and of what is done.
    pub(crate) async fn awake<T, F: Future<Output = Result<T>>>(
        self: &Arc<Self>,
        id: &str,
        act: impl Fn(Arc<Session>) -> F,
    ) -> Result<T> {
        const TRIES: usize = 3;
        let mut session = self.get(id).await?;
        let mut outcome = act(Arc::clone(&session)).await;
        for _ in 1..TRIES {
            if !outcome.as_ref().is_err_and(|e| e.reason == super::refusal::STOPPED) {
                break;
            }
            self.left(id, &session).await;
            session = self.get(id).await?;
            outcome = act(Arc::clone(&session)).await;
        }
        outcome
    }
}

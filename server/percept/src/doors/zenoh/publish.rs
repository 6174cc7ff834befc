//! What sessions find out, published: poses and events.

use super::ROOT;
use percept_service::{Caller, EventKind};
use percept_wire::convert::sessions;
use prost::Message;
use std::collections::BTreeSet;
use tokio::sync::Mutex;

/// Events read at a time.
const EVENTS_PER_READ: usize = 64;

/// One publishing task for each session that sends through this door.
pub(super) struct Publishers {
    zenoh: zenoh::Session,
    watched: Mutex<BTreeSet<String>>,
}

impl Publishers {
    pub(super) fn new(zenoh: zenoh::Session) -> Self {
        Self { zenoh, watched: Mutex::default() }
    }

    /// Publishes a session's events from now on, if that does not happen already.
    pub(super) async fn watch(self: &std::sync::Arc<Self>, caller: &Caller, session: &str) {
        let mut watched = self.watched.lock().await;
        if watched.contains(session) {
            return;
        }
        let Ok(log) = caller.session_events("SessionsService/WatchSession", session).await else { return };
        watched.insert(session.to_owned());
        let (this, id) = (std::sync::Arc::clone(self), session.to_owned());
        // Told before the first frame is taken, so that its events are published, too.
        let token = log.newest_token();
        tokio::spawn(async move {
            if let Err(error) = this.publish(&id, &log, token).await {
                tracing::warn!(session = id, %error, "publishing stopped");
            }
            this.watched.lock().await.remove(&id);
        });
    }

    async fn publish(&self, id: &str, log: &percept_service::EventLog, mut token: u64) -> Result<(), super::Failure> {
        let poses = self.zenoh.declare_publisher(format!("{ROOT}/{id}/pose")).await?;
        let events = self.zenoh.declare_publisher(format!("{ROOT}/{id}/events")).await?;
        while let Some(batch) = log.after(token, EVENTS_PER_READ).await {
            for event in batch {
                token = event.token;
                if let EventKind::Pose(pose) = &event.kind {
                    poses.put(sessions::pose_to(pose).encode_to_vec()).await?;
                }
                events.put(sessions::event_to(&event).encode_to_vec()).await?;
            }
        }
        Ok(())
    }
}

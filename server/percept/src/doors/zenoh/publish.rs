//! What sessions find out, published: poses and events.

use super::ROOT;
use percept_service::{Caller, EventKind};
use percept_wire::convert::sessions;
use prost::Message;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex as Lock, PoisonError};
use tokio::sync::Mutex;
use zenoh::qos::Priority;

/// Events read at a time.
const EVENTS_PER_READ: usize = 64;

/// One publishing task for each session that sends through this door, to all networks.
#[derive(Default)]
pub(super) struct Publishers {
    networks: Lock<BTreeMap<u64, zenoh::Session>>,
    watched: Mutex<BTreeSet<String>>,
}

/// A network that is published to until this is dropped.
pub(super) struct Published {
    publishers: Arc<Publishers>,
    number: u64,
}

impl Drop for Published {
    fn drop(&mut self) {
        self.publishers.networks.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.number);
    }
}

impl Publishers {
    /// Publishes to a network, too.
    pub(super) fn to(self: &Arc<Self>, network: &zenoh::Session) -> Published {
        let mut networks = self.networks.lock().unwrap_or_else(PoisonError::into_inner);
        let number = networks.last_key_value().map_or(0, |(last, _)| last + 1);
        networks.insert(number, network.clone());
        Published { publishers: Arc::clone(self), number }
    }

    /// Publishes a session's events from now on, if that does not happen already.
    pub(super) async fn watch(self: &Arc<Self>, caller: &Caller, session: &str) {
        let mut watched = self.watched.lock().await;
        if watched.contains(session) {
            return;
        }
        let Ok(log) = caller.session_events("SessionsService/WatchSession", session).await else { return };
        watched.insert(session.to_owned());
        let (this, id) = (Arc::clone(self), session.to_owned());
        // Told before the first frame is taken, so that its events are published, too.
        let token = log.newest_token();
        tokio::spawn(async move {
            this.publish(&id, &log, token).await;
            this.watched.lock().await.remove(&id);
        });
    }

    async fn publish(&self, id: &str, log: &percept_service::EventLog, mut token: u64) {
        let (poses, events) = (format!("{ROOT}/{id}/pose"), format!("{ROOT}/{id}/events"));
        while let Some(batch) = log.after(token, EVENTS_PER_READ).await {
            for event in batch {
                token = event.token;
                if let EventKind::Pose(pose) = &event.kind {
                    self.put(&poses, sessions::pose_to(pose).encode_to_vec(), Priority::InteractiveHigh).await;
                }
                self.put(&events, sessions::event_to(&event).encode_to_vec(), Priority::DataHigh).await;
            }
        }
    }

    /// Poses before all else, and not kept to be sent together: robots steer by them.
    async fn put(&self, key: &str, bytes: Vec<u8>, priority: Priority) {
        let bytes = zenoh::bytes::ZBytes::from(bytes);
        let networks: Vec<_> = {
            let networks = self.networks.lock().unwrap_or_else(PoisonError::into_inner);
            networks.values().cloned().collect()
        };
        for network in networks {
            // One that closes meanwhile has nobody to be told.
            if let Err(error) =
                network.put(key, bytes.clone()).priority(priority).express(priority == Priority::InteractiveHigh).await
            {
                tracing::debug!(key, %error, "not published");
            }
        }
    }
}

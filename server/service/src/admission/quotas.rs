//! What tenants may use, as it is configured.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What each tenant may use at most, so that none takes what the others need. Changed values are in force on SIGHUP.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Quotas {
    /// Every tenant that has no section of its own.
    pub each: Quota,
    /// Single tenants, each in a section such as [quotas.tenants.site-a]; what is left out there is not bounded.
    pub tenants: BTreeMap<String, Quota>,
}

impl Quotas {
    /// Of a tenant.
    pub fn of(&self, tenant: &str) -> &Quota {
        self.tenants.get(tenant).unwrap_or(&self.each)
    }
}

/// Bounds of one tenant; 0: none but the server's own. Rates are means, of which a second's worth may come at once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Quota {
    /// Share of the computing time where others want it, too: who has 2 gets twice as much as who has 1. Between sessions
    /// whose frames wait, and between tenants whose questions and toolbox requests do.
    pub weight: usize,
    /// Sessions.
    pub max_sessions: usize,
    /// Requests a second: calls at any door; of a stream its beginning.
    pub max_requests_per_s: usize,
    /// Frames a second, of all sessions together. Streams are held back, single frames refused, those by zenoh dropped.
    pub max_frames_per_s: usize,
    /// Frames a second of one session.
    pub max_session_frames_per_s: usize,
    /// Bytes of frames a second, as they are sent, of all sessions together.
    pub max_frame_bytes_per_s: usize,
    /// Bytes of frames a second of one session.
    pub max_session_frame_bytes_per_s: usize,
    /// Computing time of questions and the toolbox, milliseconds a second; 1000 is one core.
    pub max_computing_ms_per_s: usize,
    /// Ingest streams at a time.
    pub max_ingest_streams: usize,
    /// Watchers of events at a time.
    pub max_watchers: usize,
    /// Clouds that are kept for toolbox requests.
    pub max_kept_clouds: usize,
    /// Memory of those clouds, bytes.
    pub max_kept_bytes: usize,
}

impl Default for Quota {
    fn default() -> Self {
        Self {
            weight: 1,
            max_sessions: 0,
            max_requests_per_s: 0,
            max_frames_per_s: 0,
            max_session_frames_per_s: 0,
            max_frame_bytes_per_s: 0,
            max_session_frame_bytes_per_s: 0,
            max_computing_ms_per_s: 0,
            max_ingest_streams: 0,
            max_watchers: 0,
            max_kept_clouds: 0,
            max_kept_bytes: 0,
        }
    }
}

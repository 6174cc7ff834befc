//! The server itself: what runs, since when, and what it allows.

use crate::Service;
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// What the program around the service knows of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct About {
    /// Version of the program.
    pub version: String,
    /// The sources that it was built from; empty if the build did not say.
    pub commit: String,
    /// What the data are kept in, e.g. `directory`.
    pub store: String,
    /// Open doors.
    pub doors: Vec<String>,
    /// Whether the doors speak TLS.
    pub tls: bool,
    /// How callers say who they are; `none` if nobody is asked.
    pub auth: String,
}

/// Answer to who is there.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerInfo {
    /// What the program says of itself.
    pub about: About,
    /// How long it has served.
    pub uptime: Duration,
    /// Its clock, nanoseconds since the Unix epoch.
    pub time_ns: i64,
    /// Limits in force, by their name in the configuration's `[limits]`.
    pub limits: BTreeMap<String, u64>,
    /// Whether requests are taken, and if not, why.
    pub readiness: crate::Readiness,
}

impl Service {
    /// What runs here.
    pub fn server_info(&self) -> ServerInfo {
        let limits = serde_json::to_value(self.limits.as_ref()).unwrap_or_default();
        let limits = match limits {
            Value::Object(fields) => {
                fields.into_iter().filter_map(|(name, value)| Some((name, value.as_u64()?))).collect()
            }
            _ => BTreeMap::new(),
        };
        ServerInfo {
            about: self.about.as_ref().clone(),
            uptime: started().elapsed(),
            time_ns: self.clock_ns(),
            limits,
            readiness: self.health.readiness(),
        }
    }
}

/// When the process first asked, which the service does when it is opened.
pub(crate) fn started() -> Instant {
    static STARTED: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    *STARTED
}

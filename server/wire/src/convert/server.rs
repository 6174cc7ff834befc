//! The server itself.

use crate::v1;
use percept_service::{Readiness, ServerInfo};

/// What runs, since when, and what it allows.
pub fn info_to(info: &ServerInfo) -> v1::ServerInfo {
    let about = &info.about;
    v1::ServerInfo {
        version: about.version.clone(),
        commit: about.commit.clone(),
        uptime_s: info.uptime.as_secs_f64(),
        time_ns: info.time_ns,
        store: about.store.clone(),
        doors: about.doors.clone(),
        is_tls: about.tls,
        auth: about.auth.clone(),
        limits: info.limits.clone().into_iter().collect(),
        is_ready: info.readiness.is_ready(),
        not_ready: reasons_to(&info.readiness),
    }
}

/// Why requests are not taken; empty if they are.
pub fn reasons_to(readiness: &Readiness) -> Vec<v1::NotReadyReason> {
    let reason = |r: &percept_service::Reason| v1::NotReadyReason {
        part: r.part.name().to_owned(),
        reason: r.reason.to_owned(),
        message: r.message.clone(),
    };
    readiness.reasons().iter().map(reason).collect()
}

//! What of a changed configuration is put in force while the server runs, and what waits for a restart.

use crate::config::Config;
use percept_identity::AuthSettings;

/// What has changed and is put in force.
pub(super) fn applied(before: &Config, now: &Config) -> Vec<&'static str> {
    let changed = [
        ("auth.certificates", before.auth.certificates != now.auth.certificates),
        ("quotas", before.quotas != now.quotas),
        ("log.level", before.log.level != now.log.level),
        ("telemetry.access_log", before.telemetry.access_log != now.telemetry.access_log),
    ];
    changed.into_iter().filter(|(_, is_changed)| *is_changed).map(|(field, _)| field).collect()
}

/// Sections in which more has changed than can be taken while serving.
pub(super) fn waits_for_restart(before: &Config, now: &Config) -> Vec<&'static str> {
    let certificates = before.auth.certificates.clone();
    let auth = AuthSettings { certificates, ..now.auth.clone() };
    let log = crate::config::Log { level: before.log.level.clone(), ..now.log.clone() };
    let telemetry = crate::config::Telemetry { access_log: before.telemetry.access_log, ..now.telemetry.clone() };
    let changed = [
        ("listen", before.listen != now.listen),
        ("ros2", before.ros2 != now.ros2),
        ("auth", before.auth != auth),
        ("tls", before.tls != now.tls),
        ("storage", before.storage != now.storage),
        ("compute", before.compute != now.compute),
        ("limits", before.limits != now.limits),
        ("log", before.log != log),
        ("telemetry", before.telemetry != telemetry),
        ("detectors", before.detectors != now.detectors),
        ("params", before.params != now.params),
    ];
    changed.into_iter().filter(|(_, is_changed)| *is_changed).map(|(section, _)| section).collect()
}

//! What holds for settings beyond their types.

use super::{Config, ConfigError, Listen, Storage, Tls, Zenoh};
use percept_identity::{AuthMode, AuthSettings};
use percept_service::{Limits, Quotas};
use std::net::SocketAddr;
use std::path::Path;

/// Checks every value but the sessions' parameters.
///
/// # Errors
/// `OutOfBounds`, the first one.
pub(super) fn all(config: &Config) -> Result<(), ConfigError> {
    check_listen(&config.listen, &config.zenoh)?;
    check_zenoh(&config.zenoh, &config.auth)?;
    let takes_anybody = config.auth.allow_anonymous_beyond_loopback;
    if let Some((field, value, remedy)) = config.ros2.complaint(takes_anybody) {
        return Err(out_of_bounds(&field, value, remedy));
    }
    check_auth(&config.auth, &config.listen)?;
    check_tls(&config.tls, &config.listen)?;
    check_certificates(&config.auth, &config.tls)?;
    check_storage(&config.storage)?;
    if config.compute.threads > 1024 {
        return Err(out_of_bounds("compute.threads", config.compute.threads, "set it to 0 (one a core) up to 1024"));
    }
    if !(0..=19).contains(&config.compute.nice) {
        return Err(out_of_bounds("compute.nice", config.compute.nice, "set it between 0 and 19"));
    }
    if !(1..=64).contains(&config.detectors.threads) {
        return Err(out_of_bounds("detectors.threads", config.detectors.threads, "set it between 1 and 64"));
    }
    if let Some((field, value, remedy)) = config.recording.complaint() {
        return Err(out_of_bounds(field, value, remedy));
    }
    check_limits(&config.limits)?;
    check_quotas(&config.quotas)?;
    if let Err(problem) = crate::telemetry::filter(&config.log.level) {
        let remedy = format!("{problem}; write off, error, warn, info, debug or trace");
        return Err(quoted("log.level", &config.log.level, &remedy));
    }
    check_telemetry(config)?;
    Ok(())
}

fn check_listen(listen: &Listen, zenoh: &Zenoh) -> Result<(), ConfigError> {
    let socket = |field: &'static str, value: &str| match value.parse::<SocketAddr>() {
        _ if value.is_empty() => Ok(None),
        Ok(address) => Ok(Some(address)),
        Err(_) => {
            Err(quoted(field, value, "write IP address and port, such as \"127.0.0.1:50051\", or \"\" to close it"))
        }
    };
    let (grpc, rest) = (socket("listen.grpc", &listen.grpc)?, socket("listen.rest", &listen.rest)?);
    if grpc.is_some() && grpc == rest && grpc.is_some_and(|a| a.port() != 0) {
        return Err(quoted("listen.rest", &listen.rest, "take another port: listen.grpc has this one"));
    }
    if !listen.zenoh.is_empty() && !is_endpoint(&listen.zenoh) {
        let remedy = "write tcp/, udp/ or tls/, address and port, such as \"tcp/127.0.0.1:7447\", or \"\" to close it";
        return Err(quoted("listen.zenoh", &listen.zenoh, remedy));
    }
    for (field, value) in [("listen.notice_s", listen.notice_s), ("listen.drain_s", listen.drain_s)] {
        if value > 3600 {
            return Err(out_of_bounds(field, value, "set it between 0 and 3600"));
        }
    }
    for host in &listen.allowed_hosts {
        if host != "*" && (host.is_empty() || host.contains('/') || host.parse::<axum::http::uri::Authority>().is_err())
        {
            return Err(quoted("listen.allowed_hosts", host, "write a name, or name:port, without a scheme"));
        }
    }
    if listen.grpc.is_empty() && listen.rest.is_empty() && listen.zenoh.is_empty() && zenoh.connect.is_empty() {
        return Err(quoted("listen.grpc", "", "open at least one door of grpc, rest and zenoh"));
    }
    Ok(())
}

/// Whether it is an endpoint of zenoh, as percept takes them.
fn is_endpoint(endpoint: &str) -> bool {
    let has_port = |address: &str| {
        address.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
    };
    let parts = endpoint.split_once('/');
    parts.is_some_and(|(protocol, address)| ["tcp", "udp", "tls"].contains(&protocol) && has_port(address))
}

fn check_zenoh(zenoh: &Zenoh, auth: &AuthSettings) -> Result<(), ConfigError> {
    for endpoint in &zenoh.connect {
        if !is_endpoint(endpoint) || endpoint.starts_with("tls/") {
            let remedy = "write tcp/ or udp/, address and port, such as \"tcp/router.local:7447\"";
            return Err(quoted("zenoh.connect", endpoint, remedy));
        }
    }
    let chunk = |c: &str| !c.is_empty() && !c.contains(['*', '$', '?', '#', '@']);
    if !zenoh.namespace.is_empty() && !zenoh.namespace.split('/').all(chunk) {
        let remedy = "write names with / between them, such as \"site-a\", without *, $, ?, # and @";
        return Err(quoted("zenoh.namespace", &zenoh.namespace, remedy));
    }
    let joins = !zenoh.connect.is_empty() || !zenoh.namespace.is_empty();
    if joins && auth.mode == AuthMode::Required {
        let remedy = "but auth.mode is \"required\", and who sends through a router cannot be told: let peers connect to \
                      listen.zenoh by themselves, without a namespace";
        let (field, value) = match zenoh.connect.first() {
            Some(endpoint) => ("zenoh.connect", endpoint),
            None => ("zenoh.namespace", &zenoh.namespace),
        };
        return Err(quoted(field, value, remedy));
    }
    if let Some(endpoint) = zenoh.connect.first().filter(|_| !auth.allow_anonymous_beyond_loopback) {
        let remedy = "which others may reach, wherever it is, and nobody is asked who they are: let everybody in with \
                      auth.allow_anonymous_beyond_loopback = true";
        return Err(quoted("zenoh.connect", endpoint, remedy));
    }
    Ok(())
}

fn check_auth(auth: &AuthSettings, listen: &Listen) -> Result<(), ConfigError> {
    auth.validate().map_err(|e| ConfigError::OutOfBounds {
        origin: None,
        field: format!("auth.{}", e.field),
        problem: format!(" is {}; {}", e.value, e.remedy),
    })?;
    if auth.mode == AuthMode::Required || auth.allow_anonymous_beyond_loopback {
        return Ok(());
    }
    for (field, address) in
        [("listen.grpc", &listen.grpc), ("listen.rest", &listen.rest), ("listen.zenoh", &listen.zenoh)]
    {
        if !address.is_empty() && !is_loopback(address) {
            let remedy = "which others can reach, and nobody is asked who they are: set auth.mode = \"required\", listen on \
                          127.0.0.1, or let everybody in with auth.allow_anonymous_beyond_loopback = true";
            return Err(quoted(field, address, remedy));
        }
    }
    Ok(())
}

fn check_tls(tls: &Tls, listen: &Listen) -> Result<(), ConfigError> {
    let given = |path: &Path| !path.as_os_str().is_empty();
    if given(&tls.key_file) && !tls.is_on() {
        return Err(out_of_bounds("tls.cert_file", "empty", "name the certificate that goes with tls.key_file"));
    }
    if tls.is_on() && !given(&tls.key_file) {
        return Err(out_of_bounds("tls.key_file", "empty", "name the private key that goes with tls.cert_file"));
    }
    if given(&tls.client_ca_file) && !tls.is_on() {
        let remedy = "name the server's certificate: clients show theirs over TLS only";
        return Err(out_of_bounds("tls.cert_file", "empty", remedy));
    }
    if tls.client_cert_required && !given(&tls.client_ca_file) {
        let remedy = "name the authorities whose certificates are required";
        return Err(out_of_bounds("tls.client_ca_file", "empty", remedy));
    }
    if listen.zenoh.starts_with("tls/") && !tls.is_on() {
        return Err(out_of_bounds("tls.cert_file", "empty", "listen.zenoh is a tls/ endpoint; name a certificate"));
    }
    Ok(())
}

/// Clients show certificates only where they are asked for one.
fn check_certificates(auth: &AuthSettings, tls: &Tls) -> Result<(), ConfigError> {
    if auth.mode == AuthMode::None || auth.certificates.is_empty() || !tls.client_ca_file.as_os_str().is_empty() {
        return Ok(());
    }
    let subjects: Vec<&str> = auth.certificates.iter().map(|rule| rule.subject.as_str()).collect();
    let remedy = "but no client is asked for a certificate: set tls.client_ca_file to the authorities (PEM) of the clients' \
                  certificates, or take the rules out";
    Err(out_of_bounds("auth.certificates", format!("for {}", subjects.join(", ")), remedy))
}

/// Whether only this machine can reach an address, or endpoint of zenoh.
pub(crate) fn is_loopback(address: &str) -> bool {
    let address = address.split_once('/').map_or(address, |(_, address)| address);
    match address.parse::<SocketAddr>() {
        Ok(address) => address.ip().to_canonical().is_loopback(),
        Err(_) => address.rsplit_once(':').is_some_and(|(host, _)| host == "localhost"),
    }
}

fn check_telemetry(config: &Config) -> Result<(), ConfigError> {
    let telemetry = &config.telemetry;
    for (field, share) in
        [("telemetry.access_log", telemetry.access_log), ("telemetry.trace_share", telemetry.trace_share)]
    {
        if !(0.0..=1.0).contains(&share) {
            return Err(out_of_bounds(field, share, "set it between 0 and 1"));
        }
    }
    let collector = &telemetry.otlp_endpoint;
    if !collector.is_empty() && collector.strip_prefix("http://").is_none_or(str::is_empty) {
        let remedy = "write http://, host and port, such as \"http://127.0.0.1:4317\", or \"\" to send nothing";
        return Err(quoted("telemetry.otlp_endpoint", collector, remedy));
    }
    if telemetry.listen.is_empty() {
        return Ok(());
    }
    let address: SocketAddr = telemetry.listen.parse().map_err(|_| {
        let remedy = "write IP address and port, such as \"127.0.0.1:9464\", or \"\" to use the REST door";
        quoted("telemetry.listen", &telemetry.listen, remedy)
    })?;
    let taken = [&config.listen.grpc, &config.listen.rest].into_iter().any(|door| door.parse() == Ok(address));
    if taken && address.port() != 0 {
        return Err(quoted("telemetry.listen", &telemetry.listen, "take another port: a door has this one"));
    }
    if !telemetry.metrics {
        return Err(quoted("telemetry.listen", &telemetry.listen, "set telemetry.metrics to true, or this to \"\""));
    }
    let auth = &config.auth;
    let is_open = auth.open_metrics || (auth.mode == AuthMode::None && auth.allow_anonymous_beyond_loopback);
    if !is_open && !is_loopback(&telemetry.listen) {
        let remedy = "which others can reach, and metrics are served there without TLS to whoever asks: set \
                      auth.open_metrics = true if that network is for monitoring alone, listen on 127.0.0.1, or leave it \
                      \"\" to serve them at the REST door, by its TLS and its keys";
        return Err(quoted("telemetry.listen", &telemetry.listen, remedy));
    }
    Ok(())
}

fn check_storage(storage: &Storage) -> Result<(), ConfigError> {
    if storage.url.is_empty() && storage.data_dir.as_os_str().is_empty() {
        return Err(out_of_bounds("storage.data_dir", "empty", "name a directory, such as \"percept-data\""));
    }
    if !storage.cache_dir.as_os_str().is_empty() && storage.url.is_empty() {
        let directory = storage.cache_dir.display().to_string();
        return Err(quoted(
            "storage.cache_dir",
            &directory,
            "leave it empty; only an object store (storage.url) has a cache",
        ));
    }
    if storage.cache_mb < 16 {
        return Err(out_of_bounds("storage.cache_mb", storage.cache_mb, "set it to 16 or more"));
    }
    if storage.advertise.ends_with(":0") {
        return Err(quoted("storage.advertise", &storage.advertise, "name the port that callers reach this server at"));
    }
    Ok(())
}

fn check_limits(limits: &Limits) -> Result<(), ConfigError> {
    let bounds = [
        ("limits.max_message_bytes", limits.max_message_bytes, 1 << 30),
        ("limits.max_image_pixels", limits.max_image_pixels, 1 << 30),
        ("limits.max_cloud_points", limits.max_cloud_points, 1 << 28),
        ("limits.max_sessions", limits.max_sessions, 10_000_000),
        ("limits.max_sensors_per_session", limits.max_sensors_per_session, 10_000),
        ("limits.queue_length", limits.queue_length, 100_000),
        ("limits.max_grid_cells", limits.max_grid_cells, 1 << 30),
        ("limits.max_planning_cells", limits.max_planning_cells, 1 << 30),
        ("limits.max_concurrent_computations", limits.max_concurrent_computations, 10_000),
        ("limits.max_computation_ms", limits.max_computation_ms, 86_400_000),
        ("limits.max_upload_bytes", limits.max_upload_bytes, 1 << 40),
        ("limits.max_kept_clouds", limits.max_kept_clouds, 1_000_000),
        ("limits.max_kept_bytes", limits.max_kept_bytes, 1 << 40),
        ("limits.max_kept_s", limits.max_kept_s, 86_400),
        ("limits.max_running_operations", limits.max_running_operations, 10_000),
        ("limits.max_running_operations_per_owner", limits.max_running_operations_per_owner, 10_000),
        ("limits.max_operation_s", limits.max_operation_s, 86_400),
        ("limits.max_operations", limits.max_operations, 1_000_000),
        ("limits.max_operations_per_owner", limits.max_operations_per_owner, 1_000_000),
        ("limits.max_operation_bytes", limits.max_operation_bytes, 1 << 40),
        ("limits.max_operation_bytes_per_owner", limits.max_operation_bytes_per_owner, 1 << 40),
        ("limits.operation_kept_s", limits.operation_kept_s, 604_800),
        ("limits.max_detector_bytes", limits.max_detector_bytes, 1 << 30),
        ("limits.max_detectors", limits.max_detectors, 10_000),
        ("limits.max_detectors_per_tenant", limits.max_detectors_per_tenant, 10_000),
        ("limits.max_detectors_bytes", limits.max_detectors_bytes, 1 << 40),
        ("limits.event_history", limits.event_history, 1_000_000),
        ("limits.fleet_event_history", limits.fleet_event_history, 1_000_000),
        ("limits.max_queued_computations", limits.max_queued_computations, 1_000_000),
        ("limits.max_bytes_in_flight", limits.max_bytes_in_flight, 1 << 40),
        ("limits.max_bytes_in_flight_per_peer", limits.max_bytes_in_flight_per_peer, 1 << 40),
        ("limits.max_connections", limits.max_connections, 1_000_000),
        ("limits.max_connections_per_peer", limits.max_connections_per_peer, 1_000_000),
        ("limits.max_calls_per_connection", limits.max_calls_per_connection, 10_000),
        ("limits.max_ingest_streams", limits.max_ingest_streams, 1_000_000),
        ("limits.max_watchers", limits.max_watchers, 1_000_000),
        ("limits.max_watchers_per_peer", limits.max_watchers_per_peer, 1_000_000),
        ("limits.header_timeout_s", limits.header_timeout_s, 86_400),
        ("limits.body_timeout_s", limits.body_timeout_s, 86_400),
        ("limits.idle_timeout_s", limits.idle_timeout_s, 86_400),
        ("limits.stream_idle_timeout_s", limits.stream_idle_timeout_s, 86_400),
        ("limits.unread_timeout_s", limits.unread_timeout_s, 86_400),
        ("limits.sleep_after_s", limits.sleep_after_s, 10 * 365 * 86_400),
        ("limits.max_session_memory_mb", limits.max_session_memory_mb, 1 << 20),
    ];
    for (field, value, most) in bounds {
        if !(1..=most).contains(&value) {
            return Err(out_of_bounds(field, value, format!("set it between 1 and {most}")));
        }
    }
    // A message of the largest size has to fit: as JSON it is a third longer.
    // And half of it is for what HTTP/2 keeps of bodies before it is asked for.
    let least = limits.max_message_bytes.saturating_mul(2).max(LEAST_IN_FLIGHT_BYTES);
    for (field, value) in [
        ("limits.max_bytes_in_flight", limits.max_bytes_in_flight),
        ("limits.max_bytes_in_flight_per_peer", limits.max_bytes_in_flight_per_peer),
    ] {
        if value < least {
            let remedy = format!("set it to twice limits.max_message_bytes, {least} or more");
            return Err(out_of_bounds(field, value, remedy));
        }
    }
    Ok(())
}

/// Room for a few calls at a time.
const LEAST_IN_FLIGHT_BYTES: usize = 2 << 20;

fn check_quotas(quotas: &Quotas) -> Result<(), ConfigError> {
    let named = quotas.tenants.iter().map(|(tenant, quota)| (format!("quotas.tenants.{tenant}"), quota));
    for (section, quota) in std::iter::once(("quotas.each".to_owned(), &quotas.each)).chain(named) {
        if !(1..=1000).contains(&quota.weight) {
            return Err(out_of_bounds(&format!("{section}.weight"), quota.weight, "set it between 1 and 1000"));
        }
    }
    Ok(())
}

fn out_of_bounds(field: &str, value: impl ToString, remedy: impl Into<String>) -> ConfigError {
    let problem = format!(" is {}; {}", value.to_string(), remedy.into());
    ConfigError::OutOfBounds { origin: None, field: field.to_owned(), problem }
}

fn quoted(field: &str, value: &str, remedy: &str) -> ConfigError {
    out_of_bounds(field, format!("{value:?}"), remedy)
}

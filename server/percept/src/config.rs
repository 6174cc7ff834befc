//! How the server is set up: defaults, then a file, then the environment, then flags (which the CLI lays over).
//!
//! Every default is in `deploy/percept.toml`, which is printed by the program and held equal to the code by a
//! test; `deploy/refresh-template` writes it anew from the code. A setting of the environment is named by its path in the file, in capitals and with underscores:
//! `PERCEPT_LISTEN_GRPC`, `PERCEPT_LIMITS_MAX_SESSIONS`, `PERCEPT_PARAMS_MAP_CLOUD_VOXEL_SIZE_M`.

mod environment;
mod error;
mod origin;

pub(crate) use error::ConfigError;
use origin::Origins;
use percept_pipeline::PipelineParams;
use percept_service::Limits;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// The configuration file with every default and its explanation.
pub(crate) const TEMPLATE: &str = include_str!("../../../deploy/percept.toml");

/// Everything that can be set.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Config {
    /// Addresses of the doors.
    pub listen: Listen,
    /// Where everything durable lives.
    pub storage: Storage,
    /// How much of the machine is used.
    pub compute: Compute,
    /// What a request may ask for at most.
    pub limits: Limits,
    /// What is logged.
    pub log: Log,
    /// Parameters of a session, where its creator sends none.
    pub params: PipelineParams,
}

/// Addresses of the doors; an empty one closes its door.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Listen {
    /// gRPC: IP address and port; port 0 takes a free one.
    pub grpc: String,
    /// REST: IP address and port; port 0 takes a free one.
    pub rest: String,
    /// Zenoh: endpoint that peers connect to, protocol/address:port.
    pub zenoh: String,
}

impl Default for Listen {
    fn default() -> Self {
        Self {
            grpc: "127.0.0.1:50051".to_owned(),
            rest: "127.0.0.1:8080".to_owned(),
            zenoh: "tcp/127.0.0.1:7447".to_owned(),
        }
    }
}

/// Where everything durable lives.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Storage {
    /// Directory, made if absent; one server at a time uses it.
    pub data_dir: PathBuf,
}

impl Default for Storage {
    fn default() -> Self {
        Self { data_dir: PathBuf::from("percept-data") }
    }
}

/// How much of the machine is used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Compute {
    /// Threads that compute, 0 to 1024; 0: one for each core.
    pub threads: usize,
    /// How far those threads stand back behind the ones that answer, 0 to 19, as `nice` has it.
    pub nice: i32,
}

impl Default for Compute {
    fn default() -> Self {
        Self { threads: 0, nice: 5 }
    }
}

/// What is logged, to standard error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Log {
    /// Least importance that is logged: off, error, warn, info, debug or trace; or by module, such as
    /// info,percept=debug. The variable `RUST_LOG` overrides it.
    pub level: String,
    /// How a line looks: text for people, json for machines.
    pub format: LogFormat,
}

impl Default for Log {
    fn default() -> Self {
        Self { level: "info".to_owned(), format: LogFormat::default() }
    }
}

/// How a line of the log looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line, for machines.
    Json,
}

impl Config {
    /// Defaults, `file` over them, this process's environment over both; checked. Flags are laid over the result by
    /// the caller, who then calls [`validate`](Self::validate) again.
    ///
    /// # Errors
    /// [`ConfigError`] with where it was set, field, value and remedy.
    pub(crate) fn load(file: Option<&Path>) -> Result<Self, ConfigError> {
        Self::layered(file, std::env::vars_os())
    }

    fn layered(
        file: Option<&Path>,
        variables: impl Iterator<Item = (std::ffi::OsString, std::ffi::OsString)>,
    ) -> Result<Self, ConfigError> {
        let mut origins = Origins::default();
        let mut config = match file {
            Some(path) => read(path, &mut origins)?,
            None => Self::default(),
        };
        environment::lay_over(&mut config, variables, &mut origins)?;
        config.validate().map_err(|e| e.located(&origins))?;
        Ok(config)
    }

    /// Checks every value against its bounds.
    ///
    /// # Errors
    /// `OutOfBounds`, the first one.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        check_listen(&self.listen)?;
        if self.storage.data_dir.as_os_str().is_empty() {
            return Err(out_of_bounds("storage.data_dir", "empty", "name a directory, such as \"percept-data\""));
        }
        if self.compute.threads > 1024 {
            return Err(out_of_bounds("compute.threads", self.compute.threads, "set it to 0 (one a core) up to 1024"));
        }
        if !(0..=19).contains(&self.compute.nice) {
            return Err(out_of_bounds("compute.nice", self.compute.nice, "set it between 0 and 19"));
        }
        check_limits(&self.limits)?;
        if let Err(problem) = crate::telemetry::filter(&self.log.level) {
            let remedy = format!("{problem}; write off, error, warn, info, debug or trace");
            return Err(quoted("log.level", &self.log.level, &remedy));
        }
        self.params.validate().map_err(|e| ConfigError::params(e.section, e.message))
    }
}

fn read(path: &Path, origins: &mut Origins) -> Result<Config, ConfigError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), message: source.to_string() })?;
    origins.file(path, &text);
    toml::from_str(&text).map_err(|e| ConfigError::syntax(path, &text, &e))
}

fn check_listen(listen: &Listen) -> Result<(), ConfigError> {
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
    let has_port = |address: &str| {
        address.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
    };
    let endpoint = listen
        .zenoh
        .split_once('/')
        .is_some_and(|(protocol, address)| ["tcp", "udp", "tls"].contains(&protocol) && has_port(address));
    if !listen.zenoh.is_empty() && !endpoint {
        let remedy = "write tcp/, udp/ or tls/, address and port, such as \"tcp/127.0.0.1:7447\", or \"\" to close it";
        return Err(quoted("listen.zenoh", &listen.zenoh, remedy));
    }
    if listen.grpc.is_empty() && listen.rest.is_empty() && listen.zenoh.is_empty() {
        return Err(quoted("listen.grpc", "", "open at least one door of grpc, rest and zenoh"));
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
        ("limits.event_history", limits.event_history, 1_000_000),
    ];
    for (field, value, most) in bounds {
        if !(1..=most).contains(&value) {
            return Err(out_of_bounds(field, value, format!("set it between 1 and {most}")));
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

#[cfg(test)]
mod tests;

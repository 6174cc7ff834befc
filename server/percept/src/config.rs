//! How the server is set up: defaults, then a file, then the environment, then flags (which the CLI lays over).
//!
//! Every default is in `deploy/percept.toml`, which is printed by the program and held equal to the code by a
//! test; `deploy/refresh-template` writes it anew from the code. A setting of the environment is named by its path in the file, in capitals and with underscores:
//! `PERCEPT_LISTEN_GRPC`, `PERCEPT_LIMITS_MAX_SESSIONS`, `PERCEPT_PARAMS_MAP_CLOUD_VOXEL_SIZE_M`.

mod check;
mod environment;
mod error;
mod origin;

use crate::detectors::Detectors;
use crate::doors::ros2::Ros2;
pub(crate) use check::is_loopback;
pub(crate) use error::ConfigError;
use origin::Origins;
use percept_identity::AuthSettings;
use percept_pipeline::PipelineParams;
use percept_service::{Limits, Quotas, RecordingSettings};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The configuration file with every default and its explanation.
pub(crate) const TEMPLATE: &str = include_str!("../../../deploy/percept.toml");

/// Everything that can be set.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Config {
    /// Addresses of the doors.
    pub listen: Listen,
    /// Networks of zenoh that percept joins.
    pub zenoh: Zenoh,
    /// Robots on ROS 2.
    pub ros2: Ros2,
    /// Who may call, and what they may do.
    pub auth: AuthSettings,
    /// Encryption of the doors.
    pub tls: Tls,
    /// Where everything durable lives.
    pub storage: Storage,
    /// What sessions take, as files for replay, ROS 2 and Foxglove (MCAP).
    pub recording: RecordingSettings,
    /// How much of the machine is used.
    pub compute: Compute,
    /// What a request may ask for at most.
    pub limits: Limits,
    /// What a tenant may use at most.
    pub quotas: Quotas,
    /// What is logged.
    pub log: Log,
    /// What is counted, timed and traced.
    pub telemetry: Telemetry,
    /// Learned detectors.
    pub detectors: Detectors,
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
    /// Zenoh: endpoint that peers connect to, protocol/address:port; tls/ needs section tls.
    pub zenoh: String,
    /// REST: names by which browsers and clients may call the server, beside the address it is bound to and, there,
    /// localhost; with a port, or for any. An entry "*" allows all.
    pub allowed_hosts: Vec<String>,
    /// gRPC: whether clients may list services and messages (server reflection).
    pub reflection: bool,
    /// REST: whether the documentation (/docs, /openapi.json) is served.
    pub docs: bool,
    /// Time between the signal to stop, from which on `/readyz` says no, and the closing of the doors, seconds; give
    /// load balancers theirs.
    pub notice_s: usize,
    /// Time for requests under way to finish after that, seconds; half-sent ones get two.
    pub drain_s: usize,
}

impl Default for Listen {
    fn default() -> Self {
        Self {
            grpc: "127.0.0.1:50051".to_owned(),
            rest: "127.0.0.1:8080".to_owned(),
            zenoh: "tcp/127.0.0.1:7447".to_owned(),
            allowed_hosts: vec![],
            reflection: true,
            docs: true,
            notice_s: 0,
            drain_s: 20,
        }
    }
}

/// Networks of zenoh that percept joins, beside what it listens on (`listen.zenoh`). Not with auth.mode "required": who
/// sends through a router cannot be told. Nothing passes from one of them to another.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Zenoh {
    /// One router of each, such as "tcp/router.local:7447", to connect to as its client, whenever it is there; `listen.zenoh`
    /// may be closed. Wants `auth.allow_anonymous_beyond_loopback`: whoever reaches the router reaches every session.
    pub connect: Vec<String>,
    /// Put before every key, such as "site-a" for keys site-a/percept/...; empty: nothing.
    pub namespace: String,
}

/// Encryption of the doors: TLS on gRPC, REST and, for an endpoint tls/, zenoh. Changed files are read again within seconds,
/// or on SIGHUP; connections stay, except those of zenoh, which connect anew.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Tls {
    /// Certificate of the server and those between it and its authority, PEM; empty: no encryption.
    pub cert_file: PathBuf,
    /// Its private key, PEM.
    pub key_file: PathBuf,
    /// Authorities of clients' certificates, PEM; empty: clients are not asked for one.
    pub client_ca_file: PathBuf,
    /// Whether a client has to show a certificate; else it may.
    pub client_cert_required: bool,
}

impl Tls {
    /// Whether the doors speak TLS.
    pub(crate) fn is_on(&self) -> bool {
        !self.cert_file.as_os_str().is_empty()
    }
}

/// Where everything durable lives.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Storage {
    /// Directory, made if absent.
    pub data_dir: PathBuf,
    /// An object store instead of the directory: s3://bucket/prefix, shared with whatever servers name it, too, or
    /// memory://, which is forgotten at the end. S3's keys come from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, a web
    /// identity, or the role of the machine.
    pub url: String,
    /// Address of an S3 service other than Amazon's, such as `https://s3.site.example:9000`; empty: AWS_ENDPOINT_URL, else
    /// Amazon's.
    pub s3_endpoint: String,
    /// Region of the bucket; empty: AWS_REGION, else us-east-1.
    pub s3_region: String,
    /// Whether s3_endpoint may be without TLS.
    pub s3_allow_http: bool,
    /// Directory on this machine where what was read from the object store, or written to it, is kept, too, so that a
    /// session that wakes again does not fetch it; empty: none. It may be lost at any time.
    pub cache_dir: PathBuf,
    /// Most megabytes in cache_dir, 16 or more; what was used longest ago goes first.
    pub cache_mb: u64,
    /// Whether other servers use the same directory at the same time, each of them some of the sessions.
    pub shared: bool,
    /// Shared only: where other servers send callers who ask them for a session of this one, such as 10.0.0.7:50051; empty:
    /// where the gRPC door listens.
    pub advertise: String,
}

impl Default for Storage {
    fn default() -> Self {
        Self {
            data_dir: PathBuf::from("percept-data"),
            url: String::new(),
            s3_endpoint: String::new(),
            s3_region: String::new(),
            s3_allow_http: false,
            cache_dir: PathBuf::from(""),
            cache_mb: 4096,
            shared: false,
            advertise: String::new(),
        }
    }
}

/// How much of the machine is used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Compute {
    /// Threads that compute, 0 to 1024; 0: one for each core.
    pub threads: usize,
    /// How far those that process frames, and those that write data, stand back behind the ones that answer, 0 to 19, as
    /// `nice` has it; those that recognise places and solve pose graphs two more, those of the toolbox ten more.
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

/// What is counted, timed and traced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Telemetry {
    /// Whether `GET /metrics` answers Prometheus.
    pub metrics: bool,
    /// IP address and port at which /metrics, /livez and /readyz are served apart from the REST door, which then has no
    /// /metrics; empty: /metrics is served at the REST door. It asks nobody who they are and speaks no TLS: it is for a
    /// network of monitoring, and beyond this machine auth.open_metrics has to be true.
    pub listen: String,
    /// Share of requests that get a line in the log, at target access, 0 to 1.
    pub access_log: f64,
    /// Collector that spans are sent to by OTLP over gRPC, such as http://127.0.0.1:4317; empty: they are not sent.
    pub otlp_endpoint: String,
    /// Share of the traces that begin here whose spans are sent, 0 to 1; those of a caller go as the caller says.
    pub trace_share: f64,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self { metrics: true, listen: String::new(), access_log: 0.0, otlp_endpoint: String::new(), trace_share: 1.0 }
    }
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
        check::all(self)?;
        self.params.validate().map_err(|e| ConfigError::params(e.section, e.message))
    }
}

fn read(path: &Path, origins: &mut Origins) -> Result<Config, ConfigError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), message: source.to_string() })?;
    origins.file(path, &text);
    toml::from_str(&text).map_err(|e| ConfigError::syntax(path, &text, &e))
}

#[cfg(test)]
mod tests;

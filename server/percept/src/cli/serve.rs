//! `percept serve`: opens the store and the doors, serves until asked to stop, stops gracefully.

use super::Failure;
use super::prepare::Prepared;
use super::reload::{applied, waits_for_restart};
use super::store::PlaceArgs;
use crate::config::Config;
use crate::doors::bounds::Bounds;
use crate::doors::grpc::Api;
use crate::doors::identify::Gate;
use crate::doors::listener::tls::Tls;
use crate::doors::listener::{Listener, Protocol, Shared, files};
use crate::doors::{grpc, rest, ros2, zenoh, zenoh::ZenohDoor};
use crate::storage::{self, StorageThreads};
use percept_identity::{AuthMode, AuthSettings, Authenticator};
use percept_service::{About, Admission, ComputePool, ComputeThreads, Guarded, HEALTHY, Part, Service};
use percept_store::DataRoot;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpSocket;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// How far the threads that work for sessions beside their frames stand back behind those for frames, as `nice` has it.
const BESIDE_STANDS_BACK: i32 = 2;
/// How far the toolbox's threads stand back behind those for sessions, as `nice` has it.
const TOOLBOX_STANDS_BACK: i32 = 10;

/// Threads that wait for files. Each keeps memory of its own, half a megabyte or more, and once there it stays: work goes round
/// all of them. With 512, a machine that was short of time for an hour had 300, and 150 MB for them.
const MOST_FILE_THREADS: usize = 32;

/// Connections to what watches the server.
const MOST_SCRAPERS: usize = 64;

/// How often files of keys are looked at.
const REFRESH: Duration = Duration::from_secs(1);

#[derive(Debug, clap::Args)]
pub(crate) struct ServeArgs {
    /// Configuration file; `percept config` prints one with every default.
    #[arg(long, env = "PERCEPT_CONFIG")]
    config: Option<PathBuf>,
    #[command(flatten)]
    place: PlaceArgs,
    /// Address of the gRPC door, e.g. 127.0.0.1:50051; port 0 takes a free one.
    #[arg(long)]
    grpc: Option<String>,
    /// Address of the REST door.
    #[arg(long)]
    rest: Option<String>,
    /// Endpoint of the zenoh door, e.g. tcp/127.0.0.1:7447; empty closes it.
    #[arg(long)]
    zenoh: Option<String>,
    /// Router of a zenoh network to join, e.g. tcp/router.local:7447; may be given several times.
    #[arg(long, value_name = "ENDPOINT")]
    zenoh_connect: Vec<String>,
    /// Folder in which all that sessions take is recorded, as MCAP.
    #[arg(long, value_name = "FOLDER")]
    record: Option<String>,
    /// A robot on ROS 2 (rmw_zenoh): SESSION=ENDPOINT, where ENDPOINT is its zenoh router, e.g.
    /// robot-7=tcp/10.0.0.7:7447. Again for more; the configuration says more of each.
    #[arg(long, value_name = "SESSION=ENDPOINT", value_parser = robot)]
    ros2: Vec<ros2::Robot>,
    /// Threads for computing; 0 takes all cores.
    #[arg(long)]
    threads: Option<usize>,
}

fn robot(text: &str) -> Result<ros2::Robot, String> {
    let (session, connect) = text.split_once('=').ok_or("write SESSION=ENDPOINT, such as robot-7=tcp/10.0.0.7:7447")?;
    Ok(ros2::Robot { session: session.to_owned(), connect: connect.to_owned(), ..ros2::Robot::default() })
}

impl ServeArgs {
    /// Lays the flags over what was read.
    fn config(self, read: &Config) -> Result<Config, Failure> {
        let mut config = read.clone();
        let set = |slot: &mut String, flag: Option<String>| {
            if let Some(value) = flag {
                *slot = value;
            }
        };
        set(&mut config.listen.grpc, self.grpc);
        set(&mut config.listen.rest, self.rest);
        set(&mut config.listen.zenoh, self.zenoh);
        if !self.zenoh_connect.is_empty() {
            config.zenoh.connect = self.zenoh_connect;
        }
        set(&mut config.recording.dir, self.record);
        config.ros2.robots.extend(self.ros2);
        self.place.lay_over(&mut config.storage);
        if let Some(threads) = self.threads {
            config.compute.threads = threads;
        }
        config.validate()?;
        Ok(config)
    }
}

/// Where a running server listens; empty where a door is closed.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct Addresses {
    pub(crate) grpc: String,
    pub(crate) rest: String,
    pub(crate) zenoh: String,
    /// Where `/metrics` is served apart from the REST door.
    pub(crate) telemetry: String,
}

/// A server whose doors are open.
pub(crate) struct Running {
    pub(crate) addresses: Addresses,
    service: Service,
    tls: Option<Arc<Tls>>,
    authenticator: Arc<Authenticator>,
    /// To the zenoh door.
    auth: watch::Sender<AuthSettings>,
    /// Read again when a signal asks for it.
    config_file: Option<PathBuf>,
    /// As read when the server began, without flags.
    read: Config,
    /// As read last.
    taken: Config,
    /// First the server is no longer ready, then it takes nothing more.
    stop: watch::Sender<bool>,
    notice: Duration,
    drain: Duration,
    doors: JoinSet<Result<(), Failure>>,
    /// The last to go.
    _storage_threads: StorageThreads,
}

impl Running {
    /// Opens store and doors.
    pub(crate) async fn start(config: &Config) -> Result<Self, Failure> {
        let files = files::raise_limit();
        let Prepared { tls, authenticator } = super::prepare::prepare(config)?;
        // The address that others are told has to be known before the data are opened.
        let socket =
            (!config.listen.grpc.is_empty()).then(|| reserve("listen.grpc", &config.listen.grpc)).transpose()?;
        let address = socket.as_ref().and_then(|s| s.local_addr().ok());
        let storage_threads = StorageThreads::start(config.compute.nice, MOST_FILE_THREADS)?;
        let mut root = storage::root_config(config, address)?;
        root.session.runtime = storage_threads.handle();
        let data = DataRoot::open(root).await?;
        let limits = &config.limits;
        crate::telemetry::begin(&config.telemetry);
        let detectors = crate::detectors::load(&config.detectors);
        let of_sessions = (config.params.clone(), config.recording.clone());
        let service = Service::open(data, compute(config)?, limits.clone(), of_sessions, detectors).await?;
        let service = service.described(about(config));
        let (stop, stopping) = watch::channel(false);
        let bounds = Bounds::new(limits);
        let shared = Shared {
            limits: Arc::clone(service.limits()),
            memory: Arc::clone(&bounds.memory),
            windows: Arc::clone(&bounds.windows),
            tls: tls.clone(),
            stopping: stopping.clone(),
            faults: Arc::clone(service.faults()),
        };
        let listen = Arc::new(config.listen.clone());
        let gate = Gate::new(Arc::clone(&authenticator));
        let shows_metrics = config.telemetry.metrics && config.telemetry.listen.is_empty();
        let api = Api { service: Guarded::new(service.clone()), gate, listen, bounds, stopping, shows_metrics };
        let (auth, asked) = watch::channel(config.auth.clone());
        let mut addresses = Addresses::default();
        let mut doors: JoinSet<Result<(), Failure>> = JoinSet::new();
        let open = [&config.listen.grpc, &config.listen.rest].into_iter().filter(|address| !address.is_empty());
        let most = files::max_connections(limits.max_connections, files, open.count());
        if let Some(socket) = socket {
            let listener = Listener::open(socket, Protocol::Grpc, most, shared.clone())?;
            addresses.grpc = listener.address()?.to_string();
            let api = api.clone();
            doors.spawn(async move {
                grpc::serve(api, listener).await;
                Ok(())
            });
        }
        if !config.listen.rest.is_empty() {
            let listener = bind("listen.rest", &config.listen.rest, Protocol::Rest, most, shared.clone())?;
            addresses.rest = listener.address()?.to_string();
            let api = api.clone();
            doors.spawn(async move { Ok(rest::serve(api, listener).await?) });
        }
        if !config.listen.zenoh.is_empty() || !config.zenoh.connect.is_empty() {
            let door = ZenohDoor::open(&api, &config.listen.zenoh, &config.zenoh, asked, &config.tls).await?;
            addresses.zenoh = config.listen.zenoh.clone();
            doors.spawn(door.serve(api.clone()));
        }
        if !config.ros2.robots.is_empty() {
            doors.spawn(ros2::serve(api.clone(), config.ros2.clone()));
        }
        if let Some(tls) = tls.clone() {
            tokio::spawn(async move { tls.follow().await });
        }
        tokio::spawn(refresh(Arc::downgrade(&authenticator)));
        tokio::spawn(refresh_provider(Arc::downgrade(&authenticator)));
        if !config.telemetry.listen.is_empty() {
            // Not one of the doors: it still tells how the server stands while those drain.
            let (never, stopping) = watch::channel(false);
            let shared = Shared { tls: None, stopping, ..shared };
            let at = &config.telemetry.listen;
            let listener = bind("telemetry.listen", at, Protocol::Rest, MOST_SCRAPERS, shared)?;
            addresses.telemetry = listener.address()?.to_string();
            let api = api.clone();
            tokio::spawn(async move {
                let _never = never;
                rest::serve_telemetry(api, listener).await
            });
        }
        service.health().report(Part::Server, HEALTHY);
        let seconds = |s: usize| Duration::from_secs(s as u64);
        let (notice, drain) = (seconds(config.listen.notice_s), seconds(config.listen.drain_s));
        let (config_file, read, taken) = (None, config.clone(), config.clone());
        Ok(Self {
            addresses,
            service,
            tls,
            authenticator,
            auth,
            config_file,
            read,
            taken,
            stop,
            notice,
            drain,
            doors,
            _storage_threads: storage_threads,
        })
    }

    /// Serves until a signal, or until a door fails.
    pub(crate) async fn until_stopped(&mut self, signals: &mut Signals) -> Result<(), Failure> {
        loop {
            tokio::select! {
                signal = signals.next() => match signal {
                    Signalled::Stop => return Ok(()),
                    Signalled::Reload => self.reload(),
                },
                ended = self.doors.join_next() => return match ended {
                    Some(Ok(outcome)) => outcome,
                    Some(Err(panic)) => Err(panic.into()),
                    None => Err("all doors are closed; open one in the configuration".into()),
                },
            }
        }
    }

    /// Reads again what can be changed while serving: certificates and the rules for them, what is logged, quotas.
    fn reload(&mut self) {
        if let Err(error) = self.take_configuration() {
            tracing::error!(%error, "the configuration in force stays");
        }
        if let Some(tls) = &self.tls
            && let Err(error) = tls.reload()
        {
            tracing::error!(%error, "the certificates in force stay");
        }
    }

    fn take_configuration(&mut self) -> Result<(), Failure> {
        let config = Config::load(self.config_file.as_deref())?;
        let rules = &config.auth.certificates;
        let auth = AuthSettings { certificates: rules.clone(), ..self.auth.borrow().clone() };
        zenoh::check(&auth, &self.addresses.zenoh, &self.read.tls)?;
        crate::telemetry::reload(&config)?;
        self.service.set_quotas(config.quotas.clone());
        self.authenticator.set_certificates(rules);
        self.auth.send_if_modified(|now| {
            let is_changed = *now != auth;
            *now = auth;
            is_changed
        });
        let taken = applied(&self.taken, &config).join(", ");
        tracing::info!(taken, "the configuration was read again; taken is what differs and is in force now");
        for section in waits_for_restart(&self.read, &config) {
            tracing::warn!(section, "changed, and in force after a restart only");
        }
        self.taken = config;
        Ok(())
    }

    /// Says that it is no longer ready, refuses new work, finishes what is under way, stores it, closes.
    ///
    /// # Errors
    /// What was accepted and could not be stored.
    pub(crate) async fn stop(mut self) -> Result<(), Failure> {
        self.service.health().draining();
        tokio::time::sleep(self.notice).await;
        let _ = self.stop.send(true);
        let drained = tokio::time::timeout(self.drain, async { while self.doors.join_next().await.is_some() {} });
        if drained.await.is_err() {
            tracing::warn!("requests were still under way after {} s", self.drain.as_secs());
            self.doors.abort_all();
        }
        let stopped = self.service.stop().await;
        crate::telemetry::end().await;
        stopped.map_err(|e| format!("not all that was accepted is stored: {e}").into())
    }
}

/// Takes over keys that were made or revoked.
async fn refresh(authenticator: std::sync::Weak<Authenticator>) {
    loop {
        tokio::time::sleep(REFRESH).await;
        let Some(authenticator) = authenticator.upgrade() else { return };
        authenticator.refresh_keys();
    }
}

/// Takes over the provider's keys: a provider that hangs holds up nobody else.
async fn refresh_provider(authenticator: std::sync::Weak<Authenticator>) {
    loop {
        tokio::time::sleep(REFRESH).await;
        let Some(authenticator) = authenticator.upgrade() else { return };
        authenticator.refresh_provider().await;
    }
}

/// Threads for each kind of work: questions are short and go first, the toolbox stands back behind the frames.
fn compute(config: &Config) -> Result<ComputePool, Failure> {
    let (threads, nice) = (config.compute.threads, config.compute.nice);
    let pools = ComputeThreads {
        frames: super::compute_pool(threads, nice)?,
        beside: super::compute_pool(threads, (nice + BESIDE_STANDS_BACK).min(19))?,
        queries: super::compute_pool(threads, 0)?,
        toolbox: super::compute_pool(threads, (nice + TOOLBOX_STANDS_BACK).min(19))?,
    };
    let limits = &config.limits;
    let admission = Admission::new(config.quotas.clone());
    Ok(ComputePool::apart(pools, limits.max_concurrent_computations, limits.max_queued_computations, admission))
}

/// What the program knows of itself.
fn about(config: &Config) -> About {
    let listen = &config.listen;
    let auth = match config.auth.mode {
        AuthMode::None => "none",
        AuthMode::Required => "required",
    };
    let doors = [("grpc", &listen.grpc), ("rest", &listen.rest), ("zenoh", &listen.zenoh)];
    About {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: crate::telemetry::COMMIT.to_owned(),
        store: store_kind(&config.storage).to_owned(),
        doors: doors.into_iter().filter(|(_, at)| !at.is_empty()).map(|(name, _)| name.to_owned()).collect(),
        tls: config.tls.is_on(),
        auth: auth.to_owned(),
    }
}

/// Of the place where data are.
fn store_kind(storage: &crate::config::Storage) -> &str {
    storage.url.split_once("://").map_or("file", |(scheme, _)| scheme)
}

fn bind(
    field: &str,
    address: &str,
    protocol: Protocol,
    max_connections: usize,
    shared: Shared,
) -> Result<Listener, Failure> {
    Ok(Listener::open(reserve(field, address)?, protocol, max_connections, shared)?)
}

fn reserve(field: &str, address: &str) -> Result<TcpSocket, Failure> {
    Listener::reserve(address).map_err(|e| {
        let remedy = match e.kind() {
            std::io::ErrorKind::AddrInUse => {
                "; end what listens there, perhaps another percept, or set another address"
            }
            std::io::ErrorKind::AddrNotAvailable => {
                "; set an address that this machine has, or 0.0.0.0 for all of them"
            }
            std::io::ErrorKind::PermissionDenied => "; set a port above 1023, or let the process take lower ones",
            _ => "",
        };
        format!("{field}: cannot listen on {address}: {e}{remedy}").into()
    })
}

/// What a signal asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Signalled {
    /// Ctrl-C, or SIGTERM as a supervisor sends it.
    Stop,
    /// SIGHUP.
    Reload,
}

/// The signals that a server obeys, from when this is made: none of them kills it.
pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Signal,
}

impl Signals {
    /// # Errors
    /// What the system says.
    pub(crate) fn listen() -> Result<Self, Failure> {
        let (interrupt, terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        Ok(Self { interrupt, terminate, hang_up: signal(SignalKind::hangup())? })
    }

    /// The next one.
    pub(crate) async fn next(&mut self) -> Signalled {
        tokio::select! {
            _ = self.interrupt.recv() => Signalled::Stop,
            _ = self.terminate.recv() => Signalled::Stop,
            _ = self.hang_up.recv() => Signalled::Reload,
        }
    }

    /// Somebody at the terminal does not want to wait: Ctrl-C once more. Supervisors may say SIGTERM twice and mean nothing
    /// by it.
    pub(crate) async fn forced(&mut self) {
        loop {
            tokio::select! {
                _ = self.interrupt.recv() => return,
                _ = self.terminate.recv() => {}
                _ = self.hang_up.recv() => {}
            }
        }
    }
}

/// The runtime of the doors.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    Ok(builder.max_blocking_threads(MOST_FILE_THREADS).enable_all().build()?)
}

/// A session's grids are large and written here and there: in pages of 2 MB, thirty sessions with a laser held 290 MB
/// instead of 120, and no frame or toolbox operation was faster for it.
fn keep_pages_small() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::thread::disable_transparent_huge_pages(true) {
        tracing::debug!(%error, "cannot do without huge pages; sessions will take more memory");
    }
}

pub(crate) fn run(args: ServeArgs) -> Result<(), Failure> {
    let config_file = args.config.clone();
    let read = Config::load(config_file.as_deref())?;
    let config = args.config(&read)?;
    crate::telemetry::init(&config.log.level, config.log.format);
    keep_pages_small();
    let runtime = runtime()?;
    let outcome = runtime.block_on(async {
        let mut signals = Signals::listen()?;
        let taken = read.clone();
        let mut running = Running { config_file, read, taken, ..Running::start(&config).await? };
        println!("{}", serde_json::to_string(&running.addresses)?);
        tracing::info!(
            grpc = running.addresses.grpc,
            rest = running.addresses.rest,
            zenoh = running.addresses.zenoh,
            "serving"
        );
        let outcome = running.until_stopped(&mut signals).await;
        tracing::info!("stopping");
        let stopped = tokio::select! {
            stopped = running.stop() => stopped,
            () = signals.forced() => Err("stopped by a second signal before all that was under way was finished".into()),
        };
        outcome.and(stopped)
    });
    // What may still run after a second signal is not waited for.
    runtime.shutdown_background();
    outcome
}

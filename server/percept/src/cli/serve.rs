//! `percept serve`: opens the store and the doors, serves until asked to stop, stops gracefully.

use super::Failure;
use crate::config::Config;
use crate::doors::grpc::Api;
use crate::doors::{grpc, rest, zenoh::ZenohDoor};
use percept_service::{ComputePool, Service};
use percept_store::{SlateStore, StoreConfig};
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Time for requests under way to finish after the signal to stop.
const DRAIN: Duration = Duration::from_secs(20);

#[derive(Debug, clap::Args)]
pub(crate) struct ServeArgs {
    /// Configuration file; `percept config` prints one with every default.
    #[arg(long, env = "PERCEPT_CONFIG")]
    config: Option<PathBuf>,
    /// Where everything is stored.
    #[arg(long)]
    data_dir: Option<PathBuf>,
    /// Address of the gRPC door, e.g. 127.0.0.1:50051; port 0 takes a free one.
    #[arg(long)]
    grpc: Option<String>,
    /// Address of the REST door.
    #[arg(long)]
    rest: Option<String>,
    /// Endpoint of the zenoh door, e.g. tcp/127.0.0.1:7447; empty closes it.
    #[arg(long)]
    zenoh: Option<String>,
    /// Threads for computing; 0 takes all cores.
    #[arg(long)]
    threads: Option<usize>,
}

impl ServeArgs {
    fn config(self) -> Result<Config, Failure> {
        let mut config = Config::load(self.config.as_deref())?;
        let set = |slot: &mut String, flag: Option<String>| {
            if let Some(value) = flag {
                *slot = value;
            }
        };
        set(&mut config.listen.grpc, self.grpc);
        set(&mut config.listen.rest, self.rest);
        set(&mut config.listen.zenoh, self.zenoh);
        if let Some(dir) = self.data_dir {
            config.storage.data_dir = dir;
        }
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
}

/// A server whose doors are open.
pub(crate) struct Running {
    pub(crate) addresses: Addresses,
    service: Service,
    stop: watch::Sender<bool>,
    doors: JoinSet<Result<(), Failure>>,
}

impl Running {
    /// Opens store and doors.
    pub(crate) async fn start(config: &Config) -> Result<Self, Failure> {
        let store = SlateStore::open(StoreConfig::directory(&config.storage.data_dir)).await?;
        let pool = super::compute_pool(config.compute.threads, config.compute.nice)?;
        let compute = ComputePool::new(pool, config.limits.max_concurrent_computations);
        let service = Service::open(Arc::new(store), compute, config.limits.clone(), config.params.clone()).await?;
        let (stop, stopping) = watch::channel(false);
        let api = Api { service: service.clone(), stopping };
        let mut addresses = Addresses::default();
        let mut doors: JoinSet<Result<(), Failure>> = JoinSet::new();
        if !config.listen.grpc.is_empty() {
            let listener = bind("listen.grpc", &config.listen.grpc).await?;
            addresses.grpc = listener.local_addr()?.to_string();
            let api = api.clone();
            doors.spawn(async move { Ok(grpc::serve(api, listener).await?) });
        }
        if !config.listen.rest.is_empty() {
            let listener = bind("listen.rest", &config.listen.rest).await?;
            addresses.rest = listener.local_addr()?.to_string();
            let api = api.clone();
            doors.spawn(async move { Ok(rest::serve(api, listener).await?) });
        }
        if !config.listen.zenoh.is_empty() {
            let door = ZenohDoor::open(&api, &config.listen.zenoh).await?;
            addresses.zenoh = config.listen.zenoh.clone();
            doors.spawn(door.serve(api));
        }
        let garbage = service.clone();
        tokio::spawn(async move {
            if let Err(error) = garbage.collect_garbage().await {
                tracing::warn!(%error, "unused scans were not removed");
            }
        });
        Ok(Self { addresses, service, stop, doors })
    }

    /// Serves until a signal, or until a door fails.
    pub(crate) async fn until_stopped(&mut self) -> Result<(), Failure> {
        tokio::select! {
            signal = stop_signal() => signal,
            ended = self.doors.join_next() => match ended {
                Some(Ok(outcome)) => outcome,
                Some(Err(panic)) => Err(panic.into()),
                None => Err("all doors are closed; open one in the configuration".into()),
            },
        }
    }

    /// Refuses new work, finishes what is under way, stores it, closes.
    pub(crate) async fn stop(mut self) {
        let _ = self.stop.send(true);
        let drained = tokio::time::timeout(DRAIN, async { while self.doors.join_next().await.is_some() {} });
        if drained.await.is_err() {
            tracing::warn!("requests were still under way after {} s", DRAIN.as_secs());
            self.doors.abort_all();
        }
        self.service.stop().await;
    }
}

async fn bind(field: &str, address: &str) -> Result<TcpListener, Failure> {
    TcpListener::bind(address).await.map_err(|e| format!("{field}: cannot listen on {address}: {e}").into())
}

/// Ctrl-C, or SIGTERM as a supervisor sends it.
pub(crate) async fn stop_signal() -> Result<(), Failure> {
    let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
    tokio::select! {
        interrupted = tokio::signal::ctrl_c() => Ok(interrupted?),
        _ = terminate.recv() => Ok(()),
    }
}

/// The runtime of the doors.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    Ok(tokio::runtime::Builder::new_multi_thread().enable_all().build()?)
}

pub(crate) fn run(args: ServeArgs) -> Result<(), Failure> {
    let config = args.config()?;
    crate::telemetry::init(&config.log.level, config.log.format);
    let runtime = runtime()?;
    runtime.block_on(async {
        let mut running = Running::start(&config).await?;
        println!("{}", serde_json::to_string(&running.addresses)?);
        tracing::info!(
            grpc = running.addresses.grpc,
            rest = running.addresses.rest,
            zenoh = running.addresses.zenoh,
            "serving"
        );
        let outcome = running.until_stopped().await;
        tracing::info!("stopping");
        running.stop().await;
        outcome
    })
}

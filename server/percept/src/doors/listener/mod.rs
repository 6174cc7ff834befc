//! Listening for gRPC and REST: accepts connections within their bounds, encrypts them, ends those that keep the server
//! waiting, drains them when it stops.
//!
//! Comes in: a bound address and a router. Goes out: requests to the router, each with a [`PeerIdentity`] and what its
//! body has taken of the memory ([`Held`]). It knows nothing of what is asked. Start with [`Listener::serve`]; one connection
//! is in [`connection`], the body of a request in [`request`], that of an answer in [`answer`].

mod answer;
mod connection;
pub(crate) mod files;
mod io;
mod refusal;
mod request;
pub(crate) mod tls;

pub(crate) use request::{Framing, Held};
pub(crate) use tls::{ClientCertificate, PeerIdentity};

use super::bounds::{Memory, Peer, Place, Places};
use axum::Router;
use axum::http::Uri;
use connection::Connection;
use percept_service::observe;
use percept_service::{Limits, RateLimitedLog};
use std::io::{Error, ErrorKind};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tls::Tls;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Connections that wait to be accepted.
const BACKLOG: u32 = 1024;
/// What the system keeps of answers for a client that does not read; it takes twice as much.
const SEND_BUFFER_BYTES: u32 = 256 << 10;
/// Pause when the system has no descriptor, nor memory, for another connection.
const PAUSE: Duration = Duration::from_millis(100);
/// Refusals that are said at a time; beyond it connections are closed without a word.
const MOST_REFUSALS: usize = 64;

/// What is spoken on a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// HTTP/1.1.
    Rest,
    /// HTTP/2.
    Grpc,
}

impl Protocol {
    const fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Grpc => "grpc",
        }
    }
}

/// A connection's place among all. Who takes the connection over, as WebSockets do, keeps it.
#[derive(Clone)]
pub(crate) struct Seat {
    _taken: Arc<(Place, observe::Held)>,
}

/// What both doors share.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) limits: Arc<Limits>,
    pub(crate) memory: Arc<Memory>,
    pub(crate) windows: Arc<Memory>,
    pub(crate) tls: Option<Arc<Tls>>,
    /// Turns true when no new work is taken.
    pub(crate) stopping: watch::Receiver<bool>,
    pub(crate) faults: Arc<RateLimitedLog>,
}

/// A bound door.
pub(crate) struct Listener {
    listener: TcpListener,
    protocol: Protocol,
    places: Arc<Places>,
    shared: Shared,
}

impl Listener {
    /// Takes an address. Whoever calls is refused until [`Self::open`].
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn reserve(address: &str) -> std::io::Result<TcpSocket> {
        let address: SocketAddr = address.parse().map_err(|e| Error::new(ErrorKind::InvalidInput, e))?;
        let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        socket.set_reuseaddr(true)?;
        socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
        socket.bind(address)?;
        Ok(socket)
    }

    /// Lets callers come to an address that was taken.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn open(
        socket: TcpSocket,
        protocol: Protocol,
        max_connections: usize,
        shared: Shared,
    ) -> std::io::Result<Self> {
        let places = Places::new(max_connections, shared.limits.max_connections_per_peer);
        Ok(Self { listener: socket.listen(BACKLOG)?, protocol, places, shared })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves until the server stops, then until what is under way is finished. `framing` says what bodies at a
    /// path consist of.
    pub(crate) async fn serve(self, router: Router, framing: fn(&Uri) -> Framing) {
        let Self { listener, protocol, places, shared } = self;
        let (mut connections, mut refusals) = (JoinSet::new(), JoinSet::new());
        let mut stopping = shared.stopping.clone();
        loop {
            let accepted = tokio::select! {
                accepted = listener.accept() => accepted,
                _ = stopping.wait_for(|s| *s) => break,
                Some(_) = connections.join_next() => continue,
                Some(_) = refusals.join_next() => continue,
            };
            match accepted {
                Ok((socket, address)) => match places.take(&Peer::at(address)) {
                    Some(place) => {
                        let shared = shared.clone();
                        connections.spawn(run(socket, address, place, protocol, shared, router.clone(), framing));
                    }
                    None => {
                        tell(&shared, protocol, "too many connections", &address.ip().to_string());
                        if refusals.len() < MOST_REFUSALS {
                            refusals.spawn(refusal::say(socket, protocol, shared.tls.is_some()));
                        }
                    }
                },
                Err(error) if is_of_one_connection(&error) => {}
                Err(error) => {
                    tell(&shared, protocol, "no connection is accepted", &error.to_string());
                    // What holds descriptors and memory gives them back by and by; asking at once again would spin.
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
        drop(listener);
        refusals.abort_all();
        while connections.join_next().await.is_some() {}
    }
}

fn tell(shared: &Shared, protocol: Protocol, what: &str, detail: &str) {
    if let Some(untold) = shared.faults.admit(&format!("{} {what}", protocol.name())) {
        tracing::warn!(door = protocol.name(), detail, untold, "{what}");
    }
}

/// A client that went away before it was accepted.
fn is_of_one_connection(error: &Error) -> bool {
    use ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset, Interrupted};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset | Interrupted)
}

async fn run(
    socket: TcpStream,
    address: SocketAddr,
    place: Place,
    protocol: Protocol,
    shared: Shared,
    router: Router,
    framing: fn(&Uri) -> Framing,
) {
    // Without it small answers wait for the peer's acknowledgement, 40 ms; a socket that refuses it still works.
    let _ = socket.set_nodelay(true);
    let connection = |identity| {
        let open = observe::connection(match protocol {
            Protocol::Grpc => observe::Door::Grpc,
            Protocol::Rest => observe::Door::Rest,
        });
        let seat = Seat { _taken: Arc::new((place, open)) };
        Connection { protocol, shared: shared.clone(), identity, seat, router, framing }
    };
    match &shared.tls {
        None => connection(PeerIdentity { address, certificate: None }).run(socket).await,
        Some(tls) => {
            let time = Duration::from_secs(shared.limits.header_timeout_s as u64);
            match tokio::time::timeout(time, tls.accept(socket, protocol)).await {
                Ok(Ok((stream, certificate))) => connection(PeerIdentity { address, certificate }).run(stream).await,
                Ok(Err(error)) => tell(&shared, protocol, "a TLS handshake failed", &error.to_string()),
                Err(_) => tell(&shared, protocol, "a TLS handshake took too long", &address.ip().to_string()),
            }
        }
    }
}

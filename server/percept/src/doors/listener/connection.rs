//! One connection: its requests to the router, and who watches that it does not keep the server waiting.

use super::answer::{Answer, Reader};
use super::io::{Traffic, Watched};
use super::request::{Arriving, Framing, Patience, Sender};
use super::{PeerIdentity, Protocol, Seat, Shared};
use crate::doors::bounds::{Charge, Peer};
use crate::doors::status;
use axum::Router;
use axum::body::Body;
use axum::http::{Request, Response, Uri};
use axum::response::IntoResponse;
use http_body::Body as _;
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use percept_service::Limits;
use std::convert::Infallible;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tower::ServiceExt;

/// How often a connection is looked at.
const LOOK: Duration = Duration::from_secs(1);
/// Time that requests which are not whole, and answers that are not read, get when the server stops.
const LAST_GRACE: Duration = Duration::from_secs(2);
/// What a client may send ahead on one HTTP/2 stream, and on all of a connection. Streams reserve theirs.
const STREAM_WINDOW_BYTES: u32 = 256 << 10;
const CONNECTION_WINDOW_BYTES: u32 = 4 << 20;
/// What is kept of an answer that is not read, a stream.
const SEND_BUFFER_BYTES: usize = 256 << 10;
/// A header may be as long.
const HEADER_BYTES: usize = 32 << 10;
/// HTTP/1: header, or what is read of a body at a time.
const READ_BUFFER_BYTES: usize = 128 << 10;
/// An HTTP/2 client has said this much before its first request.
const PREFACE_BYTES: u64 = 24;
/// A peer that does not answer for so long is gone.
const KEEP_ALIVE: Duration = Duration::from_secs(20);

/// What a connection is to do.
pub(super) struct Connection {
    pub(super) protocol: Protocol,
    pub(super) shared: Shared,
    pub(super) identity: PeerIdentity,
    pub(super) seat: Seat,
    pub(super) router: Router,
    pub(super) framing: fn(&Uri) -> Framing,
}

/// What the watcher knows of a connection's requests.
struct Watch {
    state: Mutex<State>,
}

struct State {
    under_way: usize,
    /// Since when none is; and what had come by then.
    quiet_since: Instant,
    received: u64,
    senders: Vec<Sender>,
    readers: Vec<Reader>,
}

/// A request under way.
struct UnderWay {
    watch: Arc<Watch>,
    traffic: Arc<Traffic>,
}

impl Watch {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        let mut state = self.watch.lock();
        state.under_way -= 1;
        (state.quiet_since, state.received) = (Instant::now(), self.traffic.received());
    }
}

/// What is to become of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Stay,
    /// No more requests; those under way are finished.
    Finish,
    /// Closed as it stands.
    Cut,
}

/// What is seen of a connection at a time.
struct Look {
    protocol: Protocol,
    under_way: usize,
    /// How long nothing was under way.
    quiet: Duration,
    /// Bytes that came since then, and in all.
    since_quiet: u64,
    received: u64,
    write_waits: Option<Duration>,
    /// How long it has been finishing, for whichever reason.
    finishing: Option<Duration>,
    /// Whether the server stops.
    is_stopping: bool,
}

impl Look {
    fn verdict(&self, limits: &Limits) -> Verdict {
        let seconds = |s: usize| Duration::from_secs(s as u64);
        let unread = if self.is_stopping { LAST_GRACE } else { seconds(limits.unread_timeout_s) };
        if self.write_waits.is_some_and(|waits| waits >= unread) {
            return Verdict::Cut;
        }
        if let Some(finishing) = self.finishing {
            // Half a header, or the end of an answer that nobody takes.
            let is_over = self.under_way == 0 && self.quiet.min(finishing) >= unread;
            return if is_over { Verdict::Cut } else { Verdict::Stay };
        }
        if self.under_way > 0 {
            return Verdict::Stay;
        }
        let begun = match self.protocol {
            Protocol::Rest => self.since_quiet > 0 || self.received == 0,
            Protocol::Grpc => self.received < PREFACE_BYTES,
        };
        if begun && self.quiet >= seconds(limits.header_timeout_s) {
            return Verdict::Cut;
        }
        if self.quiet >= seconds(limits.idle_timeout_s) { Verdict::Finish } else { Verdict::Stay }
    }
}

impl Connection {
    /// Serves a socket until it closes.
    pub(super) async fn run<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(self, socket: S) {
        let PeerIdentity { address, certificate } = &self.identity;
        tracing::debug!(%address, ?certificate, protocol = ?self.protocol, "connected");
        let traffic = Traffic::new();
        let io = TokioIo::new(Watched { socket, traffic: Arc::clone(&traffic) });
        let (protocol, limits, stopping) =
            (self.protocol, Arc::clone(&self.shared.limits), self.shared.stopping.clone());
        let state = State { under_way: 0, quiet_since: Instant::now(), received: 0, senders: vec![], readers: vec![] };
        let watch = Arc::new(Watch { state: Mutex::new(state) });
        let (this, seen, bytes) = (Arc::new(self), Arc::clone(&watch), Arc::clone(&traffic));
        let service = service_fn(move |request| {
            let (this, watch, traffic) = (Arc::clone(&this), Arc::clone(&seen), Arc::clone(&bytes));
            async move { Ok::<_, Infallible>(this.answer(request, watch, traffic).await) }
        });
        let watched = Watching { protocol, limits: Arc::clone(&limits), watch, traffic, stopping };
        match protocol {
            Protocol::Rest => {
                let mut builder = hyper::server::conn::http1::Builder::new();
                // The watcher has the time of headers: this one would also end connections that rest between requests.
                builder.timer(TokioTimer::new()).header_read_timeout(None).max_buf_size(READ_BUFFER_BYTES);
                // A WebSocket takes its connection over.
                let connection = builder.serve_connection(io, service).with_upgrades();
                watched.drive(connection, |connection| connection.graceful_shutdown()).await;
            }
            Protocol::Grpc => {
                let mut builder = hyper::server::conn::http2::Builder::new(TokioExecutor::new());
                builder
                    .timer(TokioTimer::new())
                    .keep_alive_interval(KEEP_ALIVE)
                    .keep_alive_timeout(KEEP_ALIVE)
                    .initial_stream_window_size(STREAM_WINDOW_BYTES)
                    .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
                    .max_send_buf_size(SEND_BUFFER_BYTES)
                    .max_header_list_size(HEADER_BYTES as u32)
                    .max_concurrent_streams(u32::try_from(limits.max_calls_per_connection).unwrap_or(u32::MAX));
                let connection = builder.serve_connection(io, service);
                watched.drive(connection, |connection| connection.graceful_shutdown()).await;
            }
        }
    }

    async fn answer(
        &self,
        request: Request<Incoming>,
        watch: Arc<Watch>,
        traffic: Arc<Traffic>,
    ) -> Response<Answer<UnderWay>> {
        watch.lock().under_way += 1;
        let under_way = UnderWay { watch: Arc::clone(&watch), traffic };
        let answer = match self.window(&request).await {
            Ok(window) => self.routed(request, window, &watch).await,
            Err(refused) => refused,
        };
        let (parts, body) = answer.into_parts();
        let (body, reader) = Answer::new(body, under_way);
        watch.lock().readers.push(reader);
        Response::from_parts(parts, body)
    }

    async fn routed(&self, request: Request<Incoming>, window: Option<Charge>, watch: &Watch) -> Response<Body> {
        let peer = Peer::at(self.identity.address);
        let (mut parts, body) = request.into_parts();
        let framing = (self.framing)(&parts.uri);
        let (body, sender, held) = Arriving::new(body, framing, &self.shared.memory, &peer, window);
        watch.lock().senders.push(sender);
        parts.extensions.insert(self.identity.clone());
        parts.extensions.insert(self.seat.clone());
        parts.extensions.insert(held.clone());
        let request = Request::from_parts(parts, Body::new(body));
        let Ok(answer) = self.router.clone().oneshot(request).await;
        // What came is held while it is worked on: until the answer begins, or longer if the handler took it.
        drop(held);
        answer
    }

    /// Memory for what HTTP/2 may keep of a body before it is asked for.
    async fn window(&self, request: &Request<Incoming>) -> Result<Option<Charge>, Response<Body>> {
        if self.protocol == Protocol::Rest || request.body().is_end_stream() {
            return Ok(None);
        }
        let mut charge = self.shared.windows.charge(&Peer::at(self.identity.address));
        match charge.grow(STREAM_WINDOW_BYTES as usize).await {
            Ok(()) => Ok(Some(charge)),
            Err(error) => Err(status::grpc(error).into_http::<Body>().into_response()),
        }
    }
}

struct Watching {
    protocol: Protocol,
    limits: Arc<Limits>,
    watch: Arc<Watch>,
    traffic: Arc<Traffic>,
    stopping: tokio::sync::watch::Receiver<bool>,
}

impl Watching {
    /// Polls a connection to its end; `finish` lets it take no more requests.
    async fn drive<C: Future>(self, connection: C, finish: impl Fn(Pin<&mut C>)) {
        let mut connection = pin!(connection);
        let mut looks = tokio::time::interval(LOOK);
        looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut stopping = self.stopping.clone();
        let (mut finishing, mut stopped) = (None, None);
        loop {
            tokio::select! {
                _ = &mut connection => return,
                _ = stopping.wait_for(|s| *s), if stopped.is_none() => {
                    stopped = Some(Instant::now());
                    finish(connection.as_mut());
                    finishing.get_or_insert_with(Instant::now);
                    looks.reset();
                }
                _ = looks.tick() => match self.look(finishing, stopped) {
                    Verdict::Stay => {}
                    Verdict::Finish => {
                        finish(connection.as_mut());
                        finishing.get_or_insert_with(Instant::now);
                    }
                    Verdict::Cut => return,
                },
            }
        }
    }

    /// Looks at the connection, and at every body on it.
    fn look(&self, finishing: Option<Instant>, stopped: Option<Instant>) -> Verdict {
        let now = Instant::now();
        let (patience, is_over) = (Patience::of(&self.limits), stopped.is_some_and(|s| now - s >= LAST_GRACE));
        let unread = if is_over { LAST_GRACE } else { Duration::from_secs(self.limits.unread_timeout_s as u64) };
        let (mut senders, mut readers, look) = {
            let mut state = self.watch.lock();
            let look = Look {
                protocol: self.protocol,
                under_way: state.under_way,
                quiet: now.saturating_duration_since(state.quiet_since),
                since_quiet: self.traffic.received().saturating_sub(state.received),
                received: self.traffic.received(),
                write_waits: self.traffic.write_waits(),
                finishing: finishing.map(|since| now - since),
                is_stopping: stopped.is_some(),
            };
            (std::mem::take(&mut state.senders), std::mem::take(&mut state.readers), look)
        };
        // Not under the lock: what is given up here tells the connection so.
        senders.retain(|sender| sender.check(patience, is_over, now));
        readers.retain(|reader| reader.give_up_after(unread, now));
        let mut state = self.watch.lock();
        state.senders.append(&mut senders);
        state.readers.append(&mut readers);
        drop(state);
        look.verdict(&self.limits)
    }
}

#[cfg(test)]
mod tests;

//! Watches every request of a door: gives it its trace, counts and times it, writes the access log.
//!
//! A request lasts until the end of its answer's body, so that what a stream ends with is known. Doors put [`Observe`]
//! around everything that they serve; zenoh, which is no HTTP, begins a [`Request`] itself.

use super::export;
use super::operations::{self, Operation};
use crate::doors::listener::PeerIdentity;
use axum::http::{self, Extensions, HeaderMap, HeaderValue, StatusCode};
use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use percept_service::observe::{self, Door};
use percept_service::trace::TraceContext;
use std::future::Future;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Instant;
use tonic::Code;
use tower::{Layer, Service};
use tracing::{Instrument, Span};

/// The caller's context comes in so (W3C Trace Context); over zenoh, as the attachment.
const TRACEPARENT: &str = "traceparent";
/// Ours goes out so (W3C Trace Context, level 2).
const TRACERESPONSE: &str = "traceresponse";
/// What is logged when the caller went away.
const CANCELLED: &str = "CANCELLED";

/// Share of requests in the access log: the bits of an `f64`.
static LOG_SHARE: AtomicU64 = AtomicU64::new(0);

/// Logs this share of the requests from now on, 0 to 1.
pub(crate) fn log_share(share: f64) {
    LOG_SHARE.store(share.to_bits(), Ordering::Relaxed);
}

/// A request under way; dropped, it is over, and is counted and logged.
#[derive(Debug)]
pub(crate) struct Request {
    door: Door,
    pub(crate) operation: Operation,
    /// Name of the gRPC code.
    pub(crate) code: &'static str,
    pub(crate) trace: TraceContext,
    /// The caller's span.
    parent_span_id: Option<u64>,
    pub(crate) bytes_in: u64,
    pub(crate) bytes_out: u64,
    pub(crate) peer: Option<SocketAddr>,
    began: Instant,
    span: Span,
    _under_way: observe::Held,
}

impl Request {
    /// A request begins, with the `traceparent` that came with it.
    pub(crate) fn begin(door: Door, operation: Operation, traceparent: Option<&str>) -> Self {
        let parent = traceparent.and_then(TraceContext::parse);
        let trace = parent.map_or_else(|| export::sampled(TraceContext::begin()), TraceContext::child);
        // An error, so that a quiet log still says which request its lines belong to.
        let span = tracing::error_span!("request", trace_id = trace.trace_id_hex());
        Self {
            door,
            operation,
            code: CANCELLED,
            trace,
            parent_span_id: parent.map(|p| p.span_id),
            bytes_in: 0,
            bytes_out: 0,
            peer: None,
            began: Instant::now(),
            span,
            _under_way: observe::request_under_way(door),
        }
    }

    /// Runs what answers it: below, the log and errors name its trace.
    pub(crate) fn scope<F: Future>(&self, work: F) -> impl Future<Output = F::Output> + use<F> {
        self.trace.scope(work.instrument(self.span.clone()))
    }

    fn is_logged(&self) -> bool {
        export::within(self.trace, f64::from_bits(LOG_SHARE.load(Ordering::Relaxed)))
    }
}

impl Drop for Request {
    fn drop(&mut self) {
        let took = self.began.elapsed();
        let timed = (!self.operation.lasts).then_some(took);
        observe::request(self.door, self.operation.name, self.code, timed, self.bytes_out);
        export::finished(&export::RequestSpan {
            trace: self.trace,
            parent_span_id: self.parent_span_id,
            door: self.door,
            operation: self.operation.name,
            code: self.code,
            bytes_in: self.bytes_in,
            bytes_out: self.bytes_out,
            began: self.began,
        });
        if self.is_logged() {
            tracing::info!(
                target: "access",
                door = self.door.name(),
                operation = self.operation.name,
                code = self.code,
                took_ms = took.as_micros() as f64 / 1e3,
                bytes_in = self.bytes_in,
                bytes_out = self.bytes_out,
                peer = self.peer.map(|p| p.to_string()).unwrap_or_default(),
                trace_id = self.trace.trace_id_hex(),
                "request"
            );
        }
    }
}

/// Set on a response by a handler that knows more than HTTP tells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Answered {
    pub(crate) operation: Operation,
}

/// Name of the gRPC code of a refusal, set on a response.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RefusedWith(pub(crate) &'static str);

/// Puts [`Request`] around everything that a door serves.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observe(pub(crate) Door);

impl<S> Layer<S> for Observe {
    type Service = Observed<S>;

    fn layer(&self, inner: S) -> Observed<S> {
        Observed { inner, door: self.0 }
    }
}

/// A service whose requests are watched.
#[derive(Debug, Clone)]
pub(crate) struct Observed<S> {
    inner: S,
    door: Door,
}

impl<S, I, O> Service<http::Request<I>> for Observed<S>
where
    S: Service<http::Request<I>, Response = http::Response<O>>,
    S::Future: Send + 'static,
    O: Body,
{
    type Response = http::Response<ObservedBody<O>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, asked: http::Request<I>) -> Self::Future {
        let header = |name| asked.headers().get(name).and_then(|v: &HeaderValue| v.to_str().ok());
        let operation = match self.door {
            Door::Grpc => operations::of_path(asked.uri().path()),
            // Told by the route that answers.
            Door::Rest | Door::Zenoh => Operation::brief(operations::UNKNOWN),
        };
        let mut request = Request::begin(self.door, operation, header(TRACEPARENT));
        request.bytes_in = header("content-length").and_then(|v| v.parse().ok()).unwrap_or_default();
        request.peer = peer(asked.extensions());
        let answer = {
            let _entered = request.span.clone().entered();
            self.inner.call(asked)
        };
        let answer = request.scope(answer);
        Box::pin(async move {
            let mut response = answer.await?;
            if let Some(told) = response.extensions().get::<Answered>() {
                request.operation = told.operation;
            }
            if let Ok(value) = HeaderValue::try_from(request.trace.to_string()) {
                response.headers_mut().insert(TRACERESPONSE, value);
            }
            let code = match request.door {
                // Without the header, the code comes after the body.
                Door::Grpc => grpc_code(response.headers()),
                Door::Rest | Door::Zenoh => Some(http_code(&response)),
            };
            Ok(response.map(|inner| {
                // An empty body may never be looked at.
                if let Some(code) = code.filter(|_| inner.is_end_stream()) {
                    request.code = code;
                }
                ObservedBody { inner, code, request }
            }))
        })
    }
}

fn peer(extensions: &Extensions) -> Option<SocketAddr> {
    let identity = extensions.get::<PeerIdentity>().map(|identity| identity.address);
    // Where the doors' own listener does not serve.
    identity.or_else(|| extensions.get::<axum::extract::ConnectInfo<SocketAddr>>().map(|info| info.0))
}

fn grpc_code(headers: &HeaderMap) -> Option<&'static str> {
    Some(code_name(Code::from_bytes(headers.get("grpc-status")?.as_bytes())))
}

/// The name of a code, as the gRPC specification has it.
const fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => CANCELLED,
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

/// What the handler said, or what its status comes nearest to.
fn http_code<B>(response: &http::Response<B>) -> &'static str {
    if let Some(RefusedWith(code)) = response.extensions().get() {
        return code;
    }
    match response.status() {
        status if status.as_u16() < 400 => "OK",
        StatusCode::UNAUTHORIZED => "UNAUTHENTICATED",
        StatusCode::FORBIDDEN => "PERMISSION_DENIED",
        StatusCode::NOT_FOUND => "NOT_FOUND",
        StatusCode::CONFLICT => "FAILED_PRECONDITION",
        StatusCode::PAYLOAD_TOO_LARGE | StatusCode::TOO_MANY_REQUESTS => "RESOURCE_EXHAUSTED",
        StatusCode::REQUEST_TIMEOUT | StatusCode::GATEWAY_TIMEOUT => "DEADLINE_EXCEEDED",
        StatusCode::SERVICE_UNAVAILABLE => "UNAVAILABLE",
        status if status.is_client_error() => "INVALID_ARGUMENT",
        _ => "INTERNAL",
    }
}

/// An answer's body: when it ends, so does its request.
#[derive(Debug)]
pub(crate) struct ObservedBody<B> {
    inner: B,
    /// Known beforehand, or from the trailers; none while it may still become anything.
    code: Option<&'static str>,
    request: Request,
}

impl<B: Body<Data = Bytes> + Unpin> Body for ObservedBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let polled = {
            let _entered = self.request.span.clone().entered();
            Pin::new(&mut self.inner).poll_frame(context)
        };
        match &polled {
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(data) = frame.data_ref() {
                    self.request.bytes_out += data.len() as u64;
                }
                if let Some(code) = frame.trailers_ref().and_then(grpc_code) {
                    self.code = Some(code);
                    self.request.code = code;
                }
            }
            Poll::Ready(Some(Err(_))) => self.request.code = "INTERNAL",
            Poll::Ready(None) => self.request.code = self.code.unwrap_or("UNKNOWN"),
            Poll::Pending => {}
        }
        // Its reader may look no further.
        if self.inner.is_end_stream()
            && let Some(code) = self.code
        {
            self.request.code = code;
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

//! What the server counts and times, for `/metrics`. Whoever does something that an operator wants to see calls one of
//! these functions; names, labels and buckets stand in [`families`] alone.
//!
//! Labels hold words of ours and never what a caller sent, so that nobody outside can make series without end; no series
//! is a session's own. What is shared by sessions is a sum, to which each adds its part ([`SessionShare`]).

mod families;
mod share;

use crate::reason;
use crate::{OperationKind, OperationState, SessionState};
use families::FAMILIES;
use percept_geometry::SensorKind;
use prometheus_client::collector::Collector;
use prometheus_client::metrics::gauge::Gauge;
use std::sync::PoisonError;
use std::time::{Duration, Instant};

pub use share::SessionShare;

/// Which way a request came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Door {
    /// gRPC.
    Grpc,
    /// REST.
    Rest,
    /// Zenoh.
    Zenoh,
}

impl Door {
    /// As labels and logs spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Grpc => "grpc",
            Self::Rest => "rest",
            Self::Zenoh => "zenoh",
        }
    }
}

/// What lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stream {
    /// Frames in.
    Ingest,
    /// Events out.
    Watch,
}

/// What the compute pool is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Work {
    /// Frames and changes of a session's map.
    Frame,
    /// What a session does beside its frames: recognising places, solving its pose graph.
    Beside,
    /// Answers that are computed.
    Request,
}

impl Work {
    const fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Beside => "beside",
            Self::Request => "request",
        }
    }
}

const STATES: [SessionState; 6] = [
    SessionState::Creating,
    SessionState::Asleep,
    SessionState::Waking,
    SessionState::Awake,
    SessionState::Faulted,
    SessionState::Deleting,
];

const fn state_name(state: SessionState) -> &'static str {
    match state {
        SessionState::Creating => "creating",
        SessionState::Asleep => "asleep",
        SessionState::Waking => "waking",
        SessionState::Awake => "awake",
        SessionState::Faulted => "faulted",
        SessionState::Deleting => "deleting",
    }
}

/// One more for as long as it is held.
#[derive(Debug)]
#[must_use]
pub struct Held(Gauge);

impl Held {
    fn of(gauge: &Gauge) -> Self {
        gauge.inc();
        Self(gauge.clone())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.0.dec();
    }
}

/// Whether requests are taken.
pub(crate) fn ready(is_ready: bool) {
    FAMILIES.ready.set(i64::from(is_ready));
}

/// A part of the server came into trouble, or out of it.
pub(crate) fn trouble(part: &'static str, reason: &'static str, is_there: bool) {
    FAMILIES.troubles.get_or_create(&[("part", part), ("reason", reason)]).set(i64::from(is_there));
}

/// Until when the server's certificate holds, seconds since the Unix epoch.
pub fn certificate_expiry(at_s: i64) {
    FAMILIES.certificate_expiry.get_or_create(&[]).set(at_s);
}

/// A request was answered. `took` is none for streams that last: their time says nothing.
pub fn request(door: Door, operation: &'static str, code: &'static str, took: Option<Duration>, bytes: u64) {
    let (door, operation) = (("door", door.name()), ("operation", operation));
    FAMILIES.requests.get_or_create(&[door, operation, ("code", code)]).inc();
    FAMILIES.response_bytes.get_or_create(&[door]).inc_by(bytes);
    if let Some(took) = took {
        FAMILIES.request_seconds.get_or_create(&[door, operation]).observe(took.as_secs_f64());
    }
}

/// A request is being answered.
pub fn request_under_way(door: Door) -> Held {
    Held::of(&FAMILIES.requests_under_way.get_or_create(&[("door", door.name())]))
}

/// A connection is open.
pub fn connection(door: Door) -> Held {
    Held::of(&FAMILIES.connections.get_or_create(&[("door", door.name())]))
}

/// A stream is open.
pub fn stream(stream: Stream) -> Held {
    let kind = match stream {
        Stream::Ingest => "ingest",
        Stream::Watch => "watch",
    };
    Held::of(&FAMILIES.streams.get_or_create(&[("kind", kind)]))
}

/// A request or a frame was refused with this reason.
pub fn refusal(reason: &'static str) {
    FAMILIES.refusals.get_or_create(&[("reason", reason)]).inc();
}

/// A request was refused to keep the load bearable: a rate, a queue, a limit of connections.
pub fn shed(reason: &'static str) {
    FAMILIES.shed.get_or_create(&[("reason", reason)]).inc();
}

/// Someone was not let in.
pub fn login_refused(reason: &'static str) {
    FAMILIES.logins_refused.get_or_create(&[("reason", reason)]).inc();
}

const fn kind_name(kind: SensorKind) -> &'static str {
    match kind {
        SensorKind::Depth => "depth",
        SensorKind::Rgbd => "rgbd",
        SensorKind::Camera => "camera",
        SensorKind::Lidar3d => "lidar3d",
        SensorKind::Lidar2d => "lidar2d",
        SensorKind::Imu => "imu",
        SensorKind::Odometry => "odometry",
    }
}

/// A frame was processed, after waiting in its session's queue.
pub fn frame_accepted(kind: SensorKind, waited: Duration, took: Duration) {
    let kind = [("kind", kind_name(kind))];
    FAMILIES.frames_accepted.get_or_create(&kind).inc();
    FAMILIES.frame_queue_seconds.get_or_create(&kind).observe(waited.as_secs_f64());
    FAMILIES.frame_processing_seconds.get_or_create(&kind).observe(took.as_secs_f64());
}

/// A frame was refused; its kind is none where it could not be told.
pub fn frame_refused(kind: Option<SensorKind>, reason: &'static str) {
    let kind = kind.map_or("unknown", kind_name);
    FAMILIES.frames_refused.get_or_create(&[("kind", kind), ("reason", reason)]).inc();
}

/// A frame gave way to newer ones.
pub fn frame_dropped(kind: SensorKind) {
    FAMILIES.frames_dropped.get_or_create(&[("kind", kind_name(kind))]).inc();
}

/// A frame that arrived so long ago survives a crash from now on.
pub fn frame_durable(since: Duration) {
    FAMILIES.frame_durable_seconds.observe(since.as_secs_f64());
}

/// A frame waits in its session's queue.
pub fn frame_queued() -> Held {
    Held::of(&FAMILIES.frames_queued)
}

/// A session came into a state, or left one, or both; none stands before its birth and after its end.
pub(crate) fn session_moved(from: Option<SessionState>, to: Option<SessionState>) {
    let gauge = |state: SessionState| FAMILIES.sessions.get_or_create_owned(&[("state", state_name(state))]);
    if let Some(to) = to {
        gauge(to).inc();
    }
    if let Some(from) = from {
        gauge(from).dec();
    }
}

/// A session was put to sleep.
pub(crate) fn session_slept() {
    FAMILIES.sleeps.inc();
}

/// A session was woken, or could not be.
pub fn session_woken(took: Duration, outcome: Result<(), &'static str>) {
    FAMILIES.wakes.get_or_create(&[("outcome", outcome.err().unwrap_or("OK"))]).inc();
    FAMILIES.wake_seconds.observe(took.as_secs_f64());
}

/// A session became faulted.
pub fn session_faulted(reason: &'static str) {
    FAMILIES.session_faults.get_or_create(&[("reason", reason)]).inc();
}

/// So many clouds are kept for toolbox requests, and so large.
pub fn kept_clouds(count: usize, bytes: usize) {
    FAMILIES.kept_clouds.set(i64::try_from(count).unwrap_or(i64::MAX));
    FAMILIES.kept_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
}

/// An operation came into a state, or left one, or both; none stands before its start and after it was forgotten.
pub(crate) fn operation_moved(from: Option<OperationState>, to: Option<OperationState>) {
    let gauge = |state: OperationState| FAMILIES.operations.get_or_create_owned(&[("state", state.name())]);
    if let Some(to) = to {
        gauge(to).inc();
    }
    if let Some(from) = from {
        gauge(from).dec();
    }
}

/// An operation ended; `took` is how long it ran, if it did.
pub(crate) fn operation_ended(kind: OperationKind, state: OperationState, took: Option<Duration>) {
    let kind = ("kind", kind.name());
    FAMILIES.operations_ended.get_or_create(&[kind, ("state", state.name())]).inc();
    if let Some(took) = took {
        FAMILIES.operation_seconds.get_or_create(&[kind]).observe(took.as_secs_f64());
    }
}

/// So much memory do operations' requests and results take.
pub(crate) fn operation_bytes(bytes: usize) {
    FAMILIES.operation_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
}

/// A batch of records became durable.
pub fn store_commit(took: Duration, bytes: usize) {
    FAMILIES.store_commits.inc();
    FAMILIES.store_commit_seconds.observe(took.as_secs_f64());
    FAMILIES.store_written_bytes.inc_by(bytes as u64);
}

/// A blob was stored.
pub fn store_blob(bytes: usize) {
    FAMILIES.store_blobs.inc();
    FAMILIES.store_blob_bytes.inc_by(bytes as u64);
}

/// A call to the storage failed.
pub fn store_fault(reason: &'static str) {
    FAMILIES.store_faults.get_or_create(&[("reason", reason)]).inc();
}

/// A frame was processed and waits to become durable.
pub fn store_backlog() -> Held {
    Held::of(&FAMILIES.store_backlog)
}

/// Unused blobs were removed.
pub fn store_garbage(blobs: u64, bytes: u64) {
    FAMILIES.garbage_blobs.inc_by(blobs);
    FAMILIES.garbage_bytes.inc_by(bytes);
}

/// A computation waits for a thread.
#[must_use]
pub fn compute_waiting(work: Work) -> Waiting {
    let kind = [("kind", work.name())];
    Waiting { work, since: Instant::now(), _held: Held::of(&FAMILIES.compute_waiting.get_or_create(&kind)) }
}

/// A computation that waits; dropped, it never ran.
#[derive(Debug)]
pub struct Waiting {
    work: Work,
    since: Instant,
    _held: Held,
}

impl Waiting {
    /// It has a thread now; what comes back is held until it is done.
    #[must_use]
    pub fn start(self) -> Running {
        let kind = [("kind", self.work.name())];
        FAMILIES.compute_wait_seconds.get_or_create(&kind).observe(self.since.elapsed().as_secs_f64());
        let held = Held::of(&FAMILIES.compute_running.get_or_create(&kind));
        Running { work: self.work, since: Instant::now(), _held: held }
    }
}

/// A computation that runs.
#[derive(Debug)]
pub struct Running {
    work: Work,
    since: Instant,
    _held: Held,
}

impl Drop for Running {
    fn drop(&mut self) {
        let kind = [("kind", self.work.name())];
        FAMILIES.compute_seconds.get_or_create(&kind).observe(self.since.elapsed().as_secs_f64());
    }
}

/// Adds metrics that are read when they are asked for.
pub fn add(collector: impl Collector) {
    let mut registry = FAMILIES.registry.lock().unwrap_or_else(PoisonError::into_inner);
    registry.register_collector(Box::new(collector));
}

/// Makes the series exist whose labels are known beforehand, so that a rate is right from the first count on and a panel
/// shows zero instead of nothing.
pub fn prepare() {
    for state in STATES {
        drop(FAMILIES.sessions.get_or_create(&[("state", state_name(state))]));
    }
    share::prepare();
    for kind in [
        SensorKind::Depth,
        SensorKind::Rgbd,
        SensorKind::Camera,
        SensorKind::Lidar3d,
        SensorKind::Lidar2d,
        SensorKind::Imu,
        SensorKind::Odometry,
    ] {
        let kind = [("kind", kind_name(kind))];
        drop(FAMILIES.frames_accepted.get_or_create(&kind));
        drop(FAMILIES.frames_dropped.get_or_create(&kind));
    }
    for door in [Door::Grpc, Door::Rest, Door::Zenoh] {
        drop(FAMILIES.connections.get_or_create(&[("door", door.name())]));
        drop(FAMILIES.requests_under_way.get_or_create(&[("door", door.name())]));
    }
    for work in [Work::Frame, Work::Beside, Work::Request] {
        let kind = [("kind", work.name())];
        drop(FAMILIES.compute_waiting.get_or_create(&kind));
        drop(FAMILIES.compute_running.get_or_create(&kind));
        drop(FAMILIES.compute_seconds.get_or_create(&kind));
        drop(FAMILIES.compute_wait_seconds.get_or_create(&kind));
    }
    for state in OperationState::ALL {
        drop(FAMILIES.operations.get_or_create(&[("state", state.name())]));
    }
    for kind in OperationKind::ALL.map(|kind| ("kind", kind.name())) {
        drop(FAMILIES.operations_ended.get_or_create(&[kind, ("state", OperationState::Done.name())]));
        drop(FAMILIES.operation_seconds.get_or_create(&[kind]));
    }
    drop(FAMILIES.wakes.get_or_create(&[("outcome", "OK")]));
    for reason in [reason::STORAGE_FAULT, reason::STORAGE_FULL, reason::STORAGE_FENCED] {
        drop(FAMILIES.store_faults.get_or_create(&[("reason", reason)]));
    }
    for kind in ["ingest", "watch"] {
        drop(FAMILIES.streams.get_or_create(&[("kind", kind)]));
    }
}

/// Everything in the text format of OpenMetrics 1.0, which Prometheus reads.
pub fn text() -> String {
    let registry = FAMILIES.registry.lock().unwrap_or_else(PoisonError::into_inner);
    let mut text = String::with_capacity(64 << 10);
    // Writing to a string fails only if a collector does; what came before it is whole lines all the same.
    if prometheus_client::encoding::text::encode(&mut text, &registry).is_err() {
        tracing::warn!("metrics are incomplete: a collector failed");
    }
    text
}

/// Media type of [`text`].
pub const TEXT_MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

#[cfg(test)]
mod tests {
    use super::*;

    fn value(series: &str) -> Option<f64> {
        let text = text();
        let line = text.lines().find(|l| l.strip_prefix(series).is_some_and(|rest| rest.starts_with(' ')))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    #[test]
    fn a_request_is_counted_and_timed() {
        let took = Some(Duration::from_millis(3));
        request(Door::Zenoh, "TestOnly", "OK", took, 10);
        request(Door::Zenoh, "TestOnly", "OK", None, 10);
        let series = r#"percept_requests_total{door="zenoh",operation="TestOnly",code="OK"}"#;
        assert_eq!(value(series), Some(2.0));
        let timed = r#"percept_request_duration_seconds_count{door="zenoh",operation="TestOnly"}"#;
        assert_eq!(value(timed), Some(1.0));
        let bucket = r#"percept_request_duration_seconds_bucket{le="0.005",door="zenoh",operation="TestOnly"}"#;
        assert_eq!(value(bucket), Some(1.0));
    }

    #[test]
    fn what_is_held_is_counted_until_it_is_let_go() {
        let gauge = Gauge::default();
        let (one, two) = (Held::of(&gauge), Held::of(&gauge));
        assert_eq!(gauge.get(), 2);
        drop((one, two));
        assert_eq!(gauge.get(), 0);
    }

    #[test]
    fn a_session_is_in_one_state() {
        let of = |state: SessionState| FAMILIES.sessions.get_or_create(&[("state", state_name(state))]).get();
        session_moved(None, Some(SessionState::Creating));
        session_moved(Some(SessionState::Creating), Some(SessionState::Deleting));
        assert_eq!((of(SessionState::Creating), of(SessionState::Deleting)), (0, 1));
        session_moved(Some(SessionState::Deleting), None);
        assert_eq!(of(SessionState::Deleting), 0);
    }

    #[test]
    fn the_text_ends_as_the_format_wants() {
        prepare();
        assert!(text().ends_with("# EOF\n"));
    }
}

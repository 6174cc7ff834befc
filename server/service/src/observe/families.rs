//! Every family of metrics: its name, its labels, its buckets. No label's values come from outside.

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry};
use std::sync::atomic::AtomicU64;
use std::sync::{LazyLock, Mutex};

/// Names and values of a series; the values are our own words.
pub(super) type Labels<const N: usize> = [(&'static str, &'static str); N];
pub(super) type Counters<const N: usize> = Family<Labels<N>, Counter>;
pub(super) type Gauges<const N: usize> = Family<Labels<N>, Gauge>;
pub(super) type Times<const N: usize> = Family<Labels<N>, Histogram, fn() -> Histogram>;
pub(super) type Seconds = Counter<f64, AtomicU64>;

/// Bounds of answers and frames, seconds: from a pose read from memory to a large map written.
fn times() -> Histogram {
    Histogram::new([0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0])
}

/// All of them, and the registry that prints them.
pub(super) struct Families {
    pub(super) registry: Mutex<Registry>,
    // The server.
    pub(super) ready: Gauge,
    pub(super) troubles: Gauges<2>,
    /// No series where there is no certificate.
    pub(super) certificate_expiry: Gauges<0>,
    // Requests.
    pub(super) requests: Counters<3>,
    pub(super) request_seconds: Times<2>,
    pub(super) requests_under_way: Gauges<1>,
    pub(super) response_bytes: Counters<1>,
    pub(super) refusals: Counters<1>,
    pub(super) shed: Counters<1>,
    pub(super) logins_refused: Counters<1>,
    pub(super) connections: Gauges<1>,
    pub(super) streams: Gauges<1>,
    // Frames.
    pub(super) frames_accepted: Counters<1>,
    pub(super) frames_refused: Counters<2>,
    pub(super) frames_dropped: Counters<1>,
    pub(super) frame_queue_seconds: Times<1>,
    pub(super) frame_processing_seconds: Times<1>,
    pub(super) frame_durable_seconds: Histogram,
    pub(super) frames_queued: Gauge,
    // Sessions and what they hold.
    pub(super) sessions: Gauges<1>,
    pub(super) sessions_tracking: Gauges<1>,
    pub(super) tracking_changes: Counters<1>,
    pub(super) tracking_lost: Counters<1>,
    pub(super) lost_seconds: Seconds,
    pub(super) keyframes: Gauge,
    pub(super) objects: Gauge,
    pub(super) memory_bytes: Gauge,
    pub(super) sleeps: Counter,
    pub(super) wakes: Counters<1>,
    pub(super) wake_seconds: Histogram,
    pub(super) session_faults: Counters<1>,
    pub(super) kept_clouds: Gauge,
    pub(super) kept_bytes: Gauge,
    // Operations.
    pub(super) operations: Gauges<1>,
    pub(super) operations_ended: Counters<2>,
    pub(super) operation_seconds: Times<1>,
    pub(super) operation_bytes: Gauge,
    // Storage.
    pub(super) store_commits: Counter,
    pub(super) store_commit_seconds: Histogram,
    pub(super) store_written_bytes: Counter,
    pub(super) store_blobs: Counter,
    pub(super) store_blob_bytes: Counter,
    pub(super) store_faults: Counters<1>,
    pub(super) store_backlog: Gauge,
    pub(super) garbage_blobs: Counter,
    pub(super) garbage_bytes: Counter,
    // Computing.
    pub(super) compute_waiting: Gauges<1>,
    pub(super) compute_running: Gauges<1>,
    pub(super) compute_wait_seconds: Times<1>,
    pub(super) compute_seconds: Times<1>,
}

/// The process's own.
pub(super) static FAMILIES: LazyLock<Families> = LazyLock::new(Families::new);

/// Registers what it makes.
struct Printed<'a>(&'a mut Registry);

impl Printed<'_> {
    fn put<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        self.0.register(name, help, metric.clone());
        metric
    }

    fn plain<M: Metric + Clone + Default>(&mut self, name: &str, help: &str) -> M {
        self.put(name, help, M::default())
    }

    fn times<const N: usize>(&mut self, name: &str, help: &str) -> Times<N> {
        self.put(name, help, Family::new_with_constructor(times as fn() -> Histogram))
    }
}

impl Families {
    #[rustfmt::skip]
    fn new() -> Self {
        let mut registry = Registry::default();
        let mut to = Printed(registry.sub_registry_with_prefix("percept"));
        let families = Self {
            ready: to.plain("ready", "Whether requests are taken, 1 or 0, as /readyz has it"),
            troubles: to.plain("trouble", "What keeps the server from its work: 1 by part and reason, 0 once it is over"),
            certificate_expiry: to.plain("tls_certificate_expiry_timestamp_seconds", "When the first of tls.cert_file's certificates ends, since the Unix epoch; absent without TLS"),

            requests: to.plain("requests", "Requests answered, by door, operation and code"),
            request_seconds: to.times("request_duration_seconds", "Time from a request to the end of its answer; streams that last are left out"),
            requests_under_way: to.plain("requests_under_way", "Requests being answered, streams included"),
            response_bytes: to.plain("response_bytes", "Bytes of answers, as they are sent"),
            refusals: to.plain("refusals", "Requests and frames refused, by reason"),
            shed: to.plain("shed", "Requests refused to keep the load bearable, by reason"),
            logins_refused: to.plain("logins_refused", "Requests refused for who asks, by reason"),
            connections: to.plain("connections", "Open connections, by door"),
            streams: to.plain("streams", "Open streams: frames in, events out"),

            frames_accepted: to.plain("frames_accepted", "Frames processed, by kind of sensor"),
            frames_refused: to.plain("frames_refused", "Frames refused as bad input or for a fault, by kind of sensor and reason"),
            frames_dropped: to.plain("frames_dropped", "Frames dropped because newer ones came before they could be processed"),
            frame_queue_seconds: to.times("frame_queue_seconds", "Time that a frame waited in its session's queue"),
            frame_processing_seconds: to.times("frame_processing_seconds", "Time that a frame's processing took"),
            frame_durable_seconds: to.put("frame_durable_seconds", "Time from a frame's arrival until it survives a crash", times()),
            frames_queued: to.plain("frames_queued", "Frames waiting in sessions' queues"),

            sessions: to.plain("sessions", "Sessions by state"),
            sessions_tracking: to.plain("sessions_tracking", "Awake sessions by state of tracking"),
            tracking_changes: to.plain("tracking_changes", "Changes of tracking, by the state that follows"),
            tracking_lost: to.plain("tracking_lost", "Times that tracking was lost, by reason"),
            lost_seconds: to.plain("lost_seconds", "Time that robots sent frames while lost, by their stamps"),
            keyframes: to.plain("keyframes", "Keyframes of all awake sessions"),
            objects: to.plain("objects", "Objects of all awake sessions"),
            memory_bytes: to.plain("sessions_memory_bytes", "Memory of all awake sessions: layers, scans, places, graphs, trajectories, local models"),
            sleeps: to.plain("session_sleeps", "Sessions put to sleep"),
            wakes: to.plain("session_wakes", "Sessions woken, by outcome"),
            wake_seconds: to.put("session_wake_seconds", "Time that waking a session took", times()),
            session_faults: to.plain("session_faults", "Sessions that became faulted, by reason"),
            kept_clouds: to.plain("kept_clouds", "Clouds kept for toolbox requests"),
            kept_bytes: to.plain("kept_bytes", "Memory of the clouds kept for toolbox requests"),

            operations: to.plain("operations", "Operations that are kept, by state"),
            operations_ended: to.plain("operations_ended", "Operations that ended, by kind and state"),
            operation_seconds: to.times("operation_duration_seconds", "Time that an operation ran, by kind"),
            operation_bytes: to.plain("operation_bytes", "Memory of operations' requests and results"),

            store_commits: to.plain("store_commits", "Batches made durable"),
            store_commit_seconds: to.put("store_commit_seconds", "Time until a batch was durable", times()),
            store_written_bytes: to.plain("store_written_bytes", "Bytes of records made durable"),
            store_blobs: to.plain("store_blobs_written", "Blobs stored"),
            store_blob_bytes: to.plain("store_blob_bytes", "Bytes of blobs stored"),
            store_faults: to.plain("store_faults", "Calls to the storage that failed, by reason"),
            store_backlog: to.plain("store_backlog", "Frames processed and not yet durable"),
            garbage_blobs: to.plain("store_garbage_blobs", "Unused blobs removed"),
            garbage_bytes: to.plain("store_garbage_bytes", "Bytes of unused blobs removed"),

            compute_waiting: to.plain("compute_waiting", "Computations waiting for a thread, by kind"),
            compute_running: to.plain("compute_running", "Computations running, by kind"),
            compute_wait_seconds: to.times("compute_wait_seconds", "Time that a computation waited, by kind"),
            compute_seconds: to.times("compute_seconds", "Time that a computation took, by kind"),

            registry: Mutex::new(Registry::default()),
        };
        Self { registry: Mutex::new(registry), ..families }
    }
}

//! What a request may ask for at most.

use serde::{Deserialize, Serialize};

/// Bounds on every input and answer; going over one gives `RESOURCE_EXHAUSTED` or `INVALID_ARGUMENT`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// One sensor message, toolbox request or upload, bytes.
    pub max_message_bytes: usize,
    /// Pixels of an image, after decompression.
    pub max_image_pixels: usize,
    /// Points of a cloud, beams of a scan.
    pub max_cloud_points: usize,
    /// Sessions on this server.
    pub max_sessions: usize,
    /// Sensors of a session.
    pub max_sensors_per_session: usize,
    /// Frames waiting in a session's queue.
    pub queue_length: usize,
    /// Cells of one grid answer.
    pub max_grid_cells: usize,
    /// Cells that one path search may look at.
    pub max_planning_cells: usize,
    /// Toolbox requests computed at a time, and questions about maps and scenes; more wait.
    pub max_concurrent_computations: usize,
    /// Requests of each of these kinds that wait to be computed; beyond it they are refused.
    pub max_queued_computations: usize,
    /// Time that one toolbox request may compute, milliseconds.
    pub max_computation_ms: usize,
    /// A cloud or file that is uploaded in parts, bytes.
    pub max_upload_bytes: usize,
    /// Clouds that are kept for toolbox requests.
    pub max_kept_clouds: usize,
    /// Memory of those clouds, bytes.
    pub max_kept_bytes: usize,
    /// Time that a kept cloud stays unused before it is forgotten, seconds; an upload may ask for less.
    pub max_kept_s: usize,
    /// Operations that run at a time; more wait, in turns among their owners. Each holds a place where the plain call would: fewer
    /// than max_concurrent_computations leave room for those.
    pub max_running_operations: usize,
    /// The same of one owner.
    pub max_running_operations_per_owner: usize,
    /// Time that one operation may run, seconds.
    pub max_operation_s: usize,
    /// Operations that are kept, waiting, running or ended.
    pub max_operations: usize,
    /// The same of one owner.
    pub max_operations_per_owner: usize,
    /// Memory of the requests of operations under way and of the results of those that have ended, bytes.
    pub max_operation_bytes: usize,
    /// The same of one owner.
    pub max_operation_bytes_per_owner: usize,
    /// Time that an operation is kept after its end, with its result, seconds.
    pub operation_kept_s: usize,
    /// A learned detector's model that is uploaded, bytes; the message that it comes in has its own limit, max_message_bytes.
    pub max_detector_bytes: usize,
    /// Uploaded detectors that the server keeps.
    pub max_detectors: usize,
    /// The same of one tenant.
    pub max_detectors_per_tenant: usize,
    /// Models of all uploaded detectors, bytes; in memory they take about three times as much at worst.
    pub max_detectors_bytes: usize,
    /// Events kept for watchers that resume.
    pub event_history: usize,
    /// The same for watchers of all sessions, over all of them.
    pub fleet_event_history: usize,
    /// Time that a session stays in memory unused before it is put to sleep, seconds; the next use wakes it.
    pub sleep_after_s: usize,
    /// Memory of this process from which on sessions are put to sleep that were not used for the longest time, MiB; 0:
    /// half of the machine's. Where all are in use each has to do with less, until it is enough.
    pub max_memory_mb: usize,
    /// Memory of one session, MiB: what keyframes saw, submaps, what is composed of them, places, graph, local model. Beyond it
    /// submaps far from the robot go to a file in the data directory, or where the system has temporary files, and come back when
    /// needed. What is not of the map stays, and so does the submap that the robot is in.
    pub max_session_memory_mb: usize,
    /// Memory of messages and bodies under way, bytes, in all, and half as much for what HTTP/2 keeps of them; beyond it
    /// they are refused.
    pub max_bytes_in_flight: usize,
    /// The same of one peer: a client's address, a session on zenoh.
    pub max_bytes_in_flight_per_peer: usize,
    /// Connections to each of gRPC and REST; fewer if the process may not open as many files.
    pub max_connections: usize,
    /// The same from one address.
    pub max_connections_per_peer: usize,
    /// Calls under way on one gRPC connection.
    pub max_calls_per_connection: usize,
    /// Ingest streams on gRPC.
    pub max_ingest_streams: usize,
    /// Watchers of events, on gRPC and REST.
    pub max_watchers: usize,
    /// The same from one address.
    pub max_watchers_per_peer: usize,
    /// Time for a request's header, and for TLS to agree, seconds.
    pub header_timeout_s: usize,
    /// Time in which some of a request's body has to come, seconds; all of it may take as long, and a second for
    /// each 16 KiB.
    pub body_timeout_s: usize,
    /// Time without a request after which a connection is closed, seconds.
    pub idle_timeout_s: usize,
    /// Time without a message after which an ingest stream is closed, seconds.
    pub stream_idle_timeout_s: usize,
    /// Time after which an answer that is not read is given up, seconds.
    pub unread_timeout_s: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_message_bytes: 32 << 20,
            max_image_pixels: 16 << 20,
            max_cloud_points: 2_000_000,
            max_sessions: 10_000,
            max_sensors_per_session: 64,
            queue_length: 16,
            max_grid_cells: 64 << 20,
            max_planning_cells: 16 << 20,
            max_concurrent_computations: 4,
            max_queued_computations: 64,
            max_computation_ms: 60_000,
            max_upload_bytes: 256 << 20,
            max_kept_clouds: 256,
            max_kept_bytes: 1 << 30,
            max_kept_s: 600,
            max_running_operations: 3,
            max_running_operations_per_owner: 1,
            max_operation_s: 600,
            max_operations: 1024,
            max_operations_per_owner: 64,
            max_operation_bytes: 1 << 30,
            max_operation_bytes_per_owner: 512 << 20,
            operation_kept_s: 3600,
            max_detector_bytes: 64 << 20,
            max_detectors: 64,
            max_detectors_per_tenant: 8,
            max_detectors_bytes: 256 << 20,
            event_history: 1024,
            fleet_event_history: 8192,
            sleep_after_s: 300,
            max_memory_mb: 0,
            max_session_memory_mb: 256,
            max_bytes_in_flight: 512 << 20,
            max_bytes_in_flight_per_peer: 256 << 20,
            max_connections: 2048,
            max_connections_per_peer: 512,
            max_calls_per_connection: 128,
            max_ingest_streams: 512,
            max_watchers: 1024,
            max_watchers_per_peer: 256,
            header_timeout_s: 10,
            body_timeout_s: 20,
            idle_timeout_s: 300,
            stream_idle_timeout_s: 600,
            unread_timeout_s: 30,
        }
    }
}

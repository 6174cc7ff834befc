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
    /// Toolbox and planning requests computed at a time; more wait.
    pub max_concurrent_computations: usize,
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
    /// Events kept for watchers that resume.
    pub event_history: usize,
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
            max_computation_ms: 60_000,
            max_upload_bytes: 256 << 20,
            max_kept_clouds: 256,
            max_kept_bytes: 1 << 30,
            max_kept_s: 600,
            event_history: 1024,
        }
    }
}

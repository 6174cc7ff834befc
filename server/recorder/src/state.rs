//! How a recording stands.

use std::path::PathBuf;

/// What has come of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingState {
    /// Frames that were written.
    pub num_frames: u64,
    /// Messages that were written; a frame is one to four, a pose two, and mounts are one each time they are told.
    pub num_messages: u64,
    /// What is not in the files.
    pub dropped: Dropped,
    /// Bytes of all files; what waits to be packed is counted as it is.
    pub num_bytes: u64,
    /// The files, in their order.
    pub files: Vec<PathBuf>,
    /// Why the first frame was dropped that cannot be said in messages; recording went on.
    pub fault: Option<String>,
    /// Why recording ended before its time.
    pub error: Option<String>,
    /// Whether that was because the disk is full, or has no more left than it is to keep.
    pub is_disk_full: bool,
}

/// Frames and poses that are not in the files, by why.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// The disk is slower than the sensors: what may wait of the recording was full.
    pub too_slow: u64,
    /// What may wait of all recordings together was full.
    pub no_shared_room: u64,
    /// They cannot be said in messages.
    pub unwritable: u64,
    /// The disk refused, or the recording had ended.
    pub ended: u64,
}

impl Dropped {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.too_slow + self.no_shared_room + self.unwritable + self.ended
    }
}

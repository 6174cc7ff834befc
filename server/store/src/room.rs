//! What of a disk data leave free.

use std::path::Path;

use crate::error::StoreError;

/// Bytes that stay free, or [`SHARE`] of a small disk: who deletes a session, starts a server or wakes a session writes a little, too,
/// and on a disk that data had filled to its last block nothing could be deleted any more. A session that wakes takes 16 KiB, measured
/// by `statvfs`, a deletion less: room for thousands.
const LEFT_FREE: u64 = 64 << 20;
/// A twentieth.
const SHARE: u64 = 20;

/// Whether there is room for data on the disk of a directory, beyond what stays free for deletions. Where the system does not say, there is.
///
/// # Errors
/// [`StoreError::Full`].
pub fn check_room(directory: &Path) -> Result<(), StoreError> {
    let Ok(disk) = rustix::fs::statvfs(directory) else { return Ok(()) };
    let (all, free) = (disk.f_blocks.saturating_mul(disk.f_frsize), disk.f_bavail.saturating_mul(disk.f_frsize));
    if free < LEFT_FREE.min(all / SHARE) { Err(StoreError::Full) } else { Ok(()) }
}

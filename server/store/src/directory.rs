//! A local directory made ready: created, locked, cleared of what a crash left half-written.

use std::fs::{DirBuilder, File, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::error::StoreError;

const LOCK: &str = "LOCK";

/// Holds the directory's lock until it is dropped (or the process dies).
#[derive(Debug)]
pub(crate) struct DirectoryLock {
    _file: File,
}

/// Makes the directory, which is then its owner's alone, and syncs its entry. One that is there keeps its mode.
pub(crate) fn prepare(root: &Path, fsync: bool) -> Result<(), StoreError> {
    let io = |error| StoreError::from_io("prepare the data directory", named(root, error));
    let existed = root.exists();
    if let Some(parent) = root.parent() {
        std::fs::create_dir_all(parent).map_err(io)?;
    }
    // What is inside follows the umask: nobody else gets that far.
    DirBuilder::new().recursive(true).mode(0o700).create(root).map_err(io)?;
    if fsync {
        sync(root).map_err(io)?;
        if let (false, Some(parent)) = (existed, root.canonicalize().map_err(io)?.parent()) {
            sync(parent).map_err(io)?;
        }
    }
    Ok(())
}

/// An error that says of which directory it is, and that it is none where a file has its name.
fn named(root: &Path, error: std::io::Error) -> std::io::Error {
    match error.kind() {
        // These are known by their number.
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => error,
        _ if root.is_file() => std::io::Error::new(ErrorKind::NotADirectory, format!("{} is a file", root.display())),
        kind => std::io::Error::new(kind, format!("{}: {error}", root.display())),
    }
}

/// Takes the lock, waiting for at most `wait`.
pub(crate) async fn lock(root: &Path, wait: Duration) -> Result<DirectoryLock, StoreError> {
    let io = |error| StoreError::from_io("lock the data directory", named(root, error));
    let file = File::options().create(true).truncate(false).write(true).open(root.join(LOCK)).map_err(io)?;
    let deadline = Instant::now() + wait;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(DirectoryLock { _file: file }),
            Err(TryLockError::WouldBlock) if Instant::now() < deadline => {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            Err(TryLockError::WouldBlock) => return Err(StoreError::DirectoryInUse { path: root.to_path_buf() }),
            Err(TryLockError::Error(error)) => return Err(io(error)),
        }
    }
}

/// Removes staged files (`name#1`) that a killed writer never published. Only under the lock.
pub(crate) fn remove_staged(directory: &Path) -> std::io::Result<u64> {
    let mut removed = 0;
    for entry in std::fs::read_dir(directory)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            removed += remove_staged(&entry.path())?;
        } else if is_staged(&entry.file_name().to_string_lossy()) {
            std::fs::remove_file(entry.path())?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// Makes a directory's entries durable.
pub(crate) fn sync(directory: &Path) -> std::io::Result<()> {
    // Only Unix can open a directory for this; elsewhere the file system orders it by itself.
    if cfg!(unix) { File::open(directory)?.sync_all() } else { Ok(()) }
}

fn is_staged(name: &str) -> bool {
    name.rsplit_once('#')
        .is_some_and(|(_, digits)| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_new_directory_is_its_owners_alone_and_one_that_is_there_keeps_its_mode() {
        let base = tempfile::tempdir().unwrap();
        let mode = |at: &Path| std::fs::metadata(at).unwrap().permissions().mode() & 0o777;
        let new = base.path().join("below/data");
        prepare(&new, false).unwrap();
        assert_eq!(mode(&new), 0o700);
        std::fs::set_permissions(&new, Permissions::from_mode(0o750)).unwrap();
        prepare(&new, false).unwrap();
        assert_eq!(mode(&new), 0o750);
    }

    #[test]
    fn only_staged_files_are_removed() {
        let directory = tempfile::tempdir().unwrap();
        prepare(directory.path(), false).unwrap();
        let shard = directory.path().join("sessions");
        std::fs::create_dir(&shard).unwrap();
        for name in ["abcd", "abcd#1", "abcd#12", "abcd#", "abcd#x"] {
            std::fs::write(shard.join(name), name).unwrap();
        }
        assert_eq!(remove_staged(directory.path()).unwrap(), 2);
        assert!(["abcd", "abcd#", "abcd#x"].iter().all(|name| shard.join(name).exists()));
    }
}

//! Files that commands write: what fails names the file.

use super::Failure;
use std::path::Path;

/// Writes a file.
///
/// # Errors
/// Which file, and why.
pub(super) fn write(file: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Failure> {
    std::fs::write(file, bytes).map_err(|e| format!("cannot write {}: {e}", file.display()).into())
}

/// Makes a folder, and those above it.
///
/// # Errors
/// Which folder, and why.
pub(super) fn make_folder(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|e| format!("cannot make {}: {e}", folder.display()).into())
}

//! Folders listed in the order in which people number files.

use crate::FormatError;
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// A folder and what lies in it, in natural order.
#[derive(Debug, Clone)]
pub(super) struct Folder {
    pub(super) path: PathBuf,
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
}

impl Folder {
    pub(super) fn list(path: &Path) -> Result<Self, FormatError> {
        let io = |e: std::io::Error| FormatError::io(path, &e);
        let (mut files, mut folders) = (vec![], vec![]);
        for entry in std::fs::read_dir(path).map_err(io)? {
            let entry = entry.map_err(io)?.path();
            if name(&entry).starts_with('.') {
                continue;
            }
            if entry.is_dir() { folders.push(entry) } else { files.push(entry) }
        }
        let order = |a: &PathBuf, b: &PathBuf| natural_order(&name(a), &name(b));
        files.sort_by(order);
        folders.sort_by(order);
        Ok(Self { path: path.to_owned(), files, folders })
    }

    pub(super) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    pub(super) fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Files with one of these extensions (lower case), in order.
    pub(super) fn with_extension(&self, extensions: &[&str]) -> Vec<PathBuf> {
        self.files.iter().filter(|f| extensions.contains(&extension(f).as_str())).cloned().collect()
    }

    /// The first file whose name begins and ends so.
    pub(super) fn named(&self, prefix: &str, suffix: &str) -> Option<&Path> {
        let fits = |f: &&PathBuf| name(f).starts_with(prefix) && name(f).ends_with(suffix);
        self.files.iter().find(fits).map(PathBuf::as_path)
    }

    pub(super) fn name(&self) -> String {
        // `.` and `..` have no name of their own.
        self.path.canonicalize().map_or_else(|_| name(&self.path), |path| name(&path))
    }
}

pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// In lower case, without the dot.
pub(super) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// The number that a file's stem consists of.
pub(super) fn stem_number(path: &Path) -> Option<u64> {
    path.file_stem()?.to_str()?.parse().ok()
}

/// Runs of digits compare as numbers: `scan2` comes before `scan10`.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    while let (Some(&p), Some(&q)) = (x.first(), y.first()) {
        let order = if p.is_ascii_digit() && q.is_ascii_digit() {
            let (m, n) = (number(&mut x), number(&mut y));
            m.len().cmp(&n.len()).then_with(|| m.cmp(n))
        } else {
            (x, y) = (&x[1..], &y[1..]);
            p.cmp(&q)
        };
        if order.is_ne() {
            return order;
        }
    }
    // Names that differ only in leading zeros still need an order of their own.
    x.len().cmp(&y.len()).then_with(|| a.cmp(b))
}

/// Takes a run of digits from the front, without its leading zeros.
fn number<'a>(bytes: &mut &'a [u8]) -> &'a [u8] {
    let end = bytes.iter().position(|b| !b.is_ascii_digit()).unwrap_or(bytes.len());
    let (digits, rest) = bytes.split_at(end);
    *bytes = rest;
    let zeros = digits.iter().take_while(|&&b| b == b'0').count();
    &digits[zeros..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = vec!["b1", "learn10.pcd", "learn5.pcd", "learn010.pcd", "learn.pcd", "learn0.pcd"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["b1", "learn.pcd", "learn0.pcd", "learn5.pcd", "learn010.pcd", "learn10.pcd"]);
    }
}

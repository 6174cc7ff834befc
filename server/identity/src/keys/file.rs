//! The file of keys: JSON, mode 0600 unless its owner's group may read it, replaced whole.

use super::{digest, fresh, hex, unhex32};
use crate::principal::is_name;
use crate::{Grant, RandomError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};

/// The file's format.
const FORMAT: u32 = 1;
/// A file of more bytes is none of ours.
const MAX_BYTES: u64 = 64 << 20;

/// A key as it is kept: everything but its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyRecord {
    /// Twelve hex digits; part of the key's text.
    pub id: String,
    /// Whose it is, for people and the audit log.
    pub name: String,
    /// Tenant of its holder.
    pub tenant: String,
    /// What it allows.
    pub grants: Vec<Grant>,
    /// SHA-256 of the key's text, hex.
    pub sha256: String,
    /// When it was made, seconds since the Unix epoch.
    pub created_s: u64,
    /// When it ends, seconds since the Unix epoch; none: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_s: Option<u64>,
    /// When it was revoked, seconds since the Unix epoch; none: it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked_s: Option<u64>,
}

/// What a key is made with.
#[derive(Debug, Clone)]
pub struct NewKey {
    /// Whose it is.
    pub name: String,
    /// Tenant of its holder.
    pub tenant: String,
    /// What it allows.
    pub grants: Vec<Grant>,
    /// When it ends, seconds since the Unix epoch; none: never.
    pub expires_s: Option<u64>,
}

/// All keys of a server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyFile {
    format: u32,
    /// In the order in which they were made.
    pub keys: Vec<KeyRecord>,
}

impl Default for KeyFile {
    fn default() -> Self {
        Self { format: FORMAT, keys: Vec::new() }
    }
}

/// What can be wrong with the file or a new key.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// The file system refused.
    #[error("cannot {act} {}: {source}", path.display())]
    Io {
        /// What was tried.
        act: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is not a file of keys.
    #[error("{} is no file of keys: {problem}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        problem: String,
    },
    /// Anybody on the machine could add keys.
    #[error("{} can be written by anybody (mode {mode:o}); run chmod 600 on it", path.display())]
    WritableByAll {
        /// The file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// A name or tenant of other characters.
    #[error("{field} is {value:?}; use 1 to 64 characters of a-z A-Z 0-9 _ - . @ : /")]
    Name {
        /// Which of them.
        field: &'static str,
        /// What it is.
        value: String,
    },
    /// No key has this id or name.
    #[error("no key has the id or name {0:?}; list the keys")]
    NotFound(String),
    /// Several keys have this name.
    #[error("{0} keys have the name {1:?}; revoke them by id, or all of them with --all")]
    Ambiguous(usize, String),
    /// No random bytes.
    #[error(transparent)]
    Random(#[from] RandomError),
}

impl KeyFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Absent, writable by all, or not of this format.
    pub fn read(path: &Path) -> Result<Self, KeyFileError> {
        let io = |act| move |source| KeyFileError::Io { act, path: path.to_owned(), source };
        let meta = fs::metadata(path).map_err(io("read"))?;
        if meta.mode() & 0o002 != 0 {
            return Err(KeyFileError::WritableByAll { path: path.to_owned(), mode: meta.mode() & 0o777 });
        }
        let invalid = |problem: String| KeyFileError::Invalid { path: path.to_owned(), problem };
        if meta.len() > MAX_BYTES {
            return Err(invalid(format!("it has {} bytes, the limit is {MAX_BYTES}", meta.len())));
        }
        let text = fs::read_to_string(path).map_err(io("read"))?;
        let file: Self = serde_json::from_str(&text).map_err(|e| invalid(e.to_string()))?;
        file.check().map_err(invalid)?;
        Ok(file)
    }

    fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("its format is {}, this program reads {FORMAT}", self.format));
        }
        let mut ids = BTreeSet::new();
        for key in &self.keys {
            if !ids.insert(&key.id) {
                return Err(format!("the id {:?} is there twice", key.id));
            }
            if unhex32(&key.sha256).is_none() {
                return Err(format!("sha256 of the key {:?} is not 64 hex digits", key.id));
            }
        }
        Ok(())
    }

    /// Changes a file, or makes it, alone among all that change it through this. The answer is the change's.
    ///
    /// # Errors
    /// Those of [`read`](Self::read), of the change, and of writing; then the file is as it was.
    pub fn change<T>(
        path: &Path,
        change: impl FnOnce(&mut Self) -> Result<T, KeyFileError>,
    ) -> Result<T, KeyFileError> {
        let io = |act| move |source| KeyFileError::Io { act, path: path.to_owned(), source };
        let beside = |suffix: &str| {
            let mut name = path.file_name().unwrap_or_default().to_owned();
            name.push(suffix);
            path.with_file_name(name)
        };
        let lock = File::options().create(true).truncate(false).write(true).mode(0o600).open(beside(".lock"));
        let lock = lock.map_err(io("lock"))?;
        lock.lock().map_err(io("lock"))?;
        let mut file = match fs::exists(path).map_err(io("read"))? {
            true => Self::read(path)?,
            false => Self::default(),
        };
        let answer = change(&mut file)?;
        file.write(path, &beside(".new"))?;
        Ok(answer)
    }

    /// Writes beside and renames, so that a reader sees the old file or the new one.
    fn write(&self, path: &Path, beside: &Path) -> Result<(), KeyFileError> {
        let io = |act| move |source| KeyFileError::Io { act, path: path.to_owned(), source };
        let invalid = |e: serde_json::Error| KeyFileError::Invalid { path: path.to_owned(), problem: e.to_string() };
        let mut text = serde_json::to_vec_pretty(self).map_err(invalid)?;
        text.push(b'\n');
        // One that a crash has left behind would keep its own mode.
        let _ = fs::remove_file(beside);
        let file = OpenOptions::new().create_new(true).write(true).mode(0o600).open(beside);
        let mut file = file.map_err(io("write"))?;
        // The server that reads it need not be who changes it: whose it was it stays.
        if let Ok(before) = fs::metadata(path) {
            let now = file.metadata().map_err(io("write"))?;
            if (before.uid(), before.gid()) != (now.uid(), now.gid()) {
                fchown(&file, Some(before.uid()), Some(before.gid())).map_err(io("keep the owner of"))?;
            }
            // Closed to others, whatever it was.
            let mode = before.mode() & 0o777;
            let kept = if mode & 0o007 == 0 { mode & 0o660 | 0o600 } else { 0o600 };
            file.set_permissions(fs::Permissions::from_mode(kept)).map_err(io("write"))?;
        }
        let written = file.write_all(&text).and_then(|()| file.sync_all()).and_then(|()| fs::rename(beside, path));
        written.map_err(io("write"))?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(io("write"))
    }

    /// Adds a key; its text, which is kept nowhere, comes back.
    ///
    /// # Errors
    /// `Name`, `Random`.
    pub fn create(&mut self, new: NewKey, now_s: u64) -> Result<(KeyRecord, String), KeyFileError> {
        for (field, value) in [("name", &new.name), ("tenant", &new.tenant)] {
            if !is_name(value) {
                return Err(KeyFileError::Name { field, value: value.chars().take(80).collect() });
            }
        }
        let (id, text) = fresh()?;
        let record = KeyRecord {
            id,
            name: new.name,
            tenant: new.tenant,
            grants: new.grants,
            sha256: hex(&digest(&text)),
            created_s: now_s,
            expires_s: new.expires_s,
            revoked_s: None,
        };
        self.keys.push(record.clone());
        Ok((record, text))
    }

    /// Takes the key with this id back, or the one with this name; `all` of that name. How many it were.
    ///
    /// # Errors
    /// `NotFound`, `Ambiguous`.
    pub fn revoke(&mut self, id_or_name: &str, all: bool, now_s: u64) -> Result<usize, KeyFileError> {
        let by_id = self.keys.iter().any(|k| k.id == id_or_name);
        let meant = |k: &&mut KeyRecord| if by_id { k.id == id_or_name } else { k.name == id_or_name };
        let found: Vec<_> = self.keys.iter_mut().filter(meant).filter(|k| by_id || k.revoked_s.is_none()).collect();
        match found.len() {
            0 => Err(KeyFileError::NotFound(id_or_name.to_owned())),
            n if n > 1 && !all => Err(KeyFileError::Ambiguous(n, id_or_name.to_owned())),
            n => {
                for key in found {
                    key.revoked_s = key.revoked_s.or(Some(now_s));
                }
                Ok(n)
            }
        }
    }
}

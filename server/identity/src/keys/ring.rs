//! The keys in force, read anew when their file changes.

use super::file::{KeyFile, KeyFileError, KeyRecord};
use super::{digest, id_of, unhex32};
use crate::{Principal, Reason, Refusal, Standing};
use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError, RwLock};

/// What tells one state of the file from another. A file that is replaced has another inode.
type Stamp = (u64, u64, i64, i64);

struct Entry {
    record: KeyRecord,
    digest: [u8; 32],
    principal: Principal,
}

/// Keys of a file.
pub struct KeyRing {
    path: PathBuf,
    entries: RwLock<HashMap<String, Entry>>,
    seen: Mutex<Seen>,
}

#[derive(Default)]
struct Seen {
    /// Of the state that was read last, whole or not.
    read: Option<Stamp>,
    /// Of the state that could not be read for the moment, and was told of.
    unreadable: Option<Stamp>,
}

impl KeyRing {
    /// Reads the file.
    ///
    /// # Errors
    /// As [`KeyFile::read`].
    pub fn open(path: &Path) -> Result<Self, KeyFileError> {
        let seen = Mutex::new(Seen { read: stamp(path), unreadable: None });
        let ring = Self { path: path.to_owned(), entries: RwLock::default(), seen };
        ring.take(KeyFile::read(path)?);
        Ok(ring)
    }

    /// Reads the file again if it has changed. A file that is gone or broken leaves the keys as they are: losing it
    /// must not lock a whole fleet out, and the error says so.
    ///
    /// # Errors
    /// As [`KeyFile::read`], once for each state of the file.
    pub fn refresh(&self) -> Result<(), KeyFileError> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let now = stamp(&self.path);
        if seen.read == now {
            return Ok(());
        }
        match KeyFile::read(&self.path) {
            // Tried again until it can be read: what was revoked in it is not in force yet.
            Err(error @ KeyFileError::Io { .. }) if now.is_some() => {
                if std::mem::replace(&mut seen.unreadable, now) == now { Ok(()) } else { Err(error) }
            }
            outcome => {
                *seen = Seen { read: now, unreadable: None };
                outcome.map(|file| self.take(file))
            }
        }
    }

    /// Puts new keys in force. Calls that go on under a key that has changed in any way lose their standing.
    fn take(&self, file: KeyFile) {
        let mut entries = self.entries.write().unwrap_or_else(PoisonError::into_inner);
        let mut old = std::mem::take(&mut *entries);
        for record in file.keys {
            let Some(digest) = unhex32(&record.sha256) else { continue };
            let is_same = old.get(&record.id).is_some_and(|e| e.record == record);
            let kept = if is_same { old.remove(&record.id) } else { None };
            let entry = kept.unwrap_or_else(|| {
                let standing = Standing::until(record.expires_s);
                if record.revoked_s.is_some() {
                    standing.revoke();
                }
                let (name, tenant, grants) = (record.name.clone(), record.tenant.clone(), record.grants.clone());
                Entry { record, digest, principal: Principal { name, tenant, grants, standing } }
            });
            entries.insert(entry.record.id.clone(), entry);
        }
        old.values().for_each(|e| e.principal.standing.revoke());
        drop(entries);
    }

    /// The holder of a key's text.
    ///
    /// # Errors
    /// `Invalid`, `Expired`, `Revoked`.
    pub(crate) fn authenticate(&self, text: &str, now_s: u64) -> Result<Principal, Refusal> {
        let id = id_of(text).ok_or_else(|| Refusal::invalid("not of the form of a key"))?;
        let given = digest(text);
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        let entry = entries.get(id).ok_or_else(|| Refusal::invalid(format!("no key has the id {id}")))?;
        if !same(&given, &entry.digest) {
            return Err(Refusal::invalid(format!("wrong secret for the key {id}")));
        }
        // Only now: who does not know the secret learns nothing of the key.
        if entry.record.revoked_s.is_some() {
            return Err(Refusal::new(Reason::Revoked, format!("the key {id} was revoked")));
        }
        if !entry.principal.standing.holds(now_s) {
            return Err(Refusal::new(Reason::Expired, format!("the key {id} has expired")));
        }
        Ok(entry.principal.clone())
    }
}

/// Compares in a time that does not depend on where they differ.
fn same(a: &[u8; 32], b: &[u8; 32]) -> bool {
    std::hint::black_box(a.iter().zip(b).fold(0, |difference, (x, y)| difference | (x ^ y))) == 0
}

fn stamp(path: &Path) -> Option<Stamp> {
    let meta = fs::metadata(path).ok()?;
    Some((meta.ino(), meta.len(), meta.mtime(), meta.mtime_nsec()))
}

impl std::fmt::Debug for KeyRing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("KeyRing").field("path", &self.path).finish_non_exhaustive()
    }
}

//! A file on the local disk for what of a session's map does not fit into memory. It has no name in its directory and is gone
//! with the session: keyframes are stored elsewhere, and all of it can be built of them again.

use crate::{Error, ErrorCode, reason};
use percept_mapping::{BlobId, MapStore};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// After a failure frames are refused for so long; then one may try again.
const REFUSED: Duration = Duration::from_secs(1);

/// Where submaps lie that are out of memory, and scans.
#[derive(Debug)]
pub(crate) struct Scratch {
    directory: PathBuf,
    /// Bytes that each session may take in memory now.
    room: Arc<AtomicUsize>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Made when something is put first.
    file: Option<Arc<File>>,
    /// Offset and length of what is in it.
    places: BTreeMap<BlobId, (u64, usize)>,
    end: u64,
    failed: Option<(Instant, Error)>,
    /// When it last did not take what had room in memory still.
    failed_ahead: Option<Instant>,
}

impl State {
    /// Bytes were written at the end.
    fn note(&mut self, id: BlobId, length: usize) {
        self.places.insert(id, (self.end, length));
        self.end += length as u64;
    }
}

impl Scratch {
    /// In a directory; none takes the system's for what is temporary. `room`: bytes that each session may take in memory.
    pub(super) fn in_directory(directory: Option<&Path>, room: &Arc<AtomicUsize>) -> Arc<Self> {
        let directory = directory.map_or_else(std::env::temp_dir, Path::to_owned);
        Arc::new(Self { directory, room: Arc::clone(room), state: Mutex::default() })
    }

    /// Why no more of the map can be put out of memory, if that failed a moment ago.
    pub(super) fn error(&self) -> Option<Error> {
        let state = self.lock();
        let (at, error) = state.failed.as_ref()?;
        (at.elapsed() < REFUSED).then(|| error.clone())
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Each entry is whole whoever stopped where.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, state: &mut State, bytes: &[u8]) -> io::Result<()> {
        percept_store::check_room(&self.directory).map_err(|_| ErrorKind::StorageFull)?;
        let file = match &state.file {
            Some(file) => Arc::clone(file),
            None => Arc::clone(state.file.insert(Arc::new(tempfile::tempfile_in(&self.directory)?))),
        };
        file.write_all_at(bytes, state.end)
    }
}

impl MapStore for Scratch {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let id = BlobId(*percept_store::BlobId::of(bytes).as_bytes());
        let mut state = self.lock();
        if state.places.contains_key(&id) {
            return Some(id);
        }
        if let Err(error) = self.write(&mut state, bytes) {
            let is_new = state.failed.is_none();
            if is_new {
                tracing::warn!(directory = %self.directory.display(), %error, "a map does not fit into memory, nor on the disk");
            }
            state.failed = Some((Instant::now(), refusal(&self.directory, &error)));
            return None;
        }
        state.note(id, bytes.len());
        state.failed = None;
        Some(id)
    }

    fn put_ahead(&self, bytes: &[u8]) -> Option<BlobId> {
        let id = BlobId(*percept_store::BlobId::of(bytes).as_bytes());
        let mut state = self.lock();
        if !state.places.contains_key(&id) {
            let written = self.write(&mut state, bytes);
            state.failed_ahead = written.is_err().then(Instant::now);
            written.ok()?;
            state.note(id, bytes.len());
        }
        Some(id)
    }

    fn takes_ahead(&self) -> bool {
        let has_failed = |at: &Instant| at.elapsed() < REFUSED;
        let state = self.lock();
        !state.failed_ahead.as_ref().is_some_and(has_failed)
            && !state.failed.as_ref().is_some_and(|(at, _)| has_failed(at))
    }

    fn max_bytes(&self) -> usize {
        self.room.load(Ordering::Relaxed)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        let (file, (offset, length)) = {
            let state = self.lock();
            (Arc::clone(state.file.as_ref()?), *state.places.get(id)?)
        };
        let mut bytes = vec![0; length];
        let read = file.read_exact_at(&mut bytes, offset);
        let is_whole = read.is_ok() && percept_store::BlobId::of(&bytes).as_bytes() == &id.0;
        if !is_whole {
            tracing::error!(directory = %self.directory.display(), "a part of a map that was out of memory is damaged");
        }
        is_whole.then_some(bytes)
    }
}

fn refusal(directory: &Path, error: &io::Error) -> Error {
    let full = matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded);
    let at = directory.display();
    let words = format!(
        "the map is larger than limits.max_session_memory_mb, and what does not fit cannot be put into a file in {at}: {error}"
    );
    match full {
        true => Error::exhausted(reason::STORAGE_FULL, "", format!("{words}; free some space")),
        false => Error::new(ErrorCode::Unavailable, reason::STORAGE_FAULT, words),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room() -> Arc<AtomicUsize> {
        Arc::new(AtomicUsize::new(1 << 20))
    }

    #[test]
    fn what_is_put_is_had_again_and_leaves_no_name() {
        let directory = tempfile::tempdir().unwrap();
        let scratch = Scratch::in_directory(Some(directory.path()), &room());
        let (a, b) = (scratch.put(&[1; 1000]).unwrap(), scratch.put(&[2; 10]).unwrap());
        assert_eq!(scratch.put(&[1; 1000]), Some(a));
        assert_eq!((scratch.get(&a).unwrap(), scratch.get(&b).unwrap()), (vec![1; 1000], vec![2; 10]));
        assert_eq!((scratch.get(&BlobId([7; 32])), scratch.lock().end), (None, 1010));
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_is_damaged_is_not_given_back() {
        let scratch = Scratch::in_directory(None, &room());
        let id = scratch.put(&[1; 100]).unwrap();
        scratch.lock().file.as_ref().unwrap().write_all_at(&[9], 50).unwrap();
        assert_eq!(scratch.get(&id), None);
    }

    #[test]
    fn what_cannot_be_put_refuses_frames_for_a_while() {
        let directory = tempfile::tempdir().unwrap();
        let scratch = Scratch::in_directory(Some(&directory.path().join("gone")), &room());
        assert!(scratch.error().is_none());
        assert_eq!(scratch.put(&[1; 100]), None);
        assert!(scratch.error().unwrap().to_string().contains("limits.max_session_memory_mb"));
        std::fs::create_dir(directory.path().join("gone")).unwrap();
        assert!(!scratch.takes_ahead());
        assert!(scratch.put(&[1; 100]).is_some() && scratch.error().is_none());
    }

    #[test]
    fn what_cannot_be_put_ahead_refuses_nothing_and_is_not_tried_again_at_once() {
        let directory = tempfile::tempdir().unwrap();
        let scratch = Scratch::in_directory(Some(&directory.path().join("gone")), &room());
        assert!(scratch.takes_ahead());
        assert_eq!(scratch.put_ahead(&[1; 100]), None);
        assert!(scratch.error().is_none() && !scratch.takes_ahead());
        std::fs::create_dir(directory.path().join("gone")).unwrap();
        let id = scratch.put_ahead(&[1; 100]).unwrap();
        assert!(scratch.takes_ahead() && scratch.get(&id).unwrap() == [1; 100]);
    }
}

//! Recordings of all sessions: where they are, which there are, and what they may take together.

use super::recording::{RecordingEnd, RecordingStatus};
use super::registry::{Registry, not_found};
use super::slot::Phase;
use crate::{Error, ErrorCode, Result, reason};
use percept_identity::Pattern;
use percept_recorder::{RecorderSettings, SharedRoom};
use serde::{Deserialize, Serialize};
use std::fs::{self, DirEntry};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};

/// How long an ended recording's last bytes are waited for before a caller is answered.
const PATIENCE: Duration = Duration::from_secs(10);
/// Files of a recording that are listed one by one.
const MOST_LISTED: usize = 100;

/// Which sessions are recorded, and where.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSettings {
    /// Folder of recordings; empty: nothing is recorded, nor by StartRecording. The first frame that a session takes after it
    /// woke begins one in TENANT/SESSION/MILLISECONDS-SINCE-1970 there, which ends when it sleeps. They stay when sessions are
    /// deleted.
    pub dir: String,
    /// Ids of the sessions that are recorded without being asked, * for any characters; empty: none. Calls begin and end
    /// recordings of any session; what they say holds until the server stops.
    pub sessions: String,
    /// Size from which on a recording goes on in a next file, MB; 1 to 1048576.
    pub max_file_mb: u64,
    /// What may wait to be written of a session, MB; frames beyond it are not recorded, and counted. 16 to 65536.
    pub max_waiting_mb: usize,
    /// What may wait to be written of all sessions together, MB; frames beyond it are not recorded, and counted. 16 to 1048576.
    pub max_waiting_total_mb: usize,
    /// Space that recordings leave on their disk, MB: where there is less, they end.
    pub min_free_mb: u64,
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self {
            dir: String::new(),
            sessions: "*".to_owned(),
            max_file_mb: 1024,
            max_waiting_mb: 64,
            max_waiting_total_mb: 256,
            min_free_mb: 2048,
        }
    }
}

impl RecordingSettings {
    /// The first field that cannot be: its name, value, and the remedy.
    pub fn complaint(&self) -> Option<(&'static str, String, &'static str)> {
        let Self { sessions, max_file_mb, max_waiting_mb, max_waiting_total_mb, .. } = self;
        if !sessions.is_empty() && Pattern::new(sessions).is_err() {
            let remedy = "write 1 to 64 characters of a-z A-Z 0-9 _ - and * for any others, or nothing for no session";
            return Some(("recording.sessions", format!("{sessions:?}"), remedy));
        }
        if !(1..=1 << 20).contains(max_file_mb) {
            return Some(("recording.max_file_mb", max_file_mb.to_string(), "set it between 1 and 1048576"));
        }
        if !(16..=1 << 16).contains(max_waiting_mb) {
            return Some(("recording.max_waiting_mb", max_waiting_mb.to_string(), "set it between 16 and 65536"));
        }
        let fits = (16..=1 << 20).contains(max_waiting_total_mb);
        let field = "recording.max_waiting_total_mb";
        (!fits).then(|| (field, max_waiting_total_mb.to_string(), "set it between 16 and 1048576"))
    }

    /// Whether a session is recorded without being asked.
    fn names(&self, session: &str) -> bool {
        !self.dir.is_empty() && Pattern::new(&self.sessions).is_ok_and(|p| p.matches(session))
    }
}

/// What recordings of all sessions share.
#[derive(Debug)]
pub(super) struct Recordings {
    settings: RecordingSettings,
    pub(super) room: Arc<SharedRoom>,
}

impl Recordings {
    pub(super) fn of(settings: RecordingSettings) -> Arc<Self> {
        let room = SharedRoom::of(settings.max_waiting_total_mb.saturating_mul(1 << 20));
        Arc::new(Self { settings, room })
    }

    /// Whether there is a folder for them.
    pub(super) fn is_on(&self) -> bool {
        !self.settings.dir.is_empty()
    }

    pub(super) fn names(&self, session: &str) -> bool {
        self.settings.names(session)
    }

    pub(super) fn recorder_settings(&self) -> RecorderSettings {
        RecorderSettings {
            max_file_bytes: self.settings.max_file_mb << 20,
            max_waiting_bytes: self.settings.max_waiting_mb << 20,
            min_free_bytes: self.settings.min_free_mb.saturating_mul(1 << 20),
            ..RecorderSettings::default()
        }
    }

    /// A folder of a session's, which callers are told of, in the server's.
    pub(super) fn whole(&self, folder: &str) -> PathBuf {
        Path::new(&self.settings.dir).join(folder)
    }

    fn check(&self) -> Result<()> {
        if self.is_on() {
            return Ok(());
        }
        let words = "recording.dir is \"\": this server has no folder for recordings; start it with --record FOLDER, or set \
                     recording.dir";
        Err(Error::new(ErrorCode::FailedPrecondition, reason::RECORDING_OFF, words))
    }
}

/// Where a session's recordings are, below the server's folder.
pub(super) fn folder_of(tenant: &str, session: &str) -> String {
    format!("{}/{}", segment(tenant), segment(session))
}

/// A name as one part of a path, another for every name: tenants may be called anything.
fn segment(name: &str) -> String {
    let plain = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-');
    name.bytes().map(|b| if plain(&b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// A recording in the server's folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredRecording {
    /// When it was begun, server's clock, milliseconds since the Unix epoch: its folder's name.
    pub id: u64,
    /// Bytes of all files.
    pub num_bytes: u64,
    /// How many.
    pub num_files: usize,
    /// The first of them, with their bytes.
    pub files: Vec<(String, u64)>,
    /// When its files were last written, server's clock, nanoseconds since the Unix epoch; none of a recording without files.
    pub last_write_time_ns: Option<i64>,
    /// Whether it has not ended.
    pub is_open: bool,
}

/// What is in a session's folder, the oldest first. What others have put there is passed over.
fn stored(folder: &Path) -> std::io::Result<Vec<StoredRecording>> {
    let mut found = Vec::new();
    for entry in entries(folder)? {
        let name = entry.file_name();
        let Some(id) = name.to_str().and_then(number) else { continue };
        if !entry.file_type()?.is_dir() {
            continue;
        }
        let (mut files, mut last_write_time_ns) = (Vec::new(), None);
        for file in entries(&entry.path())? {
            // Gone meanwhile, or of another kind.
            let Some(metadata) = file.metadata().ok().filter(fs::Metadata::is_file) else { continue };
            files.push((file.file_name().to_string_lossy().into_owned(), metadata.len()));
            let written = metadata.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
            last_write_time_ns = last_write_time_ns.max(written.and_then(|at| i64::try_from(at.as_nanos()).ok()));
        }
        files.sort_unstable();
        let (num_bytes, num_files) = (files.iter().map(|f| f.1).sum(), files.len());
        files.truncate(MOST_LISTED);
        found.push(StoredRecording { id, num_bytes, num_files, files, last_write_time_ns, is_open: false });
    }
    found.sort_unstable_by_key(|r| r.id);
    Ok(found)
}

/// What is in a folder; nothing if it is not there.
fn entries(folder: &Path) -> std::io::Result<Vec<DirEntry>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.collect(),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

/// The number that a folder is named by, if it is written as we do.
fn number(name: &str) -> Option<u64> {
    name.parse().ok().filter(|number: &u64| number.to_string() == name)
}

/// Removes a recording; whether it was there. A link is followed nowhere.
fn remove(folder: &Path) -> std::io::Result<bool> {
    match fs::symlink_metadata(folder) {
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(folder).map(|()| true),
        Ok(_) => Ok(false),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

async fn on_disk<T: Send + 'static>(work: impl FnOnce() -> std::io::Result<T> + Send + 'static) -> Result<T> {
    let done = tokio::task::spawn_blocking(work).await.map_err(Error::internal)?;
    done.map_err(|e| Error::internal(format!("the folder of recordings: {e}")))
}

impl Registry {
    /// Begins to record a session, which is woken: of servers that share data it has to be here.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `SESSION_NOT_FOUND`, `SESSION_FAULTED`, `SESSION_NOT_MAPPING`; faults of the storage.
    pub(crate) async fn start_recording(self: &Arc<Self>, id: &str) -> Result<RecordingStatus> {
        self.recordings.check()?;
        if self.find(id)?.known().is_ingest_only {
            let words =
                "mode is INGEST_ONLY, in which frames are counted and not kept; record a session of mode MAPPING";
            return Err(Error::new(ErrorCode::FailedPrecondition, reason::SESSION_NOT_MAPPING, words));
        }
        self.get(id).await?;
        let slot = self.find(id)?;
        if let Phase::Faulted(fault, _) = slot.phase() {
            return Err(fault.error());
        }
        Ok(slot.recording.start())
    }

    /// Ends what is recorded of a session. What waits is written before this returns, for as long as the disk is waited for.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `NOT_RECORDED`, `SESSION_NOT_FOUND`; `SESSION_ELSEWHERE` if it is another server's.
    pub(crate) async fn stop_recording(self: &Arc<Self>, id: &str) -> Result<RecordingStatus> {
        self.recordings.check()?;
        let slot = self.find(id)?;
        if !slot.recording.stop() {
            // Another server may have it.
            self.get(id).await?;
            let words =
                format!("session_id {id:?} is not recorded, and was not since the server began; start it first");
            return Err(Error::new(ErrorCode::FailedPrecondition, reason::NOT_RECORDED, words));
        }
        slot.recording.end(RecordingEnd::Stopped, PATIENCE).await;
        Ok(slot.recording.status())
    }

    /// What was recorded of a session by this server, the oldest first, without waking it.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `SESSION_NOT_FOUND`; `INTERNAL` if the folder cannot be read.
    pub(crate) async fn stored_recordings(&self, id: &str) -> Result<Vec<StoredRecording>> {
        self.recordings.check()?;
        let slot = self.find(id)?;
        let folder = self.recordings.whole(&slot.recording.folder);
        let mut found = on_disk(move || stored(&folder)).await?;
        for recording in &mut found {
            recording.is_open = slot.recording.is_open(recording.id);
        }
        Ok(found)
    }

    /// Removes a recording of a session for good.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `RECORDING_UNDER_WAY`, `RECORDING_NOT_FOUND`, `SESSION_NOT_FOUND`; `INTERNAL` if the disk refuses.
    pub(crate) async fn delete_recording(&self, id: &str, recording: &str) -> Result<()> {
        self.recordings.check()?;
        let slot = self.find(id)?;
        let shown: String = recording.chars().take(80).collect();
        let absent = || {
            let words = format!("recording_id {shown:?} is none of this session; list its recordings");
            Error::not_found(reason::RECORDING_NOT_FOUND, "recording_id", words)
        };
        let number = number(recording).ok_or_else(absent)?;
        if slot.recording.is_open(number) {
            let words = format!("recording_id {shown:?} has not ended; stop it first");
            let code = ErrorCode::FailedPrecondition;
            let error = Error::new(code, reason::RECORDING_UNDER_WAY, words);
            return Err(Error { field: "recording_id".to_owned(), ..error });
        }
        // One whose session is gone is nobody's to remove.
        if slot.is_doomed() {
            return Err(not_found(id));
        }
        let folder = self.recordings.whole(&slot.recording.folder).join(recording);
        if !on_disk(move || remove(&folder)).await? {
            return Err(absent());
        }
        slot.recording.forget(number);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_leads_out_of_the_folder_nor_into_anothers() {
        let names = ["default", "..", "/etc", "a/b", "a%2Fb", "a.b", ""];
        let segments: Vec<String> = names.iter().map(|n| segment(n)).collect();
        assert_eq!(segments, ["default", "%2E%2E", "%2Fetc", "a%2Fb", "a%252Fb", "a%2Eb", ""]);
        let settings = RecordingSettings { dir: "recordings".to_owned(), ..RecordingSettings::default() };
        let folder = Recordings::of(settings).whole(&folder_of("../x", "s"));
        assert_eq!(folder, Path::new("recordings/%2E%2E%2Fx/s"));
        for name in ["", "..", "1/..", "+1", "01", "-1", " 1", "18446744073709551616"] {
            assert_eq!(number(name), None, "{name}");
        }
        assert_eq!(number("1795812345678"), Some(1_795_812_345_678));
    }

    #[test]
    fn sessions_are_named_by_a_pattern_and_by_nothing_if_that_is_empty() {
        let named = |dir: &str, sessions: &str| {
            let usual = RecordingSettings::default();
            let settings = RecordingSettings { dir: dir.to_owned(), sessions: sessions.to_owned(), ..usual };
            assert_eq!(settings.complaint(), None);
            settings.names("robot-7")
        };
        assert!(named("r", "*") && named("r", "robot-*"));
        assert!(!named("r", "other") && !named("r", "") && !named("", "*"));
    }

    #[test]
    fn what_was_recorded_is_listed_by_age_and_what_is_not_ours_is_left() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(stored(&folder.path().join("none")).unwrap(), []);
        for (recording, size) in [("20", 3), ("9", 4), ("notes", 1)] {
            fs::create_dir(folder.path().join(recording)).unwrap();
            fs::write(folder.path().join(recording).join("recording_0000.mcap"), vec![0; size]).unwrap();
        }
        fs::write(folder.path().join("30"), "a file").unwrap();
        let found = stored(folder.path()).unwrap();
        assert_eq!(found.iter().map(|r| (r.id, r.num_bytes, r.num_files)).collect::<Vec<_>>(), [(9, 4, 1), (20, 3, 1)]);
        assert!(found.iter().all(|r| r.last_write_time_ns.is_some()));
        assert!(remove(&folder.path().join("20")).unwrap());
        assert!(!remove(&folder.path().join("20")).unwrap() && !remove(&folder.path().join("30")).unwrap());
        assert_eq!(stored(folder.path()).unwrap().len(), 1);
    }
}

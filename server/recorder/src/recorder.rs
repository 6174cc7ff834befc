//! The recorder: a queue between those who must not wait and the thread that writes.

use crate::files::{Files, WriteError, is_disk_full};
use crate::room::{Place, SharedRoom};
use crate::{RecordError, RecordingState};
use percept_geometry::{Covariance6, Pose, SensorData, SensorFrame, SensorSpec, Timestamp};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Characters of a recording's name at most.
const MAX_NAME_CHARS: usize = 100;
/// What waiting takes beside a frame's own data, bytes, generously: so that small frames cannot wait without bound.
const ITEM_BYTES: usize = 512;

/// How much is kept, and how soon it is safe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecorderSettings {
    /// Bytes of a file from which on a next one is begun; a file may be longer by what is sent at once, and has that at least.
    pub max_file_bytes: u64,
    /// Bytes of frames that may wait to be written; those that do not fit are dropped.
    pub max_waiting_bytes: usize,
    /// How long what was written may be lost if the process is killed.
    pub flush_period: Duration,
    /// Space that is left on the disk, bytes: a recording ends where there is less.
    pub min_free_bytes: u64,
}

impl Default for RecorderSettings {
    /// 1 GiB a file, 64 MiB waiting (some seconds of a depth camera), 2 s; the disk may be filled.
    fn default() -> Self {
        let (max_file_bytes, max_waiting_bytes) = (1 << 30, 64 << 20);
        Self { max_file_bytes, max_waiting_bytes, flush_period: Duration::from_secs(2), min_free_bytes: 0 }
    }
}

/// A recording that is going on. Handed about in an `Arc`; the last to drop it ends it as [`Recorder::finish`] does.
///
/// ```
/// # use percept_recorder::{Recorder, RecorderSettings};
/// # use percept_geometry::{Pose, Timestamp};
/// # let folder = tempfile::tempdir()?;
/// let recorder = Recorder::begin(folder.path(), "drive", RecorderSettings::default())?;
/// recorder.pose(Timestamp(1), Pose::identity(), None);
/// let state = recorder.finish();
/// assert_eq!((state.num_messages, state.dropped.total(), state.error), (2, 0, None));
/// assert!(state.files[0].ends_with("drive_0000.mcap"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    max_waiting_bytes: usize,
    room: Arc<SharedRoom>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    /// Something waits, or the recording ends.
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    items: VecDeque<(Item, Place)>,
    /// Of the items, and of the one that is being written.
    waiting_bytes: usize,
    is_ending: bool,
    state: RecordingState,
}

#[derive(Debug)]
enum Item {
    About(BTreeMap<String, String>),
    Frame(Arc<SensorSpec>, Arc<SensorFrame>),
    Pose(Timestamp, Box<(Pose, Option<Covariance6>)>),
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Recorder {
    /// Begins `<folder>/<name>_0000.mcap`, the folder, too, if it is not there; later files are `_0001` and so on. All files of a
    /// folder are read as one recording: each recording wants a folder of its own. Does not wait for the disk: that it takes no file, or
    /// that one is there already (nothing is written over), is in [`RecordingState::error`].
    ///
    /// # Errors
    /// `Name` (not a file's), `Thread`.
    pub fn begin(folder: &Path, name: &str, settings: RecorderSettings) -> Result<Self, RecordError> {
        Self::begin_in(folder, name, settings, &SharedRoom::of(usize::MAX))
    }

    /// The same; what waits takes room that other recordings share, too.
    ///
    /// # Errors
    /// As [`Recorder::begin`].
    pub fn begin_in(
        folder: &Path,
        name: &str,
        settings: RecorderSettings,
        room: &Arc<SharedRoom>,
    ) -> Result<Self, RecordError> {
        check(name)?;
        let (max_waiting_bytes, room) = (settings.max_waiting_bytes, Arc::clone(room));
        let shared = Arc::new(Shared::default());
        let (of_thread, folder, name) = (Arc::clone(&shared), folder.to_owned(), name.to_owned());
        let run = move || {
            // What is given after the thread has failed would wait for ever.
            let _told = Failing(Arc::clone(&of_thread));
            match begin(&folder, &name, settings.max_file_bytes) {
                Ok(files) => Writing::of(of_thread, files, folder, &settings).run(),
                Err(error) => of_thread.lock().stop(error.to_string(), error.is_disk_full()),
            }
        };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(run).map_err(RecordError::Thread)?;
        Ok(Self { shared, max_waiting_bytes, room, thread: Mutex::new(Some(thread)) })
    }

    /// Gives a frame, and what its sensor is declared as, whose id counts. Never waits for the disk and never fails: what is not written is
    /// counted. What is declared otherwise than before is told from this frame on.
    pub fn frame(&self, spec: &Arc<SensorSpec>, frame: Arc<SensorFrame>) {
        self.push(Item::Frame(Arc::clone(spec), frame));
    }

    /// Gives where base was in the map at a stamp of the session's clock, and the covariance of a perturbation in base, if it is
    /// known. Waits and fails no more than [`Recorder::frame`].
    pub fn pose(&self, stamp: Timestamp, t_map_base: Pose, covariance: Option<Covariance6>) {
        self.push(Item::Pose(stamp, Box::new((t_map_base, covariance))));
    }

    /// Says something of the recording as a whole from now on, names and values: each file has it, as metadata of the name
    /// [`ABOUT`](percept_bags::ABOUT), and again where it changes. Waits and fails no more than [`Recorder::frame`].
    pub fn about(&self, entries: BTreeMap<String, String>) {
        self.push(Item::About(entries));
    }

    /// How it stands.
    pub fn state(&self) -> RecordingState {
        self.shared.lock().state.clone()
    }

    /// Writes what waits and the end of the file, and tells what came of it. Waits for the disk. What is given from now on is
    /// counted as dropped.
    pub fn finish(&self) -> RecordingState {
        self.shared.lock().is_ending = true;
        self.shared.changed.notify_all();
        // Held until it has ended: whoever else asks waits for the same.
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        if thread.take().is_some_and(|thread| thread.join().is_err()) {
            self.shared.lock().stop("the recorder's thread failed".to_owned(), false);
        }
        self.state()
    }

    fn push(&self, item: Item) {
        let num_bytes = item.num_bytes();
        let mut queue = self.shared.lock();
        if queue.is_ending || queue.state.error.is_some() {
            queue.state.dropped.ended += item.num_counted();
            return;
        }
        if queue.waiting_bytes.saturating_add(num_bytes) > self.max_waiting_bytes {
            queue.state.dropped.too_slow += item.num_counted();
            return;
        }
        let Some(place) = self.room.take(num_bytes) else {
            queue.state.dropped.no_shared_room += item.num_counted();
            return;
        };
        queue.waiting_bytes += num_bytes;
        queue.items.push_back((item, place));
        drop(queue);
        self.shared.changed.notify_one();
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Makes the folder and the first file.
fn begin(folder: &Path, name: &str, max_file_bytes: u64) -> Result<Files, RecordError> {
    let refused = |error| RecordError::Folder { path: folder.to_owned(), error };
    std::fs::create_dir_all(folder).map_err(refused)?;
    Ok(Files::begin(folder, name, max_file_bytes)?)
}

/// Says that the thread has failed, if it has.
struct Failing(Arc<Shared>);

impl Drop for Failing {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.lock().stop("the recorder's thread failed".to_owned(), false);
        }
    }
}

fn check(name: &str) -> Result<(), RecordError> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    if name.is_empty() || name.starts_with('.') || name.len() > MAX_NAME_CHARS || !name.chars().all(is_plain) {
        let name = name.chars().take(MAX_NAME_CHARS).collect();
        return Err(RecordError::Name { name, limit: MAX_NAME_CHARS });
    }
    Ok(())
}

impl Item {
    /// What is counted where it is dropped: what is said of the recording is none of its messages.
    fn num_counted(&self) -> u64 {
        u64::from(!matches!(self, Self::About(_)))
    }

    /// What it takes while it waits, bytes.
    fn num_bytes(&self) -> usize {
        let frame = match self {
            Self::Frame(_, frame) => frame,
            Self::About(entries) => return ITEM_BYTES + entries.iter().map(|(k, v)| k.len() + v.len()).sum::<usize>(),
            Self::Pose(..) => return ITEM_BYTES,
        };
        let own = match &frame.data {
            SensorData::Depth(depth) => depth.data().len() * 4,
            SensorData::Rgbd(depth, color) => depth.data().len() * 4 + color.data().len(),
            SensorData::Camera(color) => color.data().len(),
            SensorData::Cloud(cloud) => cloud.memory_bytes(),
            SensorData::Scan(scan) => {
                let intensities = scan.intensities.as_ref().map_or(0, Vec::len);
                (scan.ranges_m.len() + intensities + scan.later_echoes_m.len()) * 4
            }
            SensorData::Imu(_) | SensorData::Odometry(_) => 0,
        };
        own.saturating_add(ITEM_BYTES)
    }
}

impl Queue {
    /// Ends the recording before its time: what waits is dropped.
    fn stop(&mut self, error: String, is_disk_full: bool) {
        if self.state.error.is_none() {
            (self.state.error, self.state.is_disk_full) = (Some(error), is_disk_full);
        }
        self.state.dropped.ended += self.items.iter().map(|(item, _)| item.num_counted()).sum::<u64>();
        self.items.clear();
        self.waiting_bytes = 0;
    }
}

/// What the thread does.
struct Writing {
    shared: Arc<Shared>,
    files: Files,
    folder: PathBuf,
    flush_period: Duration,
    min_free_bytes: u64,
    flushed: Instant,
    /// Whether something was written since.
    is_dirty: bool,
}

/// What there is to do.
enum Work {
    Write(Item, Place),
    Flush,
    End,
}

impl Writing {
    fn of(shared: Arc<Shared>, files: Files, folder: PathBuf, settings: &RecorderSettings) -> Self {
        shared.lock().state.files = files.paths().to_vec();
        let RecorderSettings { flush_period, min_free_bytes, .. } = *settings;
        Self { shared, files, folder, flush_period, min_free_bytes, flushed: Instant::now(), is_dirty: false }
    }

    fn run(mut self) {
        let ended = loop {
            let done = match self.next() {
                Work::Write(item, place) => self.write(&item, place),
                Work::Flush => self.flush(),
                Work::End => break Ok(()),
            };
            if let Err(error) = done {
                break Err(error);
            }
        };
        let Self { shared, files, .. } = self;
        if let Err(error) = &ended {
            shared.lock().stop(error.to_string(), error.is_disk_full());
        }
        if matches!(ended, Err(WriteError::File(_))) {
            // What a refused disk has of the file is read so far.
            return;
        }
        let num_bytes = files.finish();
        let mut queue = shared.lock();
        match num_bytes {
            Ok(num_bytes) => queue.state.num_bytes = num_bytes,
            Err(error) => queue.stop(error.to_string(), is_disk_full(&error)),
        }
    }

    /// Waits for something to do.
    fn next(&self) -> Work {
        let mut queue = self.shared.lock();
        loop {
            let due = self.flush_period.saturating_sub(self.flushed.elapsed());
            if self.is_dirty && due.is_zero() {
                return Work::Flush;
            }
            if let Some((item, place)) = queue.items.pop_front() {
                return Work::Write(item, place);
            }
            if queue.is_ending {
                return Work::End;
            }
            let changed = &self.shared.changed;
            queue = if self.is_dirty {
                changed.wait_timeout(queue, due).map_or_else(|e| e.into_inner().0, |(queue, _)| queue)
            } else {
                changed.wait(queue).unwrap_or_else(PoisonError::into_inner)
            };
        }
    }

    fn write(&mut self, item: &Item, place: Place) -> Result<(), WriteError> {
        let written = match item {
            Item::About(entries) => self.files.about(entries),
            Item::Frame(spec, frame) => self.files.frame(spec, frame),
            Item::Pose(stamp, pose) => self.files.pose(*stamp, &pose.0, pose.1.as_ref()),
        };
        let mut queue = self.shared.lock();
        queue.waiting_bytes = queue.waiting_bytes.saturating_sub(place.num_bytes);
        drop(place);
        match written {
            Ok(()) => queue.state.num_frames += u64::from(matches!(item, Item::Frame(..))),
            Err(WriteError::Unwritable(fault)) => {
                queue.state.dropped.unwritable += 1;
                queue.state.fault.get_or_insert_with(|| fault.to_string());
                return Ok(());
            }
            Err(error) => {
                queue.state.dropped.ended += 1;
                return Err(error);
            }
        }
        drop(queue);
        if !self.is_dirty {
            // The period begins with what is not safe yet.
            self.flushed = Instant::now();
            self.is_dirty = true;
        }
        self.tell();
        Ok(())
    }

    /// Whether the disk has as much left as it is to have; one that does not tell has.
    fn check_room(&self) -> Result<(), WriteError> {
        if self.min_free_bytes == 0 {
            return Ok(());
        }
        let left = rustix::fs::statvfs(&self.folder).map_or(u64::MAX, |s| s.f_bavail.saturating_mul(s.f_frsize));
        if left >= self.min_free_bytes { Ok(()) } else { Err(WriteError::NoRoom { left, min: self.min_free_bytes }) }
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        self.check_room()?;
        self.files.flush()?;
        self.is_dirty = false;
        self.tell();
        Ok(())
    }

    fn tell(&self) {
        let state = &mut self.shared.lock().state;
        state.num_messages = self.files.num_messages();
        state.num_bytes = self.files.num_bytes();
        if state.files.len() != self.files.paths().len() {
            state.files = self.files.paths().to_vec();
        }
    }
}

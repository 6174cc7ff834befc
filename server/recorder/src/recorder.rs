//! The recorder: a queue between those who must not wait and the thread that writes.

use crate::RecordError;
use crate::files::{Files, WriteError};
use percept_geometry::{Covariance6, Pose, SensorData, SensorFrame, SensorSpec, Timestamp};
use std::collections::VecDeque;
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
}

impl Default for RecorderSettings {
    /// 1 GiB a file, 64 MiB waiting (some seconds of a depth camera), 2 s.
    fn default() -> Self {
        Self { max_file_bytes: 1 << 30, max_waiting_bytes: 64 << 20, flush_period: Duration::from_secs(2) }
    }
}

/// What has come of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingState {
    /// Messages that were written; a frame is one to four, a pose two, and mounts are one each time they are told.
    pub num_messages: u64,
    /// Frames and poses that are not in the files: there was no room, they cannot be said in messages, or the disk refused.
    pub num_dropped: u64,
    /// Bytes of all files; what waits to be packed is counted as it is.
    pub num_bytes: u64,
    /// The files, in their order.
    pub files: Vec<PathBuf>,
    /// Why the first frame was dropped that cannot be said in messages; recording went on.
    pub fault: Option<String>,
    /// Why recording ended before its time.
    pub error: Option<String>,
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
/// assert_eq!((state.num_messages, state.num_dropped, state.error), (2, 0, None));
/// assert!(state.files[0].ends_with("drive_0000.mcap"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    max_waiting_bytes: usize,
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
    items: VecDeque<Item>,
    /// Of the items, and of the one that is being written.
    waiting_bytes: usize,
    is_ending: bool,
    state: RecordingState,
}

#[derive(Debug)]
enum Item {
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
    /// folder are read as one recording: each recording wants a folder of its own. Waits for the disk.
    ///
    /// # Errors
    /// `Name` (not a file's), `Folder`, `File` (not to be written, or there already: nothing is written over), `Thread`.
    pub fn begin(folder: &Path, name: &str, settings: RecorderSettings) -> Result<Self, RecordError> {
        check(name)?;
        let refused = |error| RecordError::Folder { path: folder.to_owned(), error };
        std::fs::create_dir_all(folder).map_err(refused)?;
        let RecorderSettings { max_file_bytes, max_waiting_bytes, flush_period } = settings;
        let files = Files::begin(folder, name, max_file_bytes)?;
        let shared = Arc::new(Shared::default());
        shared.lock().state.files = files.paths().to_vec();
        let of_thread = Arc::clone(&shared);
        let run =
            move || Writing { shared: of_thread, files, flush_period, flushed: Instant::now(), is_dirty: false }.run();
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(run).map_err(RecordError::Thread)?;
        Ok(Self { shared, max_waiting_bytes, thread: Mutex::new(Some(thread)) })
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
            self.shared.lock().stop("the recorder's thread failed".to_owned());
        }
        self.state()
    }

    fn push(&self, item: Item) {
        let num_bytes = item.num_bytes();
        let mut queue = self.shared.lock();
        let is_full = queue.waiting_bytes.saturating_add(num_bytes) > self.max_waiting_bytes;
        if is_full || queue.is_ending || queue.state.error.is_some() {
            queue.state.num_dropped += 1;
            return;
        }
        queue.waiting_bytes += num_bytes;
        queue.items.push_back(item);
        drop(queue);
        self.shared.changed.notify_one();
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.finish();
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
    /// What it takes while it waits, bytes.
    fn num_bytes(&self) -> usize {
        let Self::Frame(_, frame) = self else { return ITEM_BYTES };
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
    fn stop(&mut self, error: String) {
        self.state.error.get_or_insert(error);
        self.state.num_dropped += self.items.len() as u64;
        self.items.clear();
        self.waiting_bytes = 0;
    }
}

/// What the thread does.
struct Writing {
    shared: Arc<Shared>,
    files: Files,
    flush_period: Duration,
    flushed: Instant,
    /// Whether something was written since.
    is_dirty: bool,
}

/// What there is to do.
enum Work {
    Write(Item),
    Flush,
    End,
}

impl Writing {
    fn run(mut self) {
        let ended = loop {
            let done = match self.next() {
                Work::Write(item) => self.write(&item),
                Work::Flush => self.flush(),
                Work::End => break Ok(()),
            };
            if let Err(error) = done {
                break Err(error);
            }
        };
        let Self { shared, files, .. } = self;
        if let Err(error) = &ended {
            shared.lock().stop(error.to_string());
        }
        if matches!(ended, Err(WriteError::File(_))) {
            // What a refused disk has of the file is read so far.
            return;
        }
        let num_bytes = files.finish();
        let mut queue = shared.lock();
        match num_bytes {
            Ok(num_bytes) => queue.state.num_bytes = num_bytes,
            Err(error) => queue.stop(error.to_string()),
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
            if let Some(item) = queue.items.pop_front() {
                return Work::Write(item);
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

    fn write(&mut self, item: &Item) -> Result<(), WriteError> {
        let written = match item {
            Item::Frame(spec, frame) => self.files.frame(spec, frame),
            Item::Pose(stamp, pose) => self.files.pose(*stamp, &pose.0, pose.1.as_ref()),
        };
        let mut queue = self.shared.lock();
        queue.waiting_bytes = queue.waiting_bytes.saturating_sub(item.num_bytes());
        match written {
            Ok(()) => {}
            Err(WriteError::Unwritable(fault)) => {
                queue.state.num_dropped += 1;
                queue.state.fault.get_or_insert_with(|| fault.to_string());
                return Ok(());
            }
            Err(error) => {
                queue.state.num_dropped += 1;
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

    fn flush(&mut self) -> Result<(), WriteError> {
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

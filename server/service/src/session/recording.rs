//! What a session is sent, and its poses, recorded as MCAP: one recording after the other, each for as long as the session is
//! awake, or until it is told to stop.

use super::recordings::{Recordings, folder_of};
use percept_geometry::{SensorFrame, SensorId, SensorSpec};
use percept_pipeline::{PipelineParams, PoseEstimate};
use percept_recorder::{Recorder, RecordingState};
use percept_slam::{Scale, TrackingState};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Frames after which it is looked whether something goes wrong.
const LOOK_EVERY: u64 = 30;

/// How a session is recorded.
#[derive(Debug, Clone, Default)]
pub struct RecordingStatus {
    /// Whether the frames that it takes are recorded.
    pub is_recorded: bool,
    /// Its newest recording since the server began.
    pub newest: Option<RecordingInfo>,
}

/// One recording.
#[derive(Debug, Clone)]
pub struct RecordingInfo {
    /// When it was begun, server's clock, milliseconds since the Unix epoch.
    pub id: u64,
    /// Its folder below the server's.
    pub folder: String,
    /// Where it is in its life.
    pub phase: RecordingPhase,
    /// What came of it.
    pub state: RecordingState,
}

/// Where a recording is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingPhase {
    /// The next frame begins it.
    Waiting,
    /// Frames are written.
    Running,
    /// What waits is written, then it ends.
    Ending(RecordingEnd),
    /// Its files are whole.
    Ended(RecordingEnd),
}

/// Why a recording ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingEnd {
    /// Somebody asked for it.
    Stopped,
    /// The session fell asleep, or ended otherwise.
    Slept,
    /// The disk is full, or has no more than recordings leave it.
    DiskFull,
    /// The disk refused.
    Failed,
}

/// A session's recordings since the server began, whether it is awake or not.
#[derive(Debug)]
pub(super) struct SessionRecording {
    session: String,
    /// Below the server's folder.
    pub(super) folder: String,
    all: Arc<Recordings>,
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    /// What a call said; none: as configured.
    asked: Option<bool>,
    newest: Option<Newest>,
    /// Those that have not ended.
    open: BTreeSet<u64>,
    /// The last number that was given.
    last: u64,
    /// The newest could not begin: it is tried again after a sleep, or when somebody asks.
    is_barred: bool,
}

#[derive(Debug)]
struct Newest {
    id: u64,
    phase: RecordingPhase,
    recorder: Option<Arc<Recorder>>,
    /// Once it has ended.
    state: RecordingState,
}

impl Newest {
    fn state(&self) -> RecordingState {
        self.recorder.as_ref().map_or_else(|| self.state.clone(), |recorder| recorder.state())
    }

    /// With what the recorder says: it may have ended before its time.
    fn phase(&self, state: &RecordingState) -> RecordingPhase {
        match self.phase {
            RecordingPhase::Running | RecordingPhase::Ending(_) if state.error.is_some() => {
                RecordingPhase::Ended(end_of(state))
            }
            phase => phase,
        }
    }
}

/// Why one ended that had an error.
fn end_of(state: &RecordingState) -> RecordingEnd {
    if state.is_disk_full { RecordingEnd::DiskFull } else { RecordingEnd::Failed }
}

impl Inner {
    fn begin(&mut self) -> &mut Newest {
        // Two within a millisecond, or after the clock was set back, have folders of their own, too.
        let now_ms = u64::try_from(crate::clock::now_ns() / 1_000_000).unwrap_or_default();
        self.last = now_ms.max(self.last.saturating_add(1));
        let (phase, state) = (RecordingPhase::Waiting, RecordingState::default());
        self.newest.insert(Newest { id: self.last, phase, recorder: None, state })
    }
}

impl SessionRecording {
    /// Of a session of a tenant.
    pub(super) fn of(all: &Arc<Recordings>, tenant: &str, session: &str) -> Arc<Self> {
        let (session, folder) = (session.to_owned(), folder_of(tenant, session));
        Arc::new(Self { session, folder, all: Arc::clone(all), inner: Mutex::default() })
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_wanted(&self, inner: &Inner) -> bool {
        inner.asked.unwrap_or_else(|| self.all.names(&self.session))
    }

    fn told(&self, inner: &Inner) -> RecordingStatus {
        let newest = inner.newest.as_ref().map(|newest| {
            let state = newest.state();
            let (id, phase, folder) = (newest.id, newest.phase(&state), format!("{}/{}", self.folder, newest.id));
            RecordingInfo { id, folder, phase, state }
        });
        let has_recorder = inner.newest.as_ref().is_some_and(|newest| newest.recorder.is_some());
        let is_broken = has_recorder && newest.as_ref().is_some_and(|newest| newest.state.error.is_some());
        RecordingStatus { is_recorded: self.is_wanted(inner) && !is_broken && !inner.is_barred, newest }
    }

    /// How it stands.
    pub(super) fn status(&self) -> RecordingStatus {
        self.told(&self.lock())
    }

    /// Whether a recording has not ended.
    pub(super) fn is_open(&self, id: u64) -> bool {
        let inner = self.lock();
        let is_waiting = |newest: &Newest| newest.id == id && newest.phase == RecordingPhase::Waiting;
        inner.open.contains(&id) || inner.newest.as_ref().is_some_and(is_waiting)
    }

    /// One was removed.
    pub(super) fn forget(&self, id: u64) {
        let mut inner = self.lock();
        inner.newest = inner.newest.take().filter(|newest| newest.id != id);
    }

    /// From now on it is recorded: by what is running, else by one that the next frame begins.
    pub(super) fn start(self: &Arc<Self>) -> RecordingStatus {
        let mut inner = self.lock();
        inner.asked = Some(true);
        inner.is_barred = false;
        let is_going = inner.newest.as_ref().is_some_and(|newest| {
            matches!(newest.phase(&newest.state()), RecordingPhase::Waiting | RecordingPhase::Running)
        });
        if !is_going {
            let before = inner.newest.take();
            inner.begin();
            // One that the disk refused.
            if let Some(Newest { id, recorder: Some(recorder), .. }) = before {
                self.close_soon(id, recorder, RecordingEnd::Failed);
            }
        }
        self.told(&inner)
    }

    /// From now on it is not recorded; false if it was not before either. [`Self::end`] ends what is running.
    pub(super) fn stop(&self) -> bool {
        let mut inner = self.lock();
        let was_recorded = self.is_wanted(&inner) || inner.newest.is_some();
        if was_recorded {
            inner.asked = Some(false);
        }
        if let Some(newest) = inner.newest.as_mut().filter(|newest| newest.phase == RecordingPhase::Waiting) {
            newest.phase = RecordingPhase::Ended(RecordingEnd::Stopped);
        }
        was_recorded
    }

    /// Ends what is running; what waits is written, for as long as `patience`: a disk that hangs holds nobody.
    pub(super) async fn end(self: &Arc<Self>, why: RecordingEnd, patience: Duration) {
        let ended = {
            let mut inner = self.lock();
            inner.is_barred = false;
            let Some(newest) = &mut inner.newest else { return };
            let Some(recorder) = newest.recorder.clone() else { return };
            if newest.phase == RecordingPhase::Running {
                newest.phase = RecordingPhase::Ending(why);
            }
            self.close_soon(newest.id, recorder, why)
        };
        match tokio::time::timeout(patience, ended).await {
            Ok(Ok(())) => {}
            Ok(Err(panic)) => tracing::error!(session = self.session, %panic, "a recording was not ended"),
            Err(_) => {
                tracing::error!(
                    session = self.session,
                    "a recording's disk does not answer; it ends when the disk does"
                )
            }
        }
    }

    /// Ends a recording on a thread that may wait for the disk.
    fn close_soon(
        self: &Arc<Self>,
        id: u64,
        recorder: Arc<Recorder>,
        why: RecordingEnd,
    ) -> tokio::task::JoinHandle<()> {
        let this = Arc::clone(self);
        tokio::task::spawn_blocking(move || {
            let state = recorder.finish();
            let mut inner = this.lock();
            // Of several who end one, the first tells it.
            let is_first = inner.open.remove(&id);
            if let Some(newest) = inner.newest.as_mut().filter(|newest| newest.id == id && is_first) {
                let why = match newest.phase {
                    _ if state.error.is_some() => end_of(&state),
                    RecordingPhase::Ending(first) => first,
                    _ => why,
                };
                (newest.phase, newest.state, newest.recorder) = (RecordingPhase::Ended(why), state.clone(), None);
            }
            drop(inner);
            if is_first {
                tell(&this.session, &state);
            }
        })
    }

    /// What takes the next frame, if it is recorded.
    fn recorder(&self) -> Option<Arc<Recorder>> {
        let mut inner = self.lock();
        if !self.is_wanted(&inner) || inner.is_barred {
            return None;
        }
        match &inner.newest {
            Some(Newest { phase: RecordingPhase::Running, recorder, .. }) => return recorder.clone(),
            Some(Newest { phase: RecordingPhase::Waiting, .. }) => {}
            _ => {
                inner.begin();
            }
        }
        let newest = inner.newest.as_mut()?;
        let folder = self.all.whole(&self.folder).join(newest.id.to_string());
        match Recorder::begin_in(&folder, "recording", self.all.recorder_settings(), &self.all.room) {
            Ok(recorder) => {
                tracing::info!(session = self.session, folder = %folder.display(), "a session is recorded");
                let recorder = Arc::new(recorder);
                (newest.phase, newest.recorder) = (RecordingPhase::Running, Some(Arc::clone(&recorder)));
                let id = newest.id;
                inner.open.insert(id);
                Some(recorder)
            }
            Err(error) => {
                newest.phase = RecordingPhase::Ended(RecordingEnd::Failed);
                newest.state.error = Some(error.to_string());
                inner.is_barred = true;
                tracing::error!(session = self.session, %error, "a session is not recorded");
                None
            }
        }
    }
}

/// What is to be known of a session to play its recording again.
pub(super) struct About {
    pub(super) params: PipelineParams,
    /// Keyframes that its map had when the recording began.
    pub(super) num_keyframes: usize,
}

impl About {
    fn entries(&self) -> BTreeMap<String, String> {
        let params = serde_json::to_string(&self.params).unwrap_or_default();
        [("params", params), ("keyframes", self.num_keyframes.to_string())]
            .map(|(name, value)| (name.to_owned(), value))
            .into()
    }
}

/// What an actor gives to its session's recordings.
pub(super) struct Recording {
    of: Arc<SessionRecording>,
    /// As declared.
    specs: BTreeMap<SensorId, Arc<SensorSpec>>,
    frames: u64,
    /// The recording that knows of the session.
    told_about: Option<Arc<Recorder>>,
    /// The recording that was looked at last, and what was told of it.
    looked_at: Option<Arc<Recorder>>,
    are_gaps_told: bool,
    is_error_told: bool,
}

impl Recording {
    /// None where nothing is recorded.
    pub(super) fn of<'a>(of: &Arc<SessionRecording>, sensors: impl Iterator<Item = &'a SensorSpec>) -> Option<Self> {
        let specs = || sensors.map(|spec| (spec.id.clone(), Arc::new(spec.clone()))).collect();
        of.all.is_on().then(|| Self {
            of: Arc::clone(of),
            specs: specs(),
            frames: 0,
            told_about: None,
            looked_at: None,
            are_gaps_told: false,
            is_error_told: false,
        })
    }

    /// The session was changed, perhaps by a sensor that was declared: the next frame tells.
    pub(super) fn change(&mut self, declared: Option<&SensorSpec>) {
        self.specs.extend(declared.map(|spec| (spec.id.clone(), Arc::new(spec.clone()))));
        self.told_about = None;
    }

    /// A frame that was accepted, and the pose that it led to. Never waits. `about`: what is to be known of the session, where the
    /// recording begins.
    pub(super) fn add(&mut self, frame: SensorFrame, pose: Option<&PoseEstimate>, about: impl FnOnce() -> About) {
        let Some(recorder) = self.of.recorder() else { return };
        if !self.told_about.as_ref().is_some_and(|before| Arc::ptr_eq(before, &recorder)) {
            recorder.about(about().entries());
            self.told_about = Some(Arc::clone(&recorder));
        }
        if let Some(spec) = self.specs.get(&frame.sensor) {
            recorder.frame(spec, Arc::new(frame));
        }
        // In metres, and believed.
        if let Some(pose) = pose.filter(|p| p.state == TrackingState::Tracking && p.scale != Scale::Unknown) {
            recorder.pose(pose.stamp, pose.t_map_base, Some(pose.covariance));
        }
        self.frames += 1;
        if self.frames.is_multiple_of(LOOK_EVERY) {
            self.look(recorder);
        }
    }

    fn look(&mut self, recorder: Arc<Recorder>) {
        if !self.looked_at.as_ref().is_some_and(|before| Arc::ptr_eq(before, &recorder)) {
            (self.are_gaps_told, self.is_error_told) = (false, false);
        }
        let state = recorder.state();
        let (has_error, has_gaps) = (state.error.is_some(), state.dropped.total() > 0);
        if (has_error && !self.is_error_told) || (!has_error && has_gaps && !self.are_gaps_told) {
            tell(&self.of.session, &state);
        }
        (self.is_error_told, self.are_gaps_told) = (has_error, has_gaps);
        self.looked_at = Some(recorder);
    }
}

fn tell(session: &str, state: &RecordingState) {
    let RecordingState { num_messages, dropped, num_bytes, files, fault, error, .. } = state;
    let (num_dropped, of) = (dropped.total(), (num_messages, num_bytes, files.len()));
    match error {
        Some(error) => tracing::error!(session, error, num_dropped, "a session is not recorded any more"),
        None if num_dropped > 0 => {
            let why = match fault.as_deref() {
                Some(fault) => fault,
                None if dropped.no_shared_room > 0 => {
                    "what waits of all recordings fills recording.max_waiting_total_mb"
                }
                None => "the disk is slower than the sensors",
            };
            tracing::warn!(
                session,
                num_dropped,
                why,
                messages = of.0,
                bytes = of.1,
                files = of.2,
                "a recording has gaps"
            );
        }
        None => tracing::info!(session, messages = of.0, bytes = of.1, files = of.2, "a recording has ended"),
    }
}

#[cfg(test)]
mod tests;

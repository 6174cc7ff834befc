//! What a session is sent, and its poses, recorded as MCAP for as long as it is awake.

use percept_geometry::{SensorFrame, SensorId, SensorSpec};
use percept_identity::Pattern;
use percept_pipeline::PoseEstimate;
use percept_recorder::{Recorder, RecorderSettings, RecordingState};
use percept_slam::{Scale, TrackingState};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Which sessions are recorded, and where.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSettings {
    /// Folder of recordings; empty: nothing is recorded. A session that wakes begins one in
    /// TENANT/SESSION/MILLISECONDS-SINCE-1970 there, which ends when it sleeps.
    pub dir: String,
    /// Ids of the sessions that are recorded, * for any characters.
    pub sessions: String,
    /// Size from which on a recording goes on in a next file, MB; 1 to 1048576.
    pub max_file_mb: u64,
    /// What may wait to be written of a session, MB; frames beyond it are not recorded, and counted. 1 to 65536.
    pub max_waiting_mb: usize,
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self { dir: String::new(), sessions: "*".to_owned(), max_file_mb: 1024, max_waiting_mb: 64 }
    }
}

impl RecordingSettings {
    /// The first field that cannot be: its name, value, and the remedy.
    pub fn complaint(&self) -> Option<(&'static str, String, &'static str)> {
        let Self { sessions, max_file_mb, max_waiting_mb, .. } = self;
        if Pattern::new(sessions).is_err() {
            let remedy = "write 1 to 64 characters of a-z A-Z 0-9 _ - and * for any others";
            return Some(("recording.sessions", format!("{sessions:?}"), remedy));
        }
        if !(1..=1 << 20).contains(max_file_mb) {
            return Some(("recording.max_file_mb", max_file_mb.to_string(), "set it between 1 and 1048576"));
        }
        let fits = (1..=1 << 16).contains(max_waiting_mb);
        (!fits).then(|| ("recording.max_waiting_mb", max_waiting_mb.to_string(), "set it between 1 and 65536"))
    }
}

/// A session's recording.
pub(super) struct Recording {
    session: String,
    recorder: Arc<Recorder>,
    /// As declared.
    specs: BTreeMap<SensorId, Arc<SensorSpec>>,
    frames: u64,
    /// What went wrong was told.
    is_told: bool,
}

/// Frames after which it is looked whether something goes wrong.
const LOOK_EVERY: u64 = 30;

impl Recording {
    /// Begins one, if this session is recorded. What stands against it is told in the log: the session goes on without.
    pub(super) async fn begin<'a>(
        settings: &RecordingSettings,
        (tenant, session): (&str, &str),
        sensors: impl Iterator<Item = &'a SensorSpec>,
    ) -> Option<Self> {
        if settings.dir.is_empty() || !Pattern::new(&settings.sessions).is_ok_and(|p| p.matches(session)) {
            return None;
        }
        let since_1970 = crate::clock::now_ns() / 1_000_000;
        let folder = Path::new(&settings.dir).join(tenant).join(session).join(since_1970.to_string());
        let settings = RecorderSettings {
            max_file_bytes: settings.max_file_mb << 20,
            max_waiting_bytes: settings.max_waiting_mb << 20,
            ..RecorderSettings::default()
        };
        let into = folder.clone();
        let begun = tokio::task::spawn_blocking(move || Recorder::begin(&into, "recording", settings)).await;
        let recorder = match begun {
            Ok(Ok(recorder)) => Arc::new(recorder),
            Ok(Err(error)) => {
                tracing::error!(session, %error, "a session is not recorded");
                return None;
            }
            Err(panic) => {
                tracing::error!(session, %panic, "a session is not recorded");
                return None;
            }
        };
        tracing::info!(session, folder = %folder.display(), "a session is recorded");
        let specs = sensors.map(|spec| (spec.id.clone(), Arc::new(spec.clone()))).collect();
        Some(Self { session: session.to_owned(), recorder, specs, frames: 0, is_told: false })
    }

    /// A sensor was declared, or otherwise.
    pub(super) fn declare(&mut self, spec: &SensorSpec) {
        self.specs.insert(spec.id.clone(), Arc::new(spec.clone()));
    }

    /// A frame that was accepted, and the pose that it led to.
    pub(super) fn add(&mut self, frame: SensorFrame, pose: Option<&PoseEstimate>) {
        if let Some(spec) = self.specs.get(&frame.sensor) {
            self.recorder.frame(spec, Arc::new(frame));
        }
        // In metres, and believed.
        if let Some(pose) = pose.filter(|p| p.state == TrackingState::Tracking && p.scale != Scale::Unknown) {
            self.recorder.pose(pose.stamp, pose.t_map_base, Some(pose.covariance));
        }
        self.frames += 1;
        if !self.is_told && self.frames.is_multiple_of(LOOK_EVERY) {
            let state = self.recorder.state();
            if state.error.is_some() || state.num_dropped > 0 {
                self.is_told = true;
                tell(&self.session, &state);
            }
        }
    }

    /// Ends it; what waits is written.
    pub(super) async fn end(self) {
        let Self { session, recorder, .. } = self;
        match tokio::task::spawn_blocking(move || recorder.finish()).await {
            Ok(state) => tell(&session, &state),
            Err(panic) => tracing::error!(session, %panic, "a recording was not ended"),
        }
    }
}

fn tell(session: &str, state: &RecordingState) {
    let RecordingState { num_messages, num_dropped, num_bytes, files, fault, error } = state;
    let of = (num_messages, num_bytes, files.len());
    match error {
        Some(error) => tracing::error!(session, error, num_dropped, "a session is not recorded any more"),
        None if *num_dropped > 0 => {
            let why = fault.as_deref().unwrap_or("the disk is slower than the sensors");
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

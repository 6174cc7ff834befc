//! What a session is sent, and its poses, recorded as MCAP for as long as it is awake.

use percept_geometry::{SensorFrame, SensorId, SensorSpec};
use percept_identity::Pattern;
use percept_pipeline::PoseEstimate;
use percept_recorder::{Recorder, RecorderSettings, RecordingState};
use percept_slam::{Scale, TrackingState};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Which sessions are recorded, and where.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSettings {
    /// Folder of recordings; empty: nothing is recorded. The first frame that a session takes after it woke begins one in
    /// TENANT/SESSION/MILLISECONDS-SINCE-1970 there, which ends when it sleeps. They stay when sessions are deleted.
    pub dir: String,
    /// Ids of the sessions that are recorded, * for any characters.
    pub sessions: String,
    /// Size from which on a recording goes on in a next file, MB; 1 to 1048576.
    pub max_file_mb: u64,
    /// What may wait to be written of a session, MB; frames beyond it are not recorded, and counted. 16 to 65536.
    pub max_waiting_mb: usize,
    /// Space that recordings leave on their disk, MB: where there is less, they end.
    pub min_free_mb: u64,
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self { dir: String::new(), sessions: "*".to_owned(), max_file_mb: 1024, max_waiting_mb: 64, min_free_mb: 2048 }
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
        let fits = (16..=1 << 16).contains(max_waiting_mb);
        (!fits).then(|| ("recording.max_waiting_mb", max_waiting_mb.to_string(), "set it between 16 and 65536"))
    }
}

/// A session's recording, from the first frame on.
pub(super) struct Recording {
    session: String,
    folder: PathBuf,
    settings: RecorderSettings,
    recorder: Option<Recorder>,
    /// As declared.
    specs: BTreeMap<SensorId, Arc<SensorSpec>>,
    frames: u64,
    /// What was told of what went wrong.
    are_gaps_told: bool,
    is_error_told: bool,
}

/// Frames after which it is looked whether something goes wrong.
const LOOK_EVERY: u64 = 30;

impl Recording {
    /// Of a session that is recorded; none of another.
    pub(super) fn of<'a>(
        settings: &RecordingSettings,
        (tenant, session): (&str, &str),
        sensors: impl Iterator<Item = &'a SensorSpec>,
    ) -> Option<Self> {
        if settings.dir.is_empty() || !Pattern::new(&settings.sessions).is_ok_and(|p| p.matches(session)) {
            return None;
        }
        let since_1970 = crate::clock::now_ns() / 1_000_000;
        let settings_of = RecorderSettings {
            max_file_bytes: settings.max_file_mb << 20,
            max_waiting_bytes: settings.max_waiting_mb << 20,
            min_free_bytes: settings.min_free_mb.saturating_mul(1 << 20),
            ..RecorderSettings::default()
        };
        Some(Self {
            session: session.to_owned(),
            folder: Path::new(&settings.dir).join(segment(tenant)).join(segment(session)).join(since_1970.to_string()),
            settings: settings_of,
            recorder: None,
            specs: sensors.map(|spec| (spec.id.clone(), Arc::new(spec.clone()))).collect(),
            frames: 0,
            are_gaps_told: false,
            is_error_told: false,
        })
    }

    /// A sensor was declared, or otherwise.
    pub(super) fn declare(&mut self, spec: &SensorSpec) {
        self.specs.insert(spec.id.clone(), Arc::new(spec.clone()));
    }

    /// A frame that was accepted, and the pose that it led to. Never waits.
    pub(super) fn add(&mut self, frame: SensorFrame, pose: Option<&PoseEstimate>) {
        let session = &self.session;
        if self.recorder.is_none() && !self.is_error_told {
            match Recorder::begin(&self.folder, "recording", self.settings.clone()) {
                Ok(recorder) => {
                    tracing::info!(session, folder = %self.folder.display(), "a session is recorded");
                    self.recorder = Some(recorder);
                }
                Err(error) => {
                    self.is_error_told = true;
                    tracing::error!(session, %error, "a session is not recorded");
                }
            }
        }
        let Some(recorder) = &self.recorder else { return };
        if let Some(spec) = self.specs.get(&frame.sensor) {
            recorder.frame(spec, Arc::new(frame));
        }
        // In metres, and believed.
        if let Some(pose) = pose.filter(|p| p.state == TrackingState::Tracking && p.scale != Scale::Unknown) {
            recorder.pose(pose.stamp, pose.t_map_base, Some(pose.covariance));
        }
        self.frames += 1;
        if self.frames.is_multiple_of(LOOK_EVERY) && !self.is_error_told {
            let state = recorder.state();
            let (has_error, has_gaps) = (state.error.is_some(), state.num_dropped > 0);
            if has_error || (has_gaps && !self.are_gaps_told) {
                tell(session, &state);
            }
            (self.is_error_told, self.are_gaps_told) = (has_error, has_gaps);
        }
    }

    /// Ends it; what waits is written, for as long as `patience`: a disk that hangs holds no session.
    pub(super) async fn end(self, patience: Duration) {
        let (session, Some(recorder)) = (self.session, self.recorder) else { return };
        let ended = tokio::task::spawn_blocking(move || recorder.finish());
        match tokio::time::timeout(patience, ended).await {
            Ok(Ok(state)) => tell(&session, &state),
            Ok(Err(panic)) => tracing::error!(session, %panic, "a recording was not ended"),
            Err(_) => tracing::error!(session, "a recording's disk does not answer; it ends when the disk does"),
        }
    }
}

/// A name as one part of a path, another for every name: tenants may be called anything.
fn segment(name: &str) -> String {
    let plain = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-');
    name.bytes().map(|b| if plain(&b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_leads_out_of_the_folder_nor_into_anothers() {
        let names = ["default", "..", "/etc", "a/b", "a%2Fb", "a.b", ""];
        let segments: Vec<String> = names.iter().map(|n| segment(n)).collect();
        assert_eq!(segments, ["default", "%2E%2E", "%2Fetc", "a%2Fb", "a%252Fb", "a%2Eb", ""]);
        let settings = RecordingSettings { dir: "recordings".to_owned(), ..RecordingSettings::default() };
        let of = |tenant| Recording::of(&settings, (tenant, "s"), std::iter::empty()).map(|r| r.folder);
        assert!(of("../x").is_some_and(|f| f.starts_with("recordings/%2E%2E%2Fx/s")));
        assert!(Recording::of(&RecordingSettings::default(), ("a", "s"), std::iter::empty()).is_none());
    }
}

//! Recordings of sessions: begin, end, list, remove.

use super::sessions::page_by_number;
use crate::{Page, RecordingStatus, Result, Service, StoredRecording, check_id};

impl Service {
    /// Begins to record a session with its next frame; one that is recorded goes on.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `SESSION_NOT_MAPPING`, `SESSION_NOT_FOUND`, `SESSION_FAULTED`; faults of the storage.
    pub async fn start_recording(&self, session: &str) -> Result<RecordingStatus> {
        check_id("session_id", session)?;
        self.registry.start_recording(session).await
    }

    /// Ends what is recorded of a session; of one that has ended, how it ended.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `NOT_RECORDED`, `SESSION_NOT_FOUND`.
    pub async fn stop_recording(&self, session: &str) -> Result<RecordingStatus> {
        check_id("session_id", session)?;
        self.registry.stop_recording(session).await
    }

    /// What this server has recorded of a session, the oldest first.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`; `INTERNAL` if the folder cannot be read.
    pub async fn list_recordings(
        &self,
        session: &str,
        page_size: u32,
        page_token: &str,
    ) -> Result<Page<StoredRecording>> {
        check_id("session_id", session)?;
        let stored = self.registry.stored_recordings(session).await?;
        page_by_number(&stored, |r| r.id, page_size, page_token)
    }

    /// Removes a recording that has ended.
    ///
    /// # Errors
    /// `RECORDING_OFF`, `RECORDING_UNDER_WAY`, `RECORDING_NOT_FOUND`, `SESSION_NOT_FOUND`; `INTERNAL` if the disk refuses.
    pub async fn delete_recording(&self, session: &str, recording: &str) -> Result<()> {
        check_id("session_id", session)?;
        self.registry.delete_recording(session, recording).await
    }
}

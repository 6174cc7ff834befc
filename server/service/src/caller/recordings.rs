//! Recordings of sessions, in the name of a caller.

use super::Caller;
use super::audit::Act;
use crate::{Page, RecordingStatus, Result, StoredRecording};

impl Caller {
    /// Begins to record a session.
    ///
    /// # Errors
    /// As [`crate::Service::start_recording`].
    pub async fn start_recording(&self, session: &str) -> Result<RecordingStatus> {
        const NAME: &str = "SessionsService/StartRecording";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.start_recording(session).await;
        act.end(&done);
        done
    }

    /// Ends what is recorded of a session.
    ///
    /// # Errors
    /// As [`crate::Service::stop_recording`].
    pub async fn stop_recording(&self, session: &str) -> Result<RecordingStatus> {
        const NAME: &str = "SessionsService/StopRecording";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.stop_recording(session).await;
        act.end(&done);
        done
    }

    /// What was recorded of a session.
    ///
    /// # Errors
    /// As [`crate::Service::list_recordings`].
    pub async fn list_recordings(&self, session: &str, size: u32, token: &str) -> Result<Page<StoredRecording>> {
        self.may_with("SessionsService/ListRecordings", session).await?;
        self.service.list_recordings(session, size, token).await
    }

    /// Removes a recording of a session.
    ///
    /// # Errors
    /// As [`crate::Service::delete_recording`].
    pub async fn delete_recording(&self, session: &str, recording: &str) -> Result<()> {
        const NAME: &str = "SessionsService/DeleteRecording";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.delete_recording(session, recording).await;
        act.end(&done);
        done
    }
}

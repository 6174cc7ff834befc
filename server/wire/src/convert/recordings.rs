//! Recordings of sessions as messages.

use crate::v1;
use percept_service::{RecordingEnd, RecordingInfo, RecordingPhase, StoredRecording};

/// How a recording stands. Where the server keeps its folder, and what its disk said, is not told.
pub fn recording_to(r: &RecordingInfo) -> v1::Recording {
    let (state, end) = match r.phase {
        RecordingPhase::Waiting => (v1::RecordingState::Waiting, None),
        RecordingPhase::Running => (v1::RecordingState::Running, None),
        RecordingPhase::Ending(end) => (v1::RecordingState::Ending, Some(end)),
        RecordingPhase::Ended(end) => (v1::RecordingState::Ended, Some(end)),
    };
    let dropped = &r.state.dropped;
    v1::Recording {
        recording_id: r.id.to_string(),
        folder: r.folder.clone(),
        state: state.into(),
        end: end.map_or(v1::RecordingEnd::Unspecified, end_to).into(),
        end_message: end.map(end_words).unwrap_or_default().to_owned(),
        start_time_ns: i64::try_from(r.id).unwrap_or(i64::MAX).saturating_mul(1_000_000),
        num_frames: r.state.num_frames,
        num_bytes: r.state.num_bytes,
        num_files: count(r.state.files.len()),
        dropped: Some(v1::RecordingDrops {
            num_too_slow: dropped.too_slow,
            num_no_shared_room: dropped.no_shared_room,
            num_unwritable: dropped.unwritable,
            unwritable_message: r.state.fault.clone().unwrap_or_default(),
            num_after_end: dropped.ended,
        }),
    }
}

/// What there is of one on the disk.
pub fn stored_to(r: &StoredRecording) -> v1::StoredRecording {
    let file = |(name, num_bytes): &(String, u64)| v1::RecordedFile { name: name.clone(), num_bytes: *num_bytes };
    v1::StoredRecording {
        recording_id: r.id.to_string(),
        num_bytes: r.num_bytes,
        num_files: count(r.num_files),
        files: r.files.iter().map(file).collect(),
        last_write_time_ns: r.last_write_time_ns,
        open: r.is_open,
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

const fn end_to(end: RecordingEnd) -> v1::RecordingEnd {
    match end {
        RecordingEnd::Stopped => v1::RecordingEnd::Stopped,
        RecordingEnd::Slept => v1::RecordingEnd::Slept,
        RecordingEnd::DiskFull => v1::RecordingEnd::DiskFull,
        RecordingEnd::Failed => v1::RecordingEnd::Failed,
    }
}

const fn end_words(end: RecordingEnd) -> &'static str {
    match end {
        RecordingEnd::Stopped => "it was stopped; start it to record again",
        RecordingEnd::Slept => {
            "the session fell asleep; if it is recorded still, its next frame begins another recording"
        }
        RecordingEnd::DiskFull => {
            "the disk is full, or has no more left than recording.min_free_mb; make room, then start it again"
        }
        RecordingEnd::Failed => "the disk refused it; see the server's log for the cause, then start it again",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_service::RecordingState;

    #[test]
    fn what_ended_says_why_and_names_no_place_of_the_server() {
        let state = RecordingState {
            num_frames: 3,
            files: vec!["/srv/recordings/a/b/1700000000000/recording_0000.mcap".into()],
            error: Some("/srv/recordings/a/b: no space".to_owned()),
            ..RecordingState::default()
        };
        let (id, folder) = (1_700_000_000_000, "a/b/1700000000000".to_owned());
        let ended = RecordingPhase::Ended(RecordingEnd::DiskFull);
        let told = recording_to(&RecordingInfo { id, folder, phase: ended, state });
        assert_eq!((told.state(), told.end()), (v1::RecordingState::Ended, v1::RecordingEnd::DiskFull));
        assert_eq!((told.start_time_ns, told.num_frames, told.num_files), (1_700_000_000_000_000_000, 3, 1));
        assert!(told.end_message.contains("make room"));
        assert!(!format!("{told:?}").contains("/srv"));
    }
}

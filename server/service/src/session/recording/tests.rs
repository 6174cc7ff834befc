//! A session's recordings, without the session.

use super::super::recordings::RecordingSettings;
use super::*;
use nalgebra::Vector3;
use percept_geometry::sensor::ImuSample;
use percept_geometry::{Pose, SensorData, SensorKind, Timestamp};

const PATIENCE: Duration = Duration::from_secs(60);

/// A session's recordings in a folder, and what its actor gives to them.
fn session(dir: &std::path::Path, sessions: &str, min_free_mb: u64) -> (Arc<SessionRecording>, Recording) {
    let settings = RecordingSettings {
        dir: dir.display().to_string(),
        sessions: sessions.to_owned(),
        min_free_mb,
        ..RecordingSettings::default()
    };
    let of = SessionRecording::of(&Recordings::of(settings), "a", "robot-7");
    let spec = SensorSpec {
        id: SensorId::from("imu"),
        kind: SensorKind::Imu,
        t_base_sensor: Pose::identity(),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let given = Recording::of(&of, [&spec].into_iter()).unwrap();
    (of, given)
}

fn send(to: &mut Recording, number: i64) {
    let data =
        SensorData::Imu(ImuSample { angular_velocity: Vector3::zeros(), linear_acceleration: Vector3::z() * 9.81 });
    let about = || About { params: PipelineParams::default(), num_keyframes: 0 };
    to.add(SensorFrame { sensor: SensorId::from("imu"), stamp: Timestamp(number), data }, None, about);
}

fn phase(of: &SessionRecording) -> Option<RecordingPhase> {
    of.status().newest.map(|newest| newest.phase)
}

#[tokio::test]
async fn a_call_begins_and_ends_what_is_not_configured() {
    let folder = tempfile::tempdir().unwrap();
    let (of, mut given) = session(folder.path(), "", 0);
    send(&mut given, 0);
    assert!(!of.status().is_recorded && phase(&of).is_none() && !of.stop());
    let (first, again) = (of.start(), of.start());
    assert_eq!(first.newest.unwrap().id, again.newest.as_ref().unwrap().id);
    assert_eq!((again.is_recorded, phase(&of)), (true, Some(RecordingPhase::Waiting)));
    (1..=3).for_each(|i| send(&mut given, i));
    let id = again.newest.unwrap().id;
    assert!(of.is_open(id) && phase(&of) == Some(RecordingPhase::Running));
    assert!(of.stop());
    of.end(RecordingEnd::Stopped, PATIENCE).await;
    send(&mut given, 4);
    let status = of.status();
    let newest = status.newest.unwrap();
    assert_eq!((status.is_recorded, newest.phase), (false, RecordingPhase::Ended(RecordingEnd::Stopped)));
    assert_eq!((newest.state.num_frames, newest.folder), (3, format!("a/robot-7/{id}")));
    assert!(!of.is_open(id) && newest.state.files[0].is_file());
    // Once more, by what a millisecond may not separate.
    assert!(of.start().newest.unwrap().id > id);
}

#[tokio::test]
async fn it_goes_on_after_a_sleep_and_a_stopped_one_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let (of, mut given) = session(folder.path(), "*", 0);
    send(&mut given, 0);
    of.end(RecordingEnd::Slept, PATIENCE).await;
    assert_eq!((of.status().is_recorded, phase(&of)), (true, Some(RecordingPhase::Ended(RecordingEnd::Slept))));
    let first = of.status().newest.unwrap().id;
    send(&mut given, 1);
    assert!(of.status().newest.unwrap().id > first);
    assert!(of.stop());
    of.end(RecordingEnd::Stopped, PATIENCE).await;
    of.end(RecordingEnd::Slept, PATIENCE).await;
    send(&mut given, 2);
    assert_eq!((of.status().is_recorded, phase(&of)), (false, Some(RecordingPhase::Ended(RecordingEnd::Stopped))));
}

#[tokio::test]
async fn a_full_disk_ends_it_and_a_start_begins_another() {
    let folder = tempfile::tempdir().unwrap();
    let (of, mut given) = session(folder.path(), "", u64::MAX >> 20);
    of.start();
    send(&mut given, 0);
    let until = std::time::Instant::now() + PATIENCE;
    while of.status().is_recorded && std::time::Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(phase(&of), Some(RecordingPhase::Ended(RecordingEnd::DiskFull)));
    let before = of.status().newest.unwrap().id;
    let again = of.start();
    assert!(again.is_recorded && again.newest.unwrap().id > before);
}

#[tokio::test]
async fn one_that_waits_for_its_first_frame_can_be_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (of, mut given) = session(folder.path(), "", 0);
    let id = of.start().newest.unwrap().id;
    assert!(of.is_open(id) && of.stop());
    of.end(RecordingEnd::Stopped, PATIENCE).await;
    send(&mut given, 0);
    assert_eq!(phase(&of), Some(RecordingPhase::Ended(RecordingEnd::Stopped)));
    assert!(!of.is_open(id) && folder.path().read_dir().unwrap().next().is_none());
}

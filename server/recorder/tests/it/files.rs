//! Files: several, cut, still being written.

use crate::sensors::{at, begin, messages, scan, send, spec};
use percept_bags::{BagError, Recording};
use percept_formats::dataset::open;
use percept_geometry::{LaserScan, Pose, SensorData, SensorKind, Timestamp};
use percept_recorder::{RecordError, Recorder, RecorderSettings};
use std::collections::BTreeMap;
use std::time::Duration;

fn small_files() -> RecorderSettings {
    RecorderSettings { max_file_bytes: 3000, ..RecorderSettings::default() }
}

#[test]
fn a_recording_in_several_files_is_one_and_each_file_can_be_read_alone() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), small_files());
    let front = spec("front", SensorKind::Lidar2d);
    for i in 0..40 {
        send(&recorder, &front, at(i * 100), SensorData::Scan(scan(i as f32 + 1.0)));
    }
    let state = recorder.finish();
    assert!(state.files.len() > 3, "{state:?}");
    let lengths: u64 = state.files.iter().map(|f| std::fs::metadata(f).unwrap().len()).sum();
    assert_eq!((state.num_bytes, state.dropped.total()), (lengths, 0));
    let mut num_frames = 0;
    for (i, file) in state.files.iter().enumerate() {
        assert!(file.ends_with(format!("drive_{i:04}.mcap")));
        let dataset = open(file).unwrap();
        assert_eq!(dataset.notes, [] as [String; 0]);
        assert_eq!(dataset.sensors[0].t_base_sensor.translation, front.t_base_sensor.translation);
        num_frames += dataset.len();
    }
    assert_eq!(num_frames, 40);
    let dataset = open(folder.path()).unwrap();
    let stamps: Vec<_> = (0..40).map(|i| at(i * 100)).collect();
    assert_eq!((dataset.stamps(), dataset.notes.len()), (&stamps[..], 0));
    assert_eq!(messages(folder.path()).len() as u64, state.num_messages);
}

#[test]
fn a_recording_that_is_cut_anywhere_is_read_so_far() {
    let folder = tempfile::tempdir().unwrap();
    let recorder =
        begin(folder.path(), RecorderSettings { flush_period: Duration::ZERO, ..RecorderSettings::default() });
    for i in 0..6 {
        send(&recorder, &spec("front", SensorKind::Lidar2d), at(i * 100), SensorData::Scan(scan(1.0)));
        recorder.pose(at(i * 100), Pose::identity(), None);
    }
    let state = recorder.finish();
    let whole = std::fs::read(&state.files[0]).unwrap();
    let all = messages(&state.files[0]);
    assert_eq!(all.len(), 19);
    let cut = folder.path().join("cut.mcap");
    let mut most = 0;
    for end in (0..whole.len()).step_by(7) {
        std::fs::write(&cut, &whole[..end]).unwrap();
        match Recording::open(&cut) {
            Ok(_) => {
                let read = messages(&cut);
                assert!(
                    read.iter().map(|m| (&m.0, &m.1.bytes)).eq(all.iter().take(read.len()).map(|m| (&m.0, &m.1.bytes)))
                );
                assert!(read.len() >= most, "{} of {most} at {end}", read.len());
                most = read.len();
            }
            Err(BagError::Unrecognised { .. }) => assert!(end < 8),
            Err(error) => panic!("{end}: {error}"),
        }
    }
    assert_eq!(most, 19);
}

#[test]
fn what_was_sent_can_be_read_while_the_recording_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let settings = RecorderSettings { flush_period: Duration::from_millis(1), ..RecorderSettings::default() };
    let recorder = begin(folder.path(), settings);
    send(&recorder, &spec("front", SensorKind::Lidar2d), at(0), SensorData::Scan(scan(1.0)));
    let path = folder.path().join("drive_0000.mcap");
    // Nothing more is sent: what flushes is the period alone.
    let is_there = |_: &u32| Recording::open(&path).is_ok_and(|r| r.topics().iter().any(|t| t.name == "/front/scan"));
    let waited = (0..u32::MAX).inspect(|_| std::thread::yield_now()).find(is_there);
    assert!(waited.is_some() && open(&path).unwrap().len() == 1);
    assert_eq!(recorder.state().error, None);
}

#[test]
fn a_recorder_that_is_dropped_ends_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), RecorderSettings::default());
    recorder.pose(at(0), Pose::identity(), None);
    drop(recorder);
    let recording = Recording::open(folder.path()).unwrap();
    assert_eq!((recording.warnings(), recording.topics().len()), (&[][..], 2));
}

#[test]
fn a_place_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let begin = |folder: &std::path::Path, name: &str| Recorder::begin(folder, name, RecorderSettings::default());
    let error = |folder: &std::path::Path| begin(folder, "drive").unwrap().finish().error;
    assert_eq!(error(&folder.path().join("new/place")), None);
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let words = error(&file).unwrap();
    assert!(words.contains("file: File exists"), "{words}");
    // Nothing is written over.
    assert_eq!(error(folder.path()), None);
    let words = error(folder.path()).unwrap();
    assert!(words.contains("drive_0000.mcap: File exists"), "{words}");
    for name in ["", ".hidden", "a/b", "ü", &"a".repeat(101)] {
        let error = begin(folder.path(), name).unwrap_err();
        let words = error.to_string();
        assert!(matches!(error, RecordError::Name { .. }) && words.contains("is none of a file"), "{words}");
    }
}

#[test]
fn a_disk_keeps_what_it_is_to_have_left() {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        RecorderSettings { flush_period: Duration::ZERO, min_free_bytes: u64::MAX, ..RecorderSettings::default() };
    let recorder = begin(folder.path(), settings);
    recorder.pose(Timestamp(1), Pose::identity(), None);
    let until = std::time::Instant::now() + Duration::from_secs(60);
    while recorder.state().error.is_none() && std::time::Instant::now() < until {
        std::thread::sleep(Duration::from_millis(5));
    }
    let state = recorder.finish();
    assert!(state.error.as_ref().is_some_and(|e| e.contains("that recordings leave it")), "{state:?}");
    // What was written before is whole.
    assert_eq!(Recording::open(folder.path()).unwrap().warnings(), []);
}

#[test]
fn a_next_file_that_cannot_be_begun_ends_the_recording_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let in_the_way = folder.path().join("drive_0001.mcap");
    std::fs::create_dir(&in_the_way).unwrap();
    let recorder = begin(folder.path(), small_files());
    let front = spec("front", SensorKind::Lidar2d);
    let large = LaserScan { ranges_m: (0..2000).map(|i| i as f32).collect(), intensities: None, ..scan(1.0) };
    for i in 0..5 {
        send(&recorder, &front, at(i * 100), SensorData::Scan(large.clone()));
    }
    let state = recorder.finish();
    let error = state.error.clone().unwrap();
    assert!(error.starts_with(&in_the_way.display().to_string()), "{error}");
    assert_eq!((state.dropped.total(), state.files.len()), (4, 1));
    send(&recorder, &front, at(900), SensorData::Scan(large));
    assert_eq!(recorder.finish().dropped.total(), 5);
    // The file before was ended.
    assert_eq!(open(&state.files[0]).unwrap().len(), 1);
}

#[test]
fn what_is_said_of_the_session_is_in_each_file_and_again_where_it_changes() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), small_files());
    let about =
        |value: &str| BTreeMap::from([("params".to_owned(), value.to_owned()), (String::new(), "ü".to_owned())]);
    recorder.about(about("{}"));
    for i in 0..40 {
        if i == 20 {
            recorder.about(about(r#"{"seed": 3}"#));
        }
        send(&recorder, &spec("front", SensorKind::Lidar2d), at(i * 100), SensorData::Scan(scan(i as f32 + 1.0)));
    }
    let state = recorder.finish();
    assert_eq!((state.dropped.total(), state.error), (0, None));
    let said = |path: &std::path::Path| open(path).unwrap().about;
    assert_eq!(said(&state.files[0]), [about("{}")]);
    assert_eq!(said(state.files.last().unwrap()), [about(r#"{"seed": 3}"#)]);
    let all = said(folder.path());
    assert_eq!(all.len(), state.files.len() + 1, "each file's, and the change");
    assert_eq!((all.first(), all.last()), (Some(&about("{}")), Some(&about(r#"{"seed": 3}"#))));
}

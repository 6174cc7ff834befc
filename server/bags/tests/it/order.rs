//! What is written reads back, in the order of its log times.

use percept_bags::{BagError, RecordedMessage, Recording, Writer};
use percept_geometry::Timestamp;
use percept_ros::{Message, messages as m};
use std::path::Path;
use std::sync::Arc;

/// Scans and transforms, `n` of each, the transforms one after all scans but logged between them.
pub(crate) fn write(path: &Path, n: i64, payload: usize) {
    let mut writer = Writer::create(path).unwrap();
    let scans = writer.add_channel("/scan", m::LaserScan::TYPE_NAME, &m::LaserScan::definition()).unwrap();
    for i in 0..n {
        let header = m::Header::new(Timestamp(i), "laser");
        let scan = m::LaserScan { header, ranges: vec![i as f32; payload], ..Default::default() };
        writer.write(scans, Timestamp(i * 100), Timestamp(i * 100 - 1), &scan.encode().unwrap()).unwrap();
    }
    let odometry = writer.add_channel("/odom", m::Odometry::TYPE_NAME, &m::Odometry::definition()).unwrap();
    for i in 0..n {
        let pose = m::Odometry { child_frame_id: "base", ..Default::default() };
        writer.write(odometry, Timestamp(i * 100 + 50), Timestamp(i * 100 + 50), &pose.encode().unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

pub(crate) fn all(recording: &Arc<Recording>) -> Vec<RecordedMessage> {
    recording.messages().map(|m| m.unwrap()).collect()
}

#[test]
fn a_recording_reads_back_by_log_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    // 1000 scans of 4 kB: some chunks.
    write(&path, 1000, 1000);
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.warnings(), []);
    let [scans, odometry] = recording.topics() else { panic!("{:?}", recording.topics()) };
    assert_eq!((scans.name.as_str(), scans.type_name.as_str()), ("/scan", "sensor_msgs/msg/LaserScan"));
    assert_eq!((scans.encoding.as_str(), scans.num_messages), ("cdr", 1000));
    assert_eq!((scans.first, scans.last), (Some(Timestamp(0)), Some(Timestamp(99_900))));
    assert_eq!((odometry.name.as_str(), odometry.num_messages), ("/odom", 1000));
    let messages = all(&recording);
    assert!(messages.is_sorted_by_key(|m| m.log_time) && messages.len() == 2000);
    assert_eq!((messages[2].topic, messages[3].topic), (0, 1));
    assert_eq!(messages[2].publish_time, Timestamp(99));
    let scan = m::LaserScan::decode(&messages[2].bytes).unwrap();
    assert_eq!((scan.header.frame_id, scan.ranges[0]), ("laser", 1.0));
}

#[test]
fn a_folder_of_split_files_is_one_recording() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("b.mcap"), 3, 10);
    write(&folder.path().join("a.mcap"), 2, 10);
    std::fs::write(folder.path().join("metadata.yaml"), "").unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert_eq!(recording.topics().iter().map(|t| t.num_messages).collect::<Vec<_>>(), [5, 5]);
    let messages = all(&recording);
    assert!(messages.is_sorted_by_key(|m| m.log_time) && messages.len() == 10);
}

#[test]
fn an_empty_recording_is_one_and_what_is_none_is_told() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Recording::open(folder.path()), Err(BagError::Empty { .. })));
    let path = folder.path().join("a.mcap");
    Writer::create(&path).unwrap().finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    assert!(recording.topics().is_empty() && recording.warnings().is_empty() && recording.messages().next().is_none());
    std::fs::write(&path, "bag").unwrap();
    assert!(matches!(Recording::open(&path), Err(BagError::Unrecognised { .. })));
    assert!(matches!(Recording::open(&folder.path().join("b.mcap")), Err(BagError::Io { .. })));
}

#[test]
fn what_was_flushed_is_in_the_file_and_no_file_is_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create_new(&path).unwrap();
    let channel =
        writer.add_latched_channel("/tf_static", m::TFMessage::TYPE_NAME, &m::TFMessage::definition()).unwrap();
    let bytes = m::TFMessage::default().encode().unwrap();
    for i in 0..3 {
        writer.write(channel, Timestamp(i), Timestamp(i), &bytes).unwrap();
        writer.flush().unwrap();
        let so_far = Recording::open(&path).unwrap();
        assert_eq!(all(&so_far).len() as i64, i + 1);
        assert!(matches!(so_far.warnings(), [warning] if warning.what.contains("the file has no end")));
        assert_eq!(std::fs::metadata(&path).unwrap().len(), writer.num_bytes());
    }
    // A flush with nothing to hand over writes nothing.
    let before = writer.num_bytes();
    writer.flush().unwrap();
    assert_eq!(writer.num_bytes(), before);
    assert_eq!(writer.finish().unwrap(), std::fs::metadata(&path).unwrap().len());
    let whole = Recording::open(&path).unwrap();
    assert_eq!((whole.warnings(), all(&whole).len()), (&[][..], 3));
    let refused = Writer::create_new(&path);
    assert!(matches!(&refused, Err(BagError::Io { error, .. }) if error.kind() == std::io::ErrorKind::AlreadyExists));
}

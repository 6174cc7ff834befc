//! Between the session and the disk.

use crate::sensors::{at, begin, cloud, depth, imu, scan, send, spec};
use percept_geometry::{PointCloud, Pose, SensorData, SensorKind};
use percept_recorder::{Recorder, RecorderSettings};

#[test]
fn frames_that_do_not_fit_are_counted_and_smaller_ones_go_on() {
    let folder = tempfile::tempdir().unwrap();
    // A depth image takes 4 x 3 x 4 bytes and 512 beside.
    let recorder = begin(folder.path(), RecorderSettings { max_waiting_bytes: 559, ..RecorderSettings::default() });
    for i in 0..10 {
        send(&recorder, &spec("camera", SensorKind::Depth), at(i), SensorData::Depth(depth(1.0)));
    }
    let state = recorder.state();
    assert_eq!((state.num_dropped, state.num_messages), (10, 0));
    send(&recorder, &spec("imu", SensorKind::Imu), at(20), imu());
    let state = recorder.finish();
    assert_eq!((state.num_dropped, state.num_messages, state.error), (10, 2, None));
}

#[test]
fn every_frame_is_written_or_counted() {
    let folder = tempfile::tempdir().unwrap();
    // Room for three scans or so: the thread keeps up with some.
    let recorder = begin(folder.path(), RecorderSettings { max_waiting_bytes: 2000, ..RecorderSettings::default() });
    for i in 0..500 {
        send(&recorder, &spec("lidar", SensorKind::Lidar2d), at(i), SensorData::Scan(scan(1.0)));
    }
    let state = recorder.finish();
    // One is where the sensor sits.
    assert_eq!(state.num_messages - 1 + state.num_dropped, 500);
    recorder.pose(at(600), Pose::identity(), None);
    assert_eq!(recorder.state().num_dropped, state.num_dropped + 1);
}

#[test]
fn a_frame_that_no_message_can_say_is_told_and_recording_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), RecorderSettings::default());
    let lidar = spec("lidar", SensorKind::Lidar3d);
    let uneven = PointCloud { intensities: Some(vec![1.0]), ..cloud() };
    send(&recorder, &lidar, at(0), SensorData::Cloud(uneven));
    send(&recorder, &lidar, at(1), SensorData::Cloud(cloud()));
    let state = recorder.finish();
    assert_eq!((state.num_messages, state.num_dropped, state.error), (2, 1, None));
    assert!(state.fault.as_ref().is_some_and(|f| f.contains("intensities: expected 2")), "{:?}", state.fault);
}

#[test]
fn many_may_give_frames_at_once() {
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Recorder>();
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), RecorderSettings::default());
    std::thread::scope(|scope| {
        for id in ["a", "b", "c"] {
            let recorder = &recorder;
            scope.spawn(move || (0..50).for_each(|i| send(recorder, &spec(id, SensorKind::Imu), at(i), imu())));
        }
    });
    assert_eq!(recorder.finish().num_messages, 150 + 3);
}

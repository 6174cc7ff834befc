//! Between the session and the disk.

use crate::sensors::{at, begin, cloud, depth, imu, scan, send, spec};
use percept_geometry::{PointCloud, Pose, SensorData, SensorKind};
use percept_recorder::{Dropped, Recorder, RecorderSettings, SharedRoom};

#[test]
fn frames_that_do_not_fit_are_counted_and_smaller_ones_go_on() {
    let folder = tempfile::tempdir().unwrap();
    // A depth image takes 4 x 3 x 4 bytes and 512 beside.
    let recorder = begin(folder.path(), RecorderSettings { max_waiting_bytes: 559, ..RecorderSettings::default() });
    for i in 0..10 {
        send(&recorder, &spec("camera", SensorKind::Depth), at(i), SensorData::Depth(depth(1.0)));
    }
    let state = recorder.state();
    assert_eq!((state.dropped.total(), state.num_messages), (10, 0));
    send(&recorder, &spec("imu", SensorKind::Imu), at(20), imu());
    let state = recorder.finish();
    assert_eq!((state.dropped.total(), state.num_messages, state.error), (10, 2, None));
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
    assert_eq!(state.num_messages - 1 + state.dropped.total(), 500);
    recorder.pose(at(600), Pose::identity(), None);
    assert_eq!(recorder.state().dropped.total(), state.dropped.total() + 1);
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
    assert_eq!((state.num_messages, state.dropped.total(), state.error), (2, 1, None));
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

#[test]
fn what_waits_of_all_recordings_together_is_bounded_too_and_given_back() {
    let folder = tempfile::tempdir().unwrap();
    // Room for a pose, and not for a depth image.
    let room = SharedRoom::of(559);
    let recorders: Vec<Recorder> = ["a", "b"]
        .map(|name| Recorder::begin_in(&folder.path().join(name), "drive", RecorderSettings::default(), &room).unwrap())
        .into();
    for recorder in &recorders {
        send(recorder, &spec("camera", SensorKind::Depth), at(0), SensorData::Depth(depth(1.0)));
        let state = recorder.state();
        assert_eq!((state.dropped.no_shared_room, state.dropped.total()), (1, 1));
    }
    for (i, recorder) in recorders.iter().enumerate() {
        recorder.pose(at(1 + i as i64), Pose::identity(), None);
        assert_eq!((recorder.finish().num_messages, recorder.state().num_frames), (2, 0));
        assert_eq!(room.taken(), 0);
    }
}

#[test]
fn what_is_dropped_is_told_by_why() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), RecorderSettings { max_waiting_bytes: 600, ..RecorderSettings::default() });
    let lidar = spec("lidar", SensorKind::Lidar3d);
    let large = PointCloud::from_positions(vec![[0.0, 0.0, 1.0].into(); 100]);
    send(&recorder, &lidar, at(0), SensorData::Cloud(large));
    recorder.finish();
    send(&recorder, &spec("imu", SensorKind::Imu), at(1), imu());
    let dropped = Dropped { too_slow: 1, ended: 1, ..Dropped::default() };
    assert_eq!(recorder.state().dropped, dropped);
}

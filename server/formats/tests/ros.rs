//! Recordings of ROS messages made by the test: what is replayed of them, and what is said of the rest.
#![allow(clippy::unwrap_used, clippy::panic)]

use percept_bags::{ChannelId, Writer};
use percept_formats::dataset::{Dataset, OpenOptions, open, open_with};
use percept_formats::{DatasetKind, FormatError};
use percept_geometry::{SensorData, SensorKind, Timestamp};
use percept_ros::Message;
use percept_ros::messages::{
    CameraInfo, Header, Image, Imu, LaserScan, Odometry, TFMessage, Time, Transform, TransformStamped, Vector3,
};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A recording on its way to a file.
struct Recorder {
    dir: TempDir,
    path: PathBuf,
    writer: Writer,
}

impl Recorder {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("drive.mcap");
        let writer = Writer::create(&path).unwrap();
        Self { dir, path, writer }
    }

    fn topic<'a, M: Message<'a>>(&mut self, name: &str) -> ChannelId {
        self.writer.add_channel(name, M::TYPE_NAME, &M::definition()).unwrap()
    }

    fn write<'a>(&mut self, topic: ChannelId, ms: i64, message: &impl Message<'a>) {
        self.writer.write(topic, at(ms), at(ms), &message.encode().unwrap()).unwrap();
    }

    fn finish(self) -> (TempDir, PathBuf) {
        self.writer.finish().unwrap();
        (self.dir, self.path)
    }
}

fn at(ms: i64) -> Timestamp {
    Timestamp(1_700_000_000_000_000_000 + ms * 1_000_000)
}

fn header(ms: i64, frame_id: &str) -> Header<'_> {
    Header::new(Time::from(at(ms)), frame_id)
}

fn scan(ms: i64, frame_id: &str) -> LaserScan<'_> {
    LaserScan {
        header: header(ms, frame_id),
        angle_min: -1.0,
        angle_max: 1.0,
        angle_increment: 1.0,
        range_max: 10.0,
        ranges: vec![1.0, 2.0, 3.0],
        ..LaserScan::default()
    }
}

fn mounted<'a>(parent: &'a str, child: &'a str, x: f64, z: f64) -> TFMessage<'a> {
    let translation = Vector3 { x, y: 0.0, z };
    let transform = Transform { translation, ..Transform::default() };
    TFMessage { transforms: vec![TransformStamped { header: header(0, parent), child_frame_id: child, transform }] }
}

fn opened(path: &Path, topic: Option<&str>) -> Result<Dataset, FormatError> {
    open_with(path, &OpenOptions { topic: topic.map(str::to_owned), ..OpenOptions::default() })
}

#[test]
fn a_planar_lidar_is_replayed_where_transforms_mount_it_with_wheels_and_imu_beside() {
    let mut r = Recorder::new();
    let (tf, front) = (r.topic::<TFMessage<'_>>("/tf_static"), r.topic::<LaserScan<'_>>("/front/scan"));
    let (rear, odom, imu) =
        (r.topic::<LaserScan<'_>>("/rear"), r.topic::<Odometry<'_>>("/odom"), r.topic::<Imu<'_>>("/imu"));
    r.write(tf, 0, &mounted("base_link", "mast", 0.2, 0.0));
    r.write(tf, 0, &mounted("mast", "laser", 0.1, 0.5));
    for i in 0..10 {
        let odometry =
            Odometry { header: header(100 * i - 5, "odom"), child_frame_id: "base_link", ..Odometry::default() };
        r.write(odom, 100 * i - 5, &odometry);
        r.write(front, 100 * i, &scan(100 * i, "laser"));
        r.write(imu, 100 * i + 1, &Imu { header: header(100 * i + 1, "base_link"), ..Imu::default() });
        if i < 3 {
            r.write(rear, 100 * i + 2, &scan(100 * i + 2, "rear_laser"));
        }
    }
    let (_dir, path) = r.finish();
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.kind, dataset.len(), dataset.is_timed), (DatasetKind::Ros, 10, true));
    let sensors: Vec<(&str, SensorKind)> = dataset.sensors.iter().map(|s| (s.id.0.as_str(), s.kind)).collect();
    let expected = [("front_scan", SensorKind::Lidar2d), ("odom", SensorKind::Odometry), ("imu", SensorKind::Imu)];
    assert_eq!(sensors, expected);
    let mount = dataset.sensors[0].t_base_sensor.translation.vector;
    assert!((mount - nalgebra::Vector3::new(0.3, 0.0, 0.5)).norm() < 1e-12, "{mount}");
    let frames: Vec<_> = dataset.frames(None).map(|f| f.unwrap()).collect();
    assert!(frames.windows(2).all(|w| w[0].stamp <= w[1].stamp));
    let kinds = |kind| frames.iter().filter(|f| f.data.kind() == kind).count();
    assert_eq!((kinds(SensorKind::Lidar2d), kinds(SensorKind::Odometry)), (10, 10));
    let SensorData::Scan(first) = &frames.iter().find(|f| f.sensor.0 == "front_scan").unwrap().data else { panic!() };
    assert_eq!(first.ranges_m, [1.0, 2.0, 3.0]);
    assert!(dataset.notes.iter().any(|n| n.contains("/rear") && n.contains("not replayed")), "{:?}", dataset.notes);
    // A part of it, read again, is the same part.
    let part: Vec<_> = dataset.frames(Some(4..6)).map(|f| f.unwrap()).filter(|f| f.sensor.0 == "front_scan").collect();
    assert_eq!(part.iter().map(|f| f.stamp).collect::<Vec<_>>(), [at(400), at(500)]);
    // Of the other lidar nothing tells the mount.
    let rear = opened(&path, Some("rear")).unwrap();
    assert_eq!((rear.len(), rear.sensors[0].t_base_sensor), (3, percept_geometry::Pose::identity()));
    assert!(rear.notes.iter().any(|n| n.contains("rear_laser") && n.contains("no transform")), "{:?}", rear.notes);
}

#[test]
fn depth_and_colour_of_one_calibration_are_one_camera_and_orphans_are_told() {
    let mut r = Recorder::new();
    let (depth, color) = (r.topic::<Image<'_>>("/cam/depth/image"), r.topic::<Image<'_>>("/cam/color/image"));
    let (of_depth, of_color) =
        (r.topic::<CameraInfo<'_>>("/cam/depth/camera_info"), r.topic::<CameraInfo<'_>>("/cam/color/camera_info"));
    let k = [100.0, 0.0, 1.0, 0.0, 100.0, 0.5, 0.0, 0.0, 1.0];
    let info = CameraInfo { header: header(0, "optical"), width: 2, height: 1, k, ..CameraInfo::default() };
    r.write(of_depth, 0, &info);
    r.write(of_color, 0, &info);
    for i in 0..4_i64 {
        let data = Cow::Owned(vec![232, 3, 208, 7]);
        let image = Image {
            header: header(33 * i, "optical"),
            height: 1,
            width: 2,
            encoding: "16UC1",
            step: 4,
            data,
            ..Image::default()
        };
        r.write(depth, 33 * i, &image);
        // Colour comes after its depth; the third is missing.
        if i != 2 {
            let data = Cow::Owned(vec![i as u8, 2, 3, 4, 5, 6]);
            let image =
                Image { header: header(33 * i + 4, "optical"), encoding: "rgb8", step: 6, data, ..image.clone() };
            r.write(color, 33 * i + 40, &image);
        }
    }
    let (_dir, path) = r.finish();
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.len(), dataset.sensors[0].kind), (3, SensorKind::Rgbd));
    let firsts: Vec<u8> = dataset
        .frames(None)
        .map(|f| match f.unwrap().data {
            SensorData::Rgbd(depth, color) => {
                assert_eq!(depth.at(1, 0), 2.0);
                color.at(0, 0)[0]
            }
            other => panic!("{:?}", other.kind()),
        })
        .collect();
    assert_eq!(firsts, [0, 1, 3]);
    assert!(dataset.notes.iter().any(|n| n.starts_with("3 of 4 depth images")), "{:?}", dataset.notes);
    let alone = open_with(&path, &OpenOptions { depth_only: true, ..OpenOptions::default() }).unwrap();
    assert_eq!((alone.len(), alone.sensors[0].kind), (4, SensorKind::Depth));
}

#[test]
fn what_has_nothing_to_replay_says_what_it_has() {
    let mut r = Recorder::new();
    let imu = r.topic::<Imu<'_>>("/imu");
    r.write(imu, 0, &Imu::default());
    let (_dir, path) = r.finish();
    let words = open(&path).unwrap_err().to_string();
    assert!(words.contains("LaserScan") && words.contains("/imu"), "{words}");
    assert_eq!(words.matches(path.to_str().unwrap()).count(), 1, "{words}");
    let words = opened(&path, Some("/scan")).unwrap_err().to_string();
    assert!(words.contains("no topic /scan"), "{words}");
    let words = opened(&path, Some("/imu")).unwrap_err().to_string();
    assert!(words.contains("nothing that poses are found by"), "{words}");
}

#[test]
fn a_message_that_cannot_be_read_is_an_error_and_the_next_ones_come() {
    let mut r = Recorder::new();
    let topic = r.topic::<LaserScan<'_>>("/scan");
    r.write(topic, 0, &scan(0, "laser"));
    r.writer.write(topic, at(100), at(100), &[0, 1, 0, 0, 1, 2, 3]).unwrap();
    r.write(topic, 200, &scan(200, "laser"));
    let (_dir, path) = r.finish();
    let dataset = open(&path).unwrap();
    let frames: Vec<bool> = dataset.frames(None).map(|f| f.is_ok()).collect();
    assert_eq!(frames, [true, false, true]);
    assert!(dataset.notes.iter().any(|n| n.contains("1 of 3 messages cannot be read")), "{:?}", dataset.notes);
}

#[test]
fn a_folder_of_split_files_needs_no_metadata() {
    let dir = tempfile::tempdir().unwrap();
    for (file, from) in [("b.mcap", 300), ("a.mcap", 0)] {
        let mut writer = Writer::create(&dir.path().join(file)).unwrap();
        let front = writer.add_channel("/front", LaserScan::TYPE_NAME, &LaserScan::definition()).unwrap();
        for ms in (from..from + 300).step_by(100) {
            writer.write(front, at(ms), at(ms), &scan(ms, "laser").encode().unwrap()).unwrap();
        }
        writer.finish().unwrap();
    }
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Ros, 6));
}

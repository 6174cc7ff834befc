//! A recording is replayed as the session was.

use crate::sensors::{at, begin, cloud, color, depth, imu, messages, odometry, record, scan, send, spec};
use percept_formats::dataset::{Dataset, OpenOptions, open, open_with};
use percept_geometry::{
    Covariance6, Distortion, LaserScan, PointCloud, Pose, SensorData, SensorFrame, SensorKind, SensorSpec, Timestamp,
    se3,
};
use percept_recorder::RecorderSettings;
use percept_ros::Message;
use percept_ros::messages::{CameraInfo, PoseWithCovarianceStamped, TFMessage};
use proptest::prelude::*;

fn frames(dataset: &Dataset) -> Vec<(Timestamp, SensorData)> {
    let read = |frame: SensorFrame| (frame.stamp, frame.data);
    dataset.frames(None).map(|frame| read(frame.unwrap())).collect()
}

/// The sensor under another name: a replay names it by its topic.
fn assert_same(read: &SensorSpec, ours: &SensorSpec) {
    let apart = read.t_base_sensor.inverse() * ours.t_base_sensor;
    assert!(apart.translation.vector.norm() < 1e-12 && apart.rotation.angle() < 1e-12, "{read:?}");
    assert_eq!((read.kind, read.intrinsics, read.time_offset_s), (ours.kind, ours.intrinsics, 0.0));
}

#[test]
fn frames_of_each_sensor_that_sees_read_back() {
    let cases = [
        (SensorKind::Lidar2d, SensorData::Scan(scan(1.0)), "front_scan"),
        (SensorKind::Lidar3d, SensorData::Cloud(cloud()), "front_points"),
        (SensorKind::Depth, SensorData::Depth(depth(0.0)), "front_depth_image_raw"),
        (SensorKind::Rgbd, SensorData::Rgbd(depth(2.5), color()), "front_depth_image_raw"),
        (SensorKind::Camera, SensorData::Camera(color()), "front_color_image_raw"),
    ];
    for (kind, data, id) in cases {
        let folder = tempfile::tempdir().unwrap();
        let spec = spec("front", kind);
        let sent: Vec<_> = (0..3).map(|i| (at(i * 100), data.clone())).collect();
        record(folder.path(), &sent.iter().map(|(stamp, data)| (&spec, *stamp, data.clone())).collect::<Vec<_>>());
        for path in [folder.path().to_owned(), folder.path().join("drive_0000.mcap")] {
            let dataset = open(&path).unwrap();
            assert_eq!(dataset.sensors.len(), 1);
            assert_eq!(dataset.sensors[0].id, id.into());
            assert_same(&dataset.sensors[0], &spec);
            assert_eq!(frames(&dataset), sent);
            assert!(!dataset.is_restamped());
            let is_harmless = |note: &String| note.contains("3 of 3 depth images have a colour image");
            assert!(dataset.notes.iter().all(is_harmless), "{:?}", dataset.notes);
        }
    }
}

#[test]
fn wheels_and_an_imu_read_back_beside_a_lidar_with_the_sessions_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let lidar = spec("lidar", SensorKind::Lidar2d);
    let late = SensorSpec { time_offset_s: -0.025, ..spec("imu", SensorKind::Imu) };
    let wheels = SensorSpec { t_base_sensor: Pose::identity(), ..spec("odom", SensorKind::Odometry) };
    let sent = [
        (&wheels, at(0), odometry(1.0)),
        (&lidar, at(20), SensorData::Scan(scan(1.0))),
        (&late, at(35), imu()),
        (&wheels, at(40), odometry(1.5)),
        (&lidar, at(120), SensorData::Scan(scan(2.0))),
    ];
    record(folder.path(), &sent);
    let dataset = open(folder.path()).unwrap();
    let kinds: Vec<_> = dataset.sensors.iter().map(|s| (s.id.0.as_str(), s.kind)).collect();
    let expected =
        [("lidar_scan", SensorKind::Lidar2d), ("odom_2_odometry", SensorKind::Odometry), ("imu_imu", SensorKind::Imu)];
    assert_eq!(kinds, expected);
    for (read, ours) in
        dataset.sensors.iter().zip([&lidar, &wheels, &SensorSpec { time_offset_s: 0.0, ..late.clone() }])
    {
        assert_same(read, ours);
    }
    let found = frames(&dataset);
    // The IMU's offset is in its stamp: it stands where the session had it.
    let stamps: Vec<_> = found.iter().map(|(stamp, data)| (*stamp, data.kind())).collect();
    let (lidar, wheels, imu) = (SensorKind::Lidar2d, SensorKind::Odometry, SensorKind::Imu);
    assert_eq!(stamps, [(at(0), wheels), (at(10), imu), (at(20), lidar), (at(40), wheels), (at(120), lidar)]);
    assert_eq!(found[1].1, crate::sensors::imu());
    assert_eq!(found[4].1, sent[4].2);
    let SensorData::Odometry(read) = &found[3].1 else { panic!("{:?}", found[3]) };
    let SensorData::Odometry(ours) = odometry(1.5) else { panic!() };
    let apart = read.t_odom_base.inverse() * ours.t_odom_base;
    assert!(apart.translation.vector.norm() < 1e-12 && apart.rotation.angle() < 1e-12);
}

#[test]
fn poses_are_told_and_no_replay_takes_them_for_odometry() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = begin(folder.path(), RecorderSettings::default());
    let t_map_base = se3::from_xy_yaw(3.0, -1.0, 1.0);
    for i in 0..3 {
        send(&recorder, &spec("front", SensorKind::Lidar2d), at(i * 100), SensorData::Scan(scan(1.0)));
        recorder.pose(at(i * 100), t_map_base, (i > 0).then(|| Covariance6::identity() * 0.25));
    }
    recorder.finish();
    let dataset = open(folder.path()).unwrap();
    assert_eq!((dataset.sensors.len(), dataset.num_odometry_samples()), (1, 0));
    assert!(dataset.reference.is_none());
    assert_eq!(dataset.notes, [] as [String; 0]);
    assert_same(&dataset.sensors[0], &spec("front", SensorKind::Lidar2d));
    let found = messages(folder.path());
    let of = |topic: &str| found.iter().filter(|(name, _)| name == topic).map(|(_, m)| m).collect::<Vec<_>>();
    let (transforms, poses) = (of("/tf"), of("/percept/pose"));
    assert_eq!((transforms.len(), poses.len()), (3, 3));
    let message = TFMessage::decode(&transforms[1].bytes).unwrap();
    let [t] = &message.transforms[..] else { panic!("{message:?}") };
    assert_eq!((t.header.frame_id, t.child_frame_id), ("map", "base_link"));
    assert_eq!((transforms[1].log_time, Timestamp::from(t.header.stamp)), (at(100), at(100)));
    assert_eq!((t.transform.translation.x, t.transform.translation.y), (3.0, -1.0));
    let covariance = |i: usize| PoseWithCovarianceStamped::decode(&poses[i].bytes).unwrap().pose.covariance;
    assert_eq!(covariance(0), [0.0; 36]);
    assert!((covariance(1)[0] - 0.25).abs() < 1e-12 && (covariance(1)[35] - 0.25).abs() < 1e-12);
}

#[test]
fn a_lens_reads_back_with_its_distortion() {
    let lenses = [
        Distortion::PlumbBob([0.1, -0.2, 0.001, 0.002, 0.3]),
        Distortion::Rational([0.1, -0.2, 0.001, 0.002, 0.3, 0.4, 0.5, 0.6]),
        Distortion::Fisheye([0.1, -0.2, 0.001, 0.002]),
    ];
    for distortion in lenses {
        let folder = tempfile::tempdir().unwrap();
        let mut camera = spec("front", SensorKind::Rgbd);
        camera.intrinsics = camera.intrinsics.map(|i| percept_geometry::CameraIntrinsics { distortion, ..i });
        record(folder.path(), &[(&camera, at(0), SensorData::Rgbd(depth(1.0), color()))]);
        assert_same(&open(folder.path()).unwrap().sensors[0], &camera);
    }
}

#[test]
fn a_declaration_that_changes_is_told_from_then_on() {
    let folder = tempfile::tempdir().unwrap();
    let before = spec("front", SensorKind::Depth);
    let mut after = before.clone();
    after.t_base_sensor.translation.x = 2.0;
    after.intrinsics = after.intrinsics.map(|i| percept_geometry::CameraIntrinsics { fx: 9.0, ..i });
    let image = |i: i64, spec| (spec, at(i * 100), SensorData::Depth(depth(1.0)));
    record(folder.path(), &[image(0, &before), image(1, &before), image(2, &after), image(3, &after)]);
    let found = messages(folder.path());
    let mounts = found.iter().filter(|(name, _)| name == "/tf_static").map(|(_, m)| m);
    let told: Vec<_> = mounts
        .map(|m| (m.log_time, TFMessage::decode(&m.bytes).unwrap().transforms[0].transform.translation.x))
        .collect();
    assert_eq!(told, [(at(0), 0.25), (at(200), 2.0)]);
    let infos = found.iter().filter(|(name, _)| name.ends_with("camera_info"));
    let fx: Vec<_> = infos.map(|(_, m)| CameraInfo::decode(&m.bytes).unwrap().k[0]).collect();
    assert_eq!(fx, [3.5, 3.5, 9.0, 9.0]);
}

#[test]
fn ids_that_ros_would_have_alike_are_kept_apart() {
    let folder = tempfile::tempdir().unwrap();
    let (a, mut b) = (spec("lidar/front", SensorKind::Lidar2d), spec("lidar front", SensorKind::Lidar2d));
    b.t_base_sensor.translation.x = 7.0;
    let sent = [(&a, at(0), SensorData::Scan(scan(1.0))), (&b, at(50), SensorData::Scan(scan(2.0)))];
    record(folder.path(), &sent);
    for (topic, (ours, stamp, data)) in ["/lidar_front/scan", "/lidar_front_2/scan"].into_iter().zip(&sent) {
        let options = OpenOptions { topic: Some(topic.to_owned()), ..OpenOptions::default() };
        let dataset = open_with(folder.path(), &options).unwrap();
        assert_same(&dataset.sensors[0], ours);
        assert_eq!(frames(&dataset), [(*stamp, data.clone())]);
    }
}

fn any_scan() -> impl Strategy<Value = LaserScan> {
    let range = prop_oneof![0f32..100.0, Just(f32::INFINITY), Just(f32::NEG_INFINITY)];
    let beams = prop::collection::vec((range, any::<f32>().prop_filter("NaN is not equal", |v| !v.is_nan())), 1..50);
    (beams, any::<bool>(), -3f32..3.0, -0.1f32..0.1, 0f32..1.0, 1f32..100.0).prop_map(
        |(beams, has_intensities, angle_min, increment, range_min, range_max)| LaserScan {
            angle_min_rad: angle_min.into(),
            angle_increment_rad: increment.into(),
            range_min_m: range_min.into(),
            range_max_m: range_max.into(),
            time_increment_s: 0.0,
            ranges_m: beams.iter().map(|b| b.0).collect(),
            intensities: has_intensities.then(|| beams.iter().map(|b| b.1).collect()),
            later_echoes_m: vec![],
        },
    )
}

fn any_cloud() -> impl Strategy<Value = PointCloud> {
    let point = (prop::array::uniform3(-1e6f32..1e6), any::<[u8; 3]>(), -1e9f32..1e9, -1f32..1.0);
    (prop::collection::vec(point, 1..40), any::<[bool; 4]>()).prop_map(|(points, [c, i, n, t])| PointCloud {
        positions: points.iter().map(|p| p.0.into()).collect(),
        colors: c.then(|| points.iter().map(|p| p.1).collect()),
        intensities: i.then(|| points.iter().map(|p| p.2).collect()),
        normals: n.then(|| points.iter().map(|_| nalgebra::Vector3::y()).collect()),
        time_offsets_s: t.then(|| points.iter().map(|p| p.3).collect()),
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn any_scans_and_clouds_read_back(
        scans in prop::collection::vec(any_scan(), 1..4), clouds in prop::collection::vec(any_cloud(), 1..4),
        id in "\\PC{1,20}",
    ) {
        let folder = tempfile::tempdir().unwrap();
        let (planar, spatial) = (spec(&id, SensorKind::Lidar2d), spec(&format!("{id}_"), SensorKind::Lidar3d));
        let stamped = |data: Vec<SensorData>| (0..).zip(data).map(|(i, d)| (at(i * 100), d)).collect::<Vec<_>>();
        let scans = stamped(scans.into_iter().map(SensorData::Scan).collect());
        let clouds = stamped(clouds.into_iter().map(SensorData::Cloud).collect());
        let all = scans.iter().map(|s| (&planar, s)).chain(clouds.iter().map(|c| (&spatial, c)));
        let all: Vec<_> = all.map(|(spec, (stamp, data))| (spec, *stamp, data.clone())).collect();
        record(folder.path(), &all);
        // Clouds before scans, where nothing else is asked for.
        prop_assert_eq!(frames(&open(folder.path()).unwrap()), clouds);
        let topic = messages(folder.path()).into_iter().map(|m| m.0).find(|t| t.ends_with("/scan"));
        let dataset = open_with(folder.path(), &OpenOptions { topic, ..OpenOptions::default() }).unwrap();
        prop_assert_eq!(frames(&dataset), scans);
    }
}

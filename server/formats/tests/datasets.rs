//! Recordings made by the test: what is recognised, and what is said of what is not.
#![allow(clippy::unwrap_used, clippy::panic)]

use nalgebra::Point3;
use percept_formats::dataset::{Dataset, OpenOptions, open, open_with};
use percept_formats::{DatasetKind, FormatError, images, kitti, pcd};
use percept_geometry::{DepthImage, PointCloud, RgbImage, SensorData, SensorKind, SensorSpec, Timestamp};
use std::path::Path;
use tempfile::TempDir;

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    dir
}

fn depth_png() -> Vec<u8> {
    let depth = DepthImage::from_u16(4, 2, &[0, 500, 1000, 1500, 2000, 2500, 3000, 65535], 0.001).unwrap();
    images::encode_depth_png(&depth, 0.001).unwrap()
}

fn color_png() -> Vec<u8> {
    images::encode_rgb_png(&RgbImage::new(4, 2, (0..24).collect()).unwrap()).unwrap()
}

fn bin(points: usize) -> Vec<u8> {
    let mut out = vec![];
    kitti::write_bin(&mut out, &PointCloud::from_positions(vec![Point3::new(1.0, 2.0, 3.0); points])).unwrap();
    out
}

#[test]
fn tum_frames_are_paired_by_time_and_scaled() {
    let dir = folder(&[
        ("depth.txt", b"# depth\n2.0 depth/b.png\n1.0 depth/a.png\n3.0 depth/c.png\n"),
        ("rgb.txt", b"0.99 rgb/a.png\n1.5 rgb/x.png\n2.015 rgb/b.png\n3.03 rgb/c.png\n"),
        ("groundtruth.txt", b"# truth\n1.0 1 2 3 0 0 0 1\n"),
        ("depth/a.png", &depth_png()),
        ("depth/b.png", &depth_png()),
        ("rgb/a.png", &color_png()),
        ("rgb/b.png", b"not a picture"),
    ]);
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Tum, 2));
    assert_eq!(dataset.stamps(), [Timestamp(1_000_000_000), Timestamp(2_000_000_000)]);
    let camera = &dataset.sensors[0];
    assert_eq!(
        (camera.kind, camera.intrinsics.unwrap().width, camera.intrinsics.unwrap().fx),
        (SensorKind::Rgbd, 4, 525.0)
    );
    let truth = &dataset.reference.as_ref().unwrap()[0].value;
    // A camera with the world's axes looks along the world's z; so its base's x is the world's z.
    assert!((truth.rotation * nalgebra::Vector3::x() - nalgebra::Vector3::z()).norm() < 1e-12);
    assert!((truth.rotation * SensorSpec::optical_rotation()).angle() < 1e-12);
    let mut frames = dataset.frames(None);
    let SensorData::Rgbd(depth, _) = frames.next().unwrap().unwrap().data else { panic!() };
    assert!((depth.at(2, 0) - 0.2).abs() < 1e-6 && depth.at(3, 1) == 0.0);
    let error = frames.next().unwrap().unwrap_err();
    assert!(matches!(error, FormatError::InFile { .. }) && error.to_string().contains("b.png"), "{error}");
    assert!(frames.next().is_none());
    let depth_only = open_with(dir.path(), &OpenOptions { depth_only: true, ..OpenOptions::default() }).unwrap();
    assert_eq!((depth_only.len(), depth_only.sensors[0].kind), (3, SensorKind::Depth));
}

#[test]
fn seven_scenes_in_a_folder_of_its_sequence() {
    let pose = b"1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let dir = folder(&[
        ("seq-01/frame-000030.depth.png", &depth_png()),
        ("seq-01/frame-000030.color.png", &color_png()),
        ("seq-01/frame-000030.pose.txt", pose),
        ("seq-01/frame-000060.depth.png", &depth_png()),
        ("seq-01/frame-000060.pose.txt", b"nan nan nan nan\n"),
    ]);
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.kind, dataset.name.as_str(), dataset.len()), (DatasetKind::SevenScenes, "seq-01", 2));
    // One frame lacks its colour, so none is delivered.
    assert_eq!(dataset.sensors[0].kind, SensorKind::Depth);
    assert_eq!(dataset.stamps(), [Timestamp(1_000_000_000), Timestamp(2_000_000_000)]);
    assert_eq!(dataset.reference.as_ref().unwrap().len(), 1);
    assert_eq!(dataset.frames(None).filter(|f| f.is_ok()).count(), 2);
    assert_eq!(serde_json::to_string(&dataset.kind).unwrap(), "\"7scenes\"");
}

#[test]
fn kitti_rows_are_picked_by_file_number() {
    let poses = b"# three\n1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n";
    let dir = folder(&[
        ("velodyne/000000.bin", &bin(3)),
        ("velodyne/000002.bin", &bin(4)),
        ("velodyne/000007.bin", &bin(5)),
        ("poses.txt", &poses[..poses.len() - 24]),
    ]);
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Kitti, 3));
    assert_eq!(dataset.stamps()[2], Timestamp(700_000_000));
    assert_eq!(dataset.reference.as_ref().unwrap().len(), 1);
    let beyond = [poses.as_slice(), b"1 0 0 3 0 1 0 0 0 0 1 0\n"].concat();
    std::fs::write(dir.path().join("poses.txt"), beyond).unwrap();
    let reference = open(dir.path()).unwrap().reference.unwrap();
    assert_eq!(reference.iter().map(|p| p.value.translation.x).collect::<Vec<_>>(), [0.0, 2.0]);
}

/// The car that KITTI was recorded with has its lidar 1.73 m above the road; scans of an unknown one are in its own frame.
#[test]
fn a_folder_of_the_kitti_car_knows_where_its_lidar_is() {
    // The lidar pitches by a right angle where it stands: its base swings forward.
    let poses = b"1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 0 0 1 0 0 -1 0 0 0\n";
    for (folder_name, height, swung) in [("velodyne/", 1.73, [-1.73, 1.73]), ("", 0.0, [0.0, 0.0])] {
        let names = [0, 1].map(|i| format!("{folder_name}00000{i}.bin"));
        let scan = bin(3);
        let dir = folder(&[(&*names[0], &scan), (&*names[1], &scan), ("poses.txt", poses)]);
        let dataset = open(dir.path()).unwrap();
        let lidar = &dataset.sensors[0];
        assert_eq!(lidar.t_base_sensor.translation.vector.as_slice(), [0.0, 0.0, height]);
        assert_eq!(lidar.range_max_m, (height > 0.0).then_some(120.0));
        let base = dataset.reference.unwrap()[1].value.translation.vector;
        assert!((base.x - swung[0]).abs() < 1e-9 && (base.z - swung[1]).abs() < 1e-9, "{base}");
    }
}

const LOG: &[u8] = b"ODOM 0 0 0 0 0 0 10.0 h 0\nFLASER 2 1 2 0 0 0 0 0 0 10.1 h 0\nODOM 1 0 0 0 0 0 10.2 h 0\n\
    FLASER 2 1 3 1 0 0 1 0 0 10.3 h 0\nODOM 2 0 0 0 0 0 10.4 h 0\nFLASER 2 1 4 2 0 0 2 0 0 10.5 h 0\nODOM 3 0 0 0 0 0 10.6 h 0\n";

#[test]
fn odometry_is_interleaved_and_a_range_counts_scans() {
    let dir =
        folder(&[("drive.clf", LOG), ("drive.corrected.log", b"NEFF 1\nFLASER 2 1.000 3.00 7 8 0 7 8 0 0 h 0\n")]);
    let dataset = open(dir.path()).unwrap();
    let kinds = |range| -> String {
        let letter = |kind| if kind == SensorKind::Odometry { 'o' } else { 'S' };
        dataset.frames(range).map(|f| letter(f.unwrap().data.kind())).collect()
    };
    assert_eq!(kinds(None), "ooSooSooSo");
    assert_eq!(kinds(Some(0..1)), "ooS");
    assert_eq!(kinds(Some(1..2)), "ooS");
    assert_eq!(kinds(Some(1..99)), "ooSooS");
    assert_eq!(kinds(Some(2..2)), "");
    assert_eq!(kinds(Some(7..9)), "");
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!((reference.len(), reference[0].stamp), (1, Timestamp(10_300_000_000)));
    assert_eq!(reference[0].value.translation.x, 7.0);
    assert_eq!(dataset.reference_source.as_deref(), Some("drive.corrected.log"));
}

#[test]
fn clouds_go_by_the_numbers_in_their_names() {
    let cloud = |n: usize| {
        let mut positions = vec![Point3::new(0.0, 1.0, n as f32); n];
        positions.push(Point3::new(f32::NAN, 0.0, 0.0));
        pcd::encode(&PointCloud::from_positions(positions)).unwrap()
    };
    let dir = folder(&[("s10.pcd", &cloud(10)), ("s9.pcd", &cloud(9)), ("notes.md", b"hello")]);
    let dataset = open(dir.path()).unwrap();
    let sizes: Vec<usize> = dataset
        .frames(None)
        .map(|f| match f.unwrap().data {
            SensorData::Cloud(cloud) => cloud.len(),
            _ => 0,
        })
        .collect();
    assert_eq!((dataset.kind, sizes), (DatasetKind::Clouds, vec![9, 10]));
    assert_eq!(open(&dir.path().join("s9.pcd")).unwrap().len(), 1);
}

#[test]
fn clouds_have_their_stamps_from_beside_them_or_from_nobody() {
    let cloud = pcd::encode(&PointCloud::from_positions(vec![Point3::new(0.0, 1.0, 2.0)])).unwrap();
    let seconds = |dataset: &Dataset| dataset.stamps().iter().map(|t| t.0 as f64 / 1e9).collect::<Vec<_>>();
    let times: &[u8] = b"# seconds\n7.25\n7.5\n8\n";
    let truth: &[u8] = b"3.5 0 0 0 0 0 0 1\n4 1 0 0 0 0 0 1\n4.5 2 0 0 0 0 0 1\n";
    let clouds = [("a/1.pcd", &cloud[..]), ("a/2.pcd", &cloud), ("a/3.pcd", &cloud)];
    let with = |others: &[(&str, &[u8])]| folder(&[&clouds[..], others].concat());

    for place in ["times.txt", "a/times.txt"] {
        let dir = with(&[(place, times)]);
        for path in [dir.path().to_owned(), dir.path().join("a")] {
            let dataset = open(&path).unwrap();
            assert_eq!((seconds(&dataset), dataset.is_timed), (vec![7.25, 7.5, 8.0], true), "{place}");
        }
    }
    let dataset = open(with(&[("groundtruth.tum", truth)]).path()).unwrap();
    assert_eq!((seconds(&dataset), dataset.is_timed), (vec![3.5, 4.0, 4.5], true));
    let reference = dataset.reference.unwrap();
    assert_eq!((reference[2].stamp.0, reference[2].value.translation.x), (4_500_000_000, 2.0));
    assert_eq!(dataset.reference_source.as_deref(), Some("groundtruth.tum"));

    // Truth that has rows of its own is none of these clouds' clock.
    for dir in [with(&[]), with(&[("groundtruth.tum", &truth[..18])])] {
        let dataset = open(dir.path()).unwrap();
        assert_eq!((seconds(&dataset), dataset.is_timed), (vec![0.0, 1.0, 2.0], false));
    }
    let error = open(with(&[("times.txt", &times[..15])]).path()).unwrap_err().to_string();
    assert!(error.contains("times.txt: 1 rows for 3 clouds"), "{error}");
    let error = open(with(&[("times.txt", b"7\n8\nlater\n")]).path()).unwrap_err().to_string();
    assert!(error.contains("line 3"), "{error}");
}

#[test]
fn what_is_unknown_or_absent_is_said() {
    let dir = folder(&[("notes.txt", b"nothing here\n"), ("empty/x", b"")]);
    assert!(matches!(open(dir.path()), Err(FormatError::Unrecognised { .. })));
    assert!(matches!(open(&dir.path().join("notes.txt")), Err(FormatError::Unrecognised { .. })));
    assert!(matches!(open(Path::new("/nowhere/at/all")), Err(FormatError::Io { .. })));
}

#[test]
fn an_error_tells_its_path_once() {
    let dir = folder(&[
        ("unknown/notes.txt", b"nothing here\n"),
        ("cut.clf", b"FLASER 2 1\n"),
        ("tum/depth.txt", b"# nothing\n"),
        ("not.mcap", b"none"),
        ("no-bag/metadata.yaml", b"x: 1\n"),
    ]);
    for name in ["unknown", "unknown/notes.txt", "absent", "cut.clf", "tum", "not.mcap", "no-bag"] {
        let path = dir.path().join(name);
        let words = open(&path).unwrap_err().to_string();
        assert_eq!(words.matches(path.to_str().unwrap()).count(), 1, "{words}");
        assert!(words.starts_with(dir.path().to_str().unwrap()), "{words}");
    }
}

#[test]
fn frames_can_be_read_on_another_thread() {
    let dir = folder(&[("drive.clf", LOG)]);
    let frames = open(dir.path()).unwrap().frames(None);
    assert_eq!(std::thread::spawn(move || frames.count()).join().unwrap(), 10);
}

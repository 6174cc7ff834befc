//! Folders of images made by the test: RGB-D in two folders; what is read, supposed and refused.
#![allow(clippy::unwrap_used, clippy::panic)]

use nalgebra::Vector3;
use percept_formats::dataset::{Dataset, OpenOptions, open, open_with};
use percept_formats::{DatasetKind, FormatError, images, pgm};
use percept_geometry::{DepthImage, GrayImage, RgbImage, SensorData, SensorKind};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn write(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn depth_png(width: usize, height: usize) -> Vec<u8> {
    let units: Vec<u16> = (0..width * height).map(|i| (i % 8 * 500) as u16).collect();
    images::encode_depth_png(&DepthImage::from_u16(width, height, &units, 0.001).unwrap(), 0.001).unwrap()
}

fn color_png(width: usize, height: usize) -> Vec<u8> {
    images::encode_rgb_png(&RgbImage::new(width, height, vec![9; width * height * 3]).unwrap()).unwrap()
}

/// The message of an error, and that it begins with a path.
fn refused(folder: &Path) -> String {
    let words = open(folder).unwrap_err().to_string();
    assert!(words.starts_with(folder.to_str().unwrap()), "{words}");
    words
}

fn seconds(dataset: &Dataset) -> Vec<f64> {
    dataset.stamps().iter().map(|t| t.0 as f64 / 1e9).collect()
}

const INTRINSIC: &str = r#"{"width": 8, "height": 4,
"intrinsic_matrix": [5.5, 0, 0, 0, 6.5, 0, 3.5, 1.5, 1]}"#;

const LOG: &str = "0 0 1\n1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 2\n1 0 0 6\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";

/// Two frames of 8 x 4 pixels.
fn redwood() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..2 {
        write(dir.path(), &format!("depth/{i:05}.png"), &depth_png(8, 4));
        write(dir.path(), &format!("color/{i:05}.png"), &color_png(8, 4));
    }
    write(dir.path(), "camera_intrinsic.json", INTRINSIC.as_bytes());
    write(dir.path(), "trajectory.log", LOG.as_bytes());
    write(dir.path(), "odometry.log", LOG.as_bytes());
    dir
}

#[test]
fn a_redwood_folder_has_its_camera_and_its_trajectory() {
    let dir = redwood();
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.kind, dataset.len(), dataset.is_timed), (DatasetKind::RgbdFolders, 2, false));
    assert_eq!(serde_json::to_string(&dataset.kind).unwrap(), format!("\"{}\"", dataset.kind));
    assert_eq!(seconds(&dataset), [0.0, 1.0]);
    let (camera, intrinsics) = (&dataset.sensors[0], dataset.sensors[0].intrinsics.unwrap());
    assert_eq!(camera.kind, SensorKind::Rgbd);
    assert_eq!((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy), (5.5, 6.5, 3.5, 1.5));
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!((reference[1].stamp, reference[1].value.translation.x), (dataset.stamps()[1], 6.0));
    // The camera has the world's axes: its base looks along the world's z.
    assert!((reference[0].value.rotation * Vector3::x() - Vector3::z()).norm() < 1e-12);
    assert_eq!(dataset.reference_source.as_deref(), Some("trajectory.log"));
    assert!(dataset.notes.iter().any(|n| n == "odometry.log is left: the reference is trajectory.log"));
    assert!(dataset.notes.iter().any(|n| n.contains("millimetres are supposed")));
    assert!(!dataset.notes.iter().any(|n| n.contains("intrinsics")));
    let SensorData::Rgbd(depth, _) = dataset.frames(None).next().unwrap().unwrap().data else { panic!() };
    assert!(depth.at(0, 0) == 0.0 && (depth.at(3, 0) - 1.5).abs() < 1e-6);
    std::fs::remove_file(dir.path().join("trajectory.log")).unwrap();
    assert_eq!(open(dir.path()).unwrap().reference_source.as_deref(), Some("odometry.log"));
}

#[test]
fn depth_scale_and_times_are_taken_where_they_are_told() {
    let dir = redwood();
    let told = INTRINSIC.replace("1]}", "1], \"depth_scale\": 5000.0, \"fps\": 25}");
    write(dir.path(), "camera_intrinsic.json", told.as_bytes());
    let dataset = open(dir.path()).unwrap();
    assert_eq!((seconds(&dataset), dataset.is_timed), (vec![0.0, 0.04], true));
    assert!(dataset.notes.iter().any(|n| n.contains("25 a second")) && dataset.notes.len() == 2, "{:?}", dataset.notes);
    let SensorData::Rgbd(depth, _) = dataset.frames(None).next().unwrap().unwrap().data else { panic!() };
    assert!((depth.at(3, 0) - 0.3).abs() < 1e-6);
    write(dir.path(), "times.txt", b"7.5\n7.75\n");
    assert_eq!(seconds(&open(dir.path()).unwrap()), [7.5, 7.75]);
    write(dir.path(), "times.txt", b"7.5\n");
    assert!(refused(dir.path()).contains("times.txt: 1 rows for 2 depth images"));
}

#[test]
fn a_slambook2_folder_has_pgm_and_a_row_for_each_pose() {
    let dir = tempfile::tempdir().unwrap();
    let mut depth = vec![];
    let data = (0..640 * 480).map(|i| (i % 640) as u16).collect();
    pgm::write(&mut depth, &pgm::Pgm { width: 640, height: 480, max_value: 65535, data }).unwrap();
    for i in 9..=10 {
        write(dir.path(), &format!("depth/{i}.pgm"), &depth);
        write(dir.path(), &format!("color/{i}.png"), &color_png(640, 480));
    }
    write(dir.path(), "pose.txt", b"1 2 3 0 0 0 1\n4 5 6 0.5 -0.5 0.5 -0.5");
    let dataset = open(dir.path()).unwrap();
    let intrinsics = dataset.sensors[0].intrinsics.unwrap();
    assert_eq!((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy), (518.0, 519.0, 325.5, 253.5));
    assert!(dataset.notes.iter().any(|n| n.contains("those of slambook2 are supposed, fx 518")), "{:?}", dataset.notes);
    assert_eq!((dataset.len(), dataset.is_timed), (2, false));
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!((reference[1].value.translation.x, dataset.reference_source.as_deref()), (4.0, Some("pose.txt")));
    let SensorData::Rgbd(depth, _) = dataset.frames(None).next().unwrap().unwrap().data else { panic!() };
    assert!((depth.at(600, 3) - 0.6).abs() < 1e-6);
    write(dir.path(), "pose.txt", b"1 2 3 0 0 0 1\n");
    assert!(refused(dir.path()).contains("pose.txt: 1 rows for 2 depth images; write one for each"));
    write(dir.path(), "pose.txt", b"1 2 3 0 0 0 1\n1 2 nan 0 0 0 1\n");
    assert!(refused(dir.path()).contains("pose.txt: poses, line 2:"));
}

#[test]
fn image_folders_that_do_not_fit_are_refused_by_name() {
    let dir = redwood();
    let with = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        let before = std::fs::read(&path).ok();
        write(dir.path(), name, bytes);
        let words = refused(dir.path());
        match before {
            Some(bytes) => std::fs::write(path, bytes).unwrap(),
            None => std::fs::remove_file(path).unwrap(),
        }
        words
    };
    let words = with("depth/00002.png", &depth_png(8, 4));
    assert!(words.contains("2 colour images for 3 depth images, and depth/00002.png has no other"), "{words}");
    let words = with("color/00007.png", b"");
    assert!(words.contains("3 colour images for 2 depth images, and color/00007.png has no other"), "{words}");
    let words = with("camera_intrinsic.json", INTRINSIC.replace("\"width\": 8", "\"width\": 9").as_bytes());
    assert!(words.contains("camera_intrinsic.json: width x height is 9 x 4, the images are 8 x 4"), "{words}");
    let words = with("camera_intrinsic.json", b"{\"width\": 8,\n\"height\" 4}");
    assert!(words.contains("camera_intrinsic.json: Open3D intrinsics, line 2: text is '\"height\" 4}', expected JSON"));
    let words = with("trajectory.log", &LOG.as_bytes()[..LOG.len() - 8]);
    assert!(words.contains("trajectory.log: Redwood log: matrix needs"), "{words}");
    let words = with("trajectory.log", format!("{LOG}{LOG}").as_bytes());
    assert!(words.contains("trajectory.log: 4 rows for 2 depth images"), "{words}");
    let words = with("depth/00000.png", b"no image");
    assert!(words.contains("depth/00000.png: PNG: header needs 24 bytes, 8 are there"), "{words}");
    let words = with("associations.txt", b"0 rgb/0.png 0 depth/0.png\n");
    assert!(words.contains("TUM RGB-D: depth.txt, with rgb.txt the list of its images, is missing"), "{words}");
    std::fs::remove_file(dir.path().join("camera_intrinsic.json")).unwrap();
    let words = refused(dir.path());
    assert!(
        words.contains("camera_intrinsic.json, or camera-intrinsics.txt") && words.contains("is missing"),
        "{words}"
    );
    write(dir.path(), "camera-intrinsics.txt", b"5 0 4\n0 6 2\n0 0 1\n");
    assert_eq!(open(dir.path()).unwrap().sensors[0].intrinsics.unwrap().fy, 6.0);
}

#[test]
fn an_image_that_cannot_be_decoded_is_an_error_and_the_next_comes() {
    let dir = redwood();
    let png = depth_png(8, 4);
    let mut forged = png.clone();
    forged[16..24].copy_from_slice(&[0x7f, 255, 255, 255, 0x7f, 255, 255, 255]);
    let gray = images::encode_gray_png(&GrayImage::new(8, 4, vec![1; 32]).unwrap()).unwrap();
    let cases: [(&[u8], &str); 5] = [
        (&png[..png.len() / 2], "00001.png"),
        (&forged, "num_pixels"),
        (b"P5 60000 60000 65535 x", "num_pixels"),
        (b"P5 8 4 65535 x", "samples needs 64 bytes"),
        (&gray, "16 bits for depth"),
    ];
    for (bytes, words) in cases {
        write(dir.path(), "depth/00001.png", bytes);
        let mut frames = open(dir.path()).unwrap().frames(None);
        assert!(frames.next().unwrap().is_ok());
        let error = frames.next().unwrap().unwrap_err();
        assert!(matches!(error, FormatError::InFile { .. }) && error.to_string().contains(words), "{error}");
    }
    write(dir.path(), "depth/00001.png", b"P5 8 4 255 01234567012345670123456701234567");
    let error = open(dir.path()).unwrap().frames(Some(1..2)).next().unwrap().unwrap_err();
    assert!(error.to_string().contains("maxval '255 (8 bits)' is not supported"), "{error}");
    write(dir.path(), "depth/00001.png", &png);
    write(dir.path(), "color/00001.png", &color_png(4, 4));
    let error = open(dir.path()).unwrap().frames(Some(1..2)).next().unwrap().unwrap_err();
    assert!(error.to_string().contains("color/00001.png"), "{error}");
    let options = OpenOptions { depth_only: true, ..OpenOptions::default() };
    let depth_only = open_with(dir.path(), &options).unwrap();
    assert_eq!(
        (depth_only.sensors[0].kind, depth_only.frames(None).filter(Result::is_ok).count()),
        (SensorKind::Depth, 2)
    );
}

/// The files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut out: Vec<PathBuf> =
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect();
    out.sort();
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn damaged_recordings_never_panic(
        file in any::<prop::sample::Index>(),
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        end in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let dir = redwood();
        let files = files(dir.path());
        let path = &files[file.index(files.len())];
        let mut bytes = std::fs::read(path).unwrap();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(end) = end {
            bytes.truncate(end.index(bytes.len()));
        }
        std::fs::write(path, &bytes).unwrap();
        match open(dir.path()) {
            Ok(dataset) => {
                prop_assert!(dataset.stamps().windows(2).all(|w| w[0] < w[1]));
                prop_assert!(dataset.frames(None).count() <= 5);
            }
            Err(error) => prop_assert!(error.to_string().starts_with(dir.path().to_str().unwrap()), "{}", error),
        }
    }
}

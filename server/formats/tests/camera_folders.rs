//! Folders of images made by the test: RGB-D in two folders, EuRoC; what is read, supposed and refused.
#![allow(clippy::unwrap_used, clippy::panic)]

use nalgebra::{Point3, Vector3};
use percept_formats::dataset::{Dataset, OpenOptions, open, open_with};
use percept_formats::{DatasetKind, FormatError, images, pgm};
use percept_geometry::camera::Distortion;
use percept_geometry::{DepthImage, GrayImage, RgbImage, SensorData, SensorKind, Timestamp};
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

const CAM0: &str = "sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, 0.25,
         1.0, 0.0, 0.0, -0.5,
         0.0, 0.0, 1.0, 0.125,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [8, 4]
camera_model: pinhole
intrinsics: [5.5, 6.5, 3.5, 1.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.25, 0.0625, 0.0001, 0.00001]
";
const IMU0: &str = "sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0,\n 0.0, 1.0, 0.0, 0.0,\n \
    0.0, 0.0, 1.0, 0.0,\n 0.0, 0.0, 0.0, 1.0]\nrate_hz: 200\n";

/// A body that stands upright in the world, turned by 90 degrees, with x up as EuRoC's.
fn euroc() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let gray = images::encode_gray_png(&GrayImage::new(8, 4, (0..32).collect()).unwrap()).unwrap();
    let mav = dir.path().join("V1_00_made/mav0");
    for stamp in ["1403715273262142976", "1403715273312143104"] {
        write(&mav, &format!("cam0/data/{stamp}.png"), &gray);
    }
    let images = "#timestamp [ns],filename\r\n1403715273262142976,1403715273262142976.png\r\n\
        1403715273312143104,1403715273312143104.png\r\n1403715273362142976,1403715273362142976.png\r\n";
    write(&mav, "cam0/data.csv", images.as_bytes());
    write(&mav, "cam0/sensor.yaml", CAM0.as_bytes());
    write(&mav, "cam1/sensor.yaml", CAM0.as_bytes());
    let imu = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],\
        a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n1403715273262142976,0.1,0.2,0.3,9.81,0,0\n\
        1403715273267142912,0.1,0.2,0.3,9.81,0,0\n1403715273392142848,0.1,0.2,0.3,9.81,0,0\n";
    write(&mav, "imu0/data.csv", imu.as_bytes());
    write(&mav, "imu0/sensor.yaml", IMU0.as_bytes());
    let truth = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v\n\
        1403715273262142976,1,2,3,0.7071067811865476,0,-0.7071067811865476,0,0\n\
        1403715273312143104,1,2,4,0.7071067811865476,0,-0.7071067811865476,0,0\n";
    write(&mav, "state_groundtruth_estimate0/data.csv", truth.as_bytes());
    write(&mav, "leica0/data.csv", b"#timestamp\n");
    dir
}

#[test]
fn a_euroc_recording_is_a_camera_with_an_inertial_sensor_beside_it() {
    let dir = euroc();
    let sequence = dir.path().join("V1_00_made");
    for path in [dir.path().to_owned(), sequence.clone(), sequence.join("mav0")] {
        let dataset = open(&path).unwrap();
        assert_eq!((dataset.kind, dataset.name.as_str()), (DatasetKind::Euroc, "V1_00_made"));
        assert_eq!((dataset.len(), dataset.is_timed), (2, true));
        assert_eq!(dataset.stamps()[1], Timestamp(1_403_715_273_312_143_104));
        let kinds: Vec<SensorKind> = dataset.frames(None).map(|f| f.unwrap().data.kind()).collect();
        let (imu, camera) = (SensorKind::Imu, SensorKind::Camera);
        assert_eq!(kinds, [imu, camera, imu, camera, imu]);
        let notes = dataset.notes.join("\n");
        assert!(notes.contains("1 of 3 images of cam0/data.csv are not there"), "{notes}");
        assert!(notes.contains("cam1 is not replayed") && notes.contains("leica0 is not replayed"), "{notes}");
        assert_eq!(dataset.notes.len(), 3, "{notes}");
    }
}

#[test]
fn euroc_mounts_and_truth_are_of_the_base_that_looks_along_x() {
    let dir = euroc();
    let dataset = open(dir.path()).unwrap();
    let [camera, imu] = &dataset.sensors[..] else { panic!() };
    let i = camera.intrinsics.unwrap();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (8, 4, 5.5, 6.5, 3.5, 1.5));
    assert_eq!(i.distortion, Distortion::PlumbBob([-0.25, 0.0625, 0.0001, 0.00001, 0.0]));
    // The body's x points up, its y to the right, its z ahead; gravity is felt upwards.
    let r_base_imu = imu.t_base_sensor.rotation;
    for (of_body, of_base) in
        [(Vector3::x(), Vector3::z()), (Vector3::y(), -Vector3::y()), (Vector3::z(), Vector3::x())]
    {
        assert!((r_base_imu * of_body - of_base).norm() < 1e-12);
    }
    let t_body_base = imu.t_base_sensor.inverse();
    assert!((t_body_base * Point3::origin() - Point3::new(0.25, -0.5, 0.125)).norm() < 1e-12);
    // The truth's body has its x along the world's z, and its z along the world's -x.
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!(dataset.reference_source.as_deref(), Some("state_groundtruth_estimate0/data.csv"));
    let (first, second) = (&reference[0].value, &reference[1].value);
    assert!((first.rotation * Vector3::z() - Vector3::z()).norm() < 1e-12);
    assert!((first.rotation * Vector3::x() + Vector3::x()).norm() < 1e-12);
    assert!((first.translation.vector - Vector3::new(1.0 - 0.125, 2.0 - 0.5, 3.0 + 0.25)).norm() < 1e-12, "{first}");
    assert!((second.translation.vector - first.translation.vector - Vector3::z()).norm() < 1e-12);
}

#[test]
fn a_euroc_recording_that_is_damaged_is_refused_by_file_and_line() {
    let with = |name: &str, from: &str, to: &str| {
        let dir = euroc();
        let path = dir.path().join("V1_00_made/mav0").join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from));
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let words = refused(dir.path());
        assert!(words.contains(path.to_str().unwrap()), "{words}");
        words
    };
    let words = with("cam0/sensor.yaml", "[8, 4]", "[752, 480]");
    assert!(words.ends_with("resolution is 752 x 480, the images are 8 x 4; calibrate for their size"), "{words}");
    assert!(with("cam0/sensor.yaml", "pinhole", "omni").contains("camera_model 'omni' is not supported, only pinhole"));
    assert!(with("cam0/sensor.yaml", "T_BS", "T").contains("T_BS: data is missing"));
    let words = with("cam0/data.csv", "1403715273312143104,", "1403715273212143104,");
    assert!(words.contains("line 3: stamp is '1403715273212143104', expected later"), "{words}");
    assert!(with("cam0/data.csv", ",1403715273312143104.png", "").contains("line 3: file is 'end of line'"));
    assert!(with("imu0/data.csv", ",0.3,9.81,0,0", ",0.3,9.8").contains("line 2: a_y is 'end of line'"));
    assert!(with("imu0/data.csv", "0.2", "inf").contains("line 2: w_y is 'inf', expected a finite number"));
    assert!(with("imu0/sensor.yaml", "1.0]", "2.0]").contains("the last 0, 0, 0, 1"));
    let words = with("state_groundtruth_estimate0/data.csv", "0.7071067811865476", "0.1");
    assert!(words.contains("line 2: quaternion norm is '0.7"), "{words}");

    let dir = euroc();
    let cam0 = dir.path().join("V1_00_made/mav0/cam0");
    write(&cam0, "data/1403715273262142976.png", b"\x89PNG");
    assert!(refused(dir.path()).contains("1403715273262142976.png: PNG: header needs 24 bytes"));
    for file in ["data/1403715273262142976.png", "data/1403715273312143104.png"] {
        std::fs::remove_file(cam0.join(file)).unwrap();
    }
    assert!(refused(dir.path()).contains("cam0/data.csv: EuRoC: every image of the list is missing"));
    std::fs::remove_file(cam0.join("sensor.yaml")).unwrap();
    assert!(refused(dir.path()).contains("cam0/sensor.yaml: No such file"));
    std::fs::remove_dir_all(&cam0).unwrap();
    assert!(refused(&dir.path().join("V1_00_made")).contains("cam0"));
}

#[test]
fn a_euroc_recording_may_lack_all_but_the_camera() {
    let dir = euroc();
    let mav = dir.path().join("V1_00_made/mav0");
    std::fs::remove_file(mav.join("imu0/sensor.yaml")).unwrap();
    std::fs::remove_dir_all(mav.join("state_groundtruth_estimate0")).unwrap();
    let dataset = open(dir.path()).unwrap();
    assert!(dataset.notes.iter().any(|n| n.starts_with("imu0 has no sensor.yaml")), "{:?}", dataset.notes);
    assert!(dataset.reference.is_none() && dataset.reference_source.is_none());
    std::fs::remove_dir_all(mav.join("imu0")).unwrap();
    let dataset = open(dir.path()).unwrap();
    assert_eq!((dataset.sensors.len(), dataset.frames(None).count()), (1, 2));
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
        is_euroc in any::<bool>(),
        file in any::<prop::sample::Index>(),
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        end in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let dir = if is_euroc { euroc() } else { redwood() };
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

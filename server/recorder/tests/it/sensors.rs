//! Sensors, frames and recordings that the tests share.

use percept_bags::{RecordedMessage, Recording};
use percept_geometry::sensor::{ImuSample, OdometrySample};
use percept_geometry::{
    CameraIntrinsics, DepthImage, LaserScan, PointCloud, Pose, RgbImage, SensorData, SensorFrame, SensorKind,
    SensorSpec, Timestamp, se3,
};
use percept_recorder::{Recorder, RecorderSettings, RecordingState};
use std::path::Path;
use std::sync::Arc;

pub(crate) fn at(ms: i64) -> Timestamp {
    Timestamp(1_763_692_800_000_000_000 + ms * 1_000_000 + 7)
}

pub(crate) fn spec(id: &str, kind: SensorKind) -> SensorSpec {
    let is_camera = matches!(kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera);
    let turned = if is_camera { SensorSpec::optical_rotation() } else { se3::from_xy_yaw(0.0, 0.0, 0.5).rotation };
    SensorSpec {
        id: id.into(),
        kind,
        t_base_sensor: Pose::from_parts(nalgebra::Translation3::new(0.25, -0.5, 1.0), turned),
        intrinsics: is_camera.then(|| CameraIntrinsics::pinhole(4, 3, 3.5, 3.25, 1.5, 1.0)),
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

pub(crate) fn scan(first_m: f32) -> LaserScan {
    LaserScan {
        angle_min_rad: -1.5,
        angle_increment_rad: 0.5,
        range_min_m: 0.125,
        range_max_m: 20.0,
        time_increment_s: 0.001953125,
        ranges_m: vec![first_m, f32::INFINITY, f32::NEG_INFINITY, 3.5],
        intensities: Some(vec![1.0, 2.0, 3.0, 4.0]),
        later_echoes_m: vec![],
    }
}

pub(crate) fn cloud() -> PointCloud {
    PointCloud {
        positions: vec![nalgebra::Point3::new(1.1, 2.2, 3.3), nalgebra::Point3::new(-4.0, 0.1, 9.0)],
        colors: Some(vec![[1, 2, 3], [255, 0, 127]]),
        intensities: Some(vec![0.1, 0.9]),
        normals: Some(vec![nalgebra::Vector3::x(), nalgebra::Vector3::z()]),
        time_offsets_s: Some(vec![-0.05, 0.0125]),
    }
}

pub(crate) fn depth(first_m: f32) -> DepthImage {
    DepthImage::new(4, 3, (0..12).map(|i| if i == 0 { first_m } else { i as f32 * 0.123 }).collect()).unwrap()
}

pub(crate) fn color() -> RgbImage {
    RgbImage::new(4, 3, (0..36).map(|i| i * 7).collect()).unwrap()
}

pub(crate) fn imu() -> SensorData {
    SensorData::Imu(ImuSample {
        angular_velocity: nalgebra::Vector3::new(0.1, -0.2, 0.3),
        linear_acceleration: nalgebra::Vector3::new(0.01, 0.02, 9.81),
    })
}

pub(crate) fn odometry(x_m: f64) -> SensorData {
    SensorData::Odometry(OdometrySample { t_odom_base: se3::from_xy_yaw(x_m, 0.5, 0.25), covariance: None })
}

pub(crate) fn begin(folder: &Path, settings: RecorderSettings) -> Recorder {
    Recorder::begin(folder, "drive", settings).unwrap()
}

pub(crate) fn send(recorder: &Recorder, spec: &SensorSpec, stamp: Timestamp, data: SensorData) {
    let frame = SensorFrame { sensor: spec.id.clone(), stamp, data };
    recorder.frame(&Arc::new(spec.clone()), Arc::new(frame));
}

/// Records frames into a folder with default settings; nothing is dropped.
pub(crate) fn record(folder: &Path, frames: &[(&SensorSpec, Timestamp, SensorData)]) -> RecordingState {
    let recorder = begin(folder, RecorderSettings::default());
    for (spec, stamp, data) in frames {
        send(&recorder, spec, *stamp, data.clone());
    }
    let state = recorder.finish();
    assert_eq!((state.dropped.total(), &state.fault, &state.error), (0, &None, &None));
    state
}

/// All messages with their topics.
pub(crate) fn messages(path: &Path) -> Vec<(String, RecordedMessage)> {
    let recording = Recording::open(path).unwrap();
    let named = |m: RecordedMessage| (recording.topics()[m.topic].name.clone(), m);
    recording.messages().map(|m| named(m.unwrap())).collect()
}

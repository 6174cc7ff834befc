//! Bad frames are refused with a reason, and change nothing.

use crate::drive::{empty, feed, planar};
use nalgebra::Point3;
use percept_geometry::{DepthImage, PointCloud, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_pipeline::{FrameError, Pipeline, PipelineParams};

fn lidar() -> SensorSpec {
    SensorSpec {
        id: "lidar".into(),
        kind: SensorKind::Lidar3d,
        t_base_sensor: percept_geometry::Pose::identity(),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

fn cloud(points: Vec<Point3<f32>>) -> SensorFrame {
    let data = SensorData::Cloud(PointCloud::from_positions(points));
    SensorFrame { sensor: "lidar".into(), stamp: Timestamp(5), data }
}

#[test]
fn clouds_that_say_nothing_are_named_so() {
    let mut pipeline = Pipeline::new(PipelineParams::default()).unwrap();
    pipeline.declare_sensor(lidar());
    let mut refuse = |points| pipeline.process(&cloud(points)).unwrap_err();
    assert_eq!(refuse(vec![]), FrameError::CloudEmpty { num_points: 0 });
    assert_eq!(refuse(vec![Point3::new(f32::NAN, 0.0, 0.0)]), FrameError::CloudEmpty { num_points: 1 });
    assert_eq!(refuse(vec![Point3::new(1.0, 2.0, 3.0)]), FrameError::CloudDegenerate { num_points: 1 });
    assert_eq!(refuse(vec![Point3::new(1.0, 2.0, 3.0); 50]), FrameError::CloudDegenerate { num_points: 50 });
}

#[test]
fn the_wrong_kind_and_the_unknown_sensor_are_refused() {
    let mut pipeline = Pipeline::new(PipelineParams::default()).unwrap();
    pipeline.declare_sensor(lidar());
    let data = SensorData::Depth(DepthImage::new(2, 2, vec![1.0; 4]).unwrap());
    let frame = SensorFrame { sensor: "lidar".into(), stamp: Timestamp(1), data };
    assert!(matches!(pipeline.process(&frame), Err(FrameError::KindMismatch { .. })));
    let unknown = SensorFrame { sensor: SensorId("nobody".into()), ..frame };
    assert!(matches!(pipeline.process(&unknown), Err(FrameError::UnknownSensor { .. })));
}

#[test]
fn a_repeated_frame_is_refused_and_the_session_goes_on() {
    let simulation = planar(4.0);
    let frames: Vec<_> = simulation.frames().map(|f| f.frame).collect();
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let (first, rest) = frames.split_at(frames.len() / 2);
    feed(&mut pipeline, first.iter().cloned());
    let before = pipeline.snapshot();
    assert!(matches!(pipeline.process(&first[0]), Err(FrameError::StampNotIncreasing { .. })));
    assert_eq!(pipeline.snapshot().trajectory.len(), before.trajectory.len());
    feed(&mut pipeline, rest.iter().cloned());
    assert!(pipeline.snapshot().pose.unwrap().state.is_tracking());
}

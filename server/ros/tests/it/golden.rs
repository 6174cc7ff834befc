//! What `rosbags` wrote (`tests/golden/ros_messages.py`) reads as what it meant, and is written back byte for byte.

use percept_ros::{Encoding, Message, Value, messages as m};
use serde_json::Value as Json;
use std::collections::BTreeSet;
use std::path::PathBuf;

pub(crate) struct Case {
    pub(crate) encoding: Encoding,
    pub(crate) bytes: Vec<u8>,
    value: Json,
}

fn folder() -> PathBuf {
    PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap()).join("tests/golden")
}

fn file(type_name: &str) -> Json {
    let path = folder().join(format!("{}.json", type_name.replace("/msg/", ".")));
    serde_json::from_slice(&std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))).unwrap()
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[i * 2..i * 2 + 2], 16).unwrap()).collect()
}

pub(crate) fn cases(type_name: &str) -> Vec<Case> {
    let case = |case: &Json| Case {
        encoding: match case["encoding"].as_str().unwrap() {
            "cdr_le" => Encoding::CdrLittleEndian,
            "cdr_be" => Encoding::CdrBigEndian,
            "ros1" => Encoding::Ros1,
            other => panic!("{other}"),
        },
        bytes: bytes(case["bytes"].as_str().unwrap()),
        value: case["value"].clone(),
    };
    file(type_name)["cases"].as_array().unwrap().iter().map(case).collect()
}

/// Every value of the JSON is there; what is there and not in the JSON is in the other ROS alone.
fn assert_same(ours: &Value, theirs: &Json, path: &str) {
    match (ours, theirs) {
        (Value::Fields(fields), Json::Object(object)) => {
            for (name, theirs) in object {
                let found =
                    fields.iter().find(|(n, _)| n == name).unwrap_or_else(|| panic!("{path}.{name} is missing"));
                assert_same(&found.1, theirs, &format!("{path}.{name}"));
            }
        }
        (Value::List(ours), Json::Array(theirs)) => {
            assert_eq!(ours.len(), theirs.len(), "{path}");
            ours.iter().zip(theirs).enumerate().for_each(|(i, (a, b))| assert_same(a, b, &format!("{path}[{i}]")));
        }
        (Value::Float(ours), Json::String(name)) => {
            assert!(ours.total_cmp(&name.parse().unwrap()).is_eq() || ours.is_nan() && name == "nan", "{path}: {ours}");
        }
        (Value::Float(ours), Json::Number(theirs)) => assert_eq!(*ours, theirs.as_f64().unwrap(), "{path}"),
        (Value::Integer(ours), Json::Number(theirs)) => {
            assert_eq!(ours.to_string(), theirs.to_string(), "{path}");
        }
        (Value::Bool(ours), Json::Bool(theirs)) => assert_eq!(ours, theirs, "{path}"),
        (Value::Text(ours), Json::String(theirs)) => assert_eq!(ours, theirs, "{path}"),
        (ours, theirs) => panic!("{path}: {ours:?} for {theirs}"),
    }
}

fn check_case<'a, M: Message<'a>>(case: &'a Case) {
    let message = match case.encoding {
        Encoding::Ros1 => M::decode_ros1(&case.bytes),
        _ => M::decode(&case.bytes),
    };
    let message = message.unwrap_or_else(|e| panic!("{:?}: {e}", case.encoding));
    assert_same(&message.value(), &case.value, M::TYPE_NAME);
    assert_eq!(message.encode_as(case.encoding).unwrap(), case.bytes, "{} {:?}", M::TYPE_NAME, case.encoding);
}

macro_rules! golden {
    ($($test:ident $message:ident;)*) => {
        $(
            #[test]
            fn $test() {
                let name = m::$message::TYPE_NAME;
                assert_eq!(m::$message::type_hash().to_string(), file(name)["hash"].as_str().unwrap());
                cases(name).iter().for_each(check_case::<m::$message>);
            }
        )*

        #[test]
        fn every_golden_file_is_read() {
            let read: BTreeSet<String> = [$(m::$message::TYPE_NAME.replace("/msg/", ".") + ".json"),*].into();
            let there = std::fs::read_dir(folder()).unwrap();
            assert_eq!(read, there.map(|f| f.unwrap().file_name().into_string().unwrap()).collect());
        }
    };
}

golden! {
    time Time;
    duration Duration;
    header Header;
    color_rgba ColorRGBA;
    point Point;
    point_stamped PointStamped;
    vector3 Vector3;
    quaternion Quaternion;
    pose Pose;
    pose_stamped PoseStamped;
    pose_array PoseArray;
    pose_with_covariance PoseWithCovariance;
    pose_with_covariance_stamped PoseWithCovarianceStamped;
    transform Transform;
    transform_stamped TransformStamped;
    twist Twist;
    twist_stamped TwistStamped;
    twist_with_covariance TwistWithCovariance;
    twist_with_covariance_stamped TwistWithCovarianceStamped;
    accel Accel;
    point_cloud2 PointCloud2;
    image Image;
    compressed_image CompressedImage;
    camera_info CameraInfo;
    laser_scan LaserScan;
    imu Imu;
    joint_state JointState;
    nav_sat_fix NavSatFix;
    odometry Odometry;
    occupancy_grid OccupancyGrid;
    path Path;
    occupancy_grid_update OccupancyGridUpdate;
    compressed_point_cloud2 CompressedPointCloud2;
    tf_message TFMessage;
    marker_array MarkerArray;
    detection3d_array Detection3DArray;
}

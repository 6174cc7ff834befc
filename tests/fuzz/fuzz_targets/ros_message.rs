//! ROS messages in CDR and in ROS 1's serialisation.
#![no_main]
use percept_ros::{Encoding, Message, messages as m};

/// What is read is written, and reads again as the same bytes.
macro_rules! read {
    ($bytes:ident: $($message:ident)*) => { $(
        for encoding in [Encoding::CdrLittleEndian, Encoding::Ros1] {
            let is_ros1 = encoding == Encoding::Ros1;
            let read = if is_ros1 { m::$message::decode_ros1($bytes) } else { m::$message::decode($bytes) };
            let Ok(message) = read else { continue };
            let once = message.encode_as(encoding).unwrap();
            let read = if is_ros1 { m::$message::decode_ros1(&once) } else { m::$message::decode(&once) };
            assert_eq!(read.unwrap().encode_as(encoding).unwrap(), once);
        }
    )* };
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    read! {
        bytes: Header PointCloud2 Image CompressedImage CameraInfo LaserScan Imu JointState NavSatFix Odometry OccupancyGrid
        Path OccupancyGridUpdate CompressedPointCloud2 TFMessage MarkerArray Detection3DArray PoseStamped
        PoseWithCovarianceStamped TransformStamped TwistStamped PoseArray
    }
});

//! ROS messages that become geometry.
#![no_main]
use percept_ros::{Message, convert, messages as m};

/// Small enough that a lying header is refused before memory is taken.
const MAX_PIXELS: u64 = 1 << 20;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(message) = m::PointCloud2::decode(bytes)
        && let Ok(read) = convert::cloud(&message, None)
    {
        read.cloud.validate().unwrap();
        let again = convert::cloud_message(&read.cloud, message.header).unwrap();
        assert_eq!(convert::cloud(&again, None).unwrap().cloud.len(), read.cloud.len());
    }
    if let Ok(message) = m::Image::decode(bytes) {
        let _ = (convert::color(&message), convert::depth(&message));
    }
    if let Ok(message) = m::CompressedImage::decode(bytes) {
        let _ = (convert::compressed_color(&message, MAX_PIXELS), convert::compressed_depth(&message, MAX_PIXELS));
    }
    if let Ok(message) = m::CameraInfo::decode(bytes) {
        let _ = (convert::intrinsics(&message), convert::rectified_intrinsics(&message));
    }
    let _ = m::LaserScan::decode(bytes).map(|message| convert::scan(&message));
    let _ = m::Imu::decode(bytes).map(|message| convert::imu(&message));
    let _ = m::Odometry::decode(bytes).map(|message| convert::odometry(&message));
    let _ = m::OccupancyGrid::decode(bytes).map(|message| convert::grid(&message));
});

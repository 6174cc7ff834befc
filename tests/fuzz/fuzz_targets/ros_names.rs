//! Keys, liveliness tokens and attachments of ROS 2 on zenoh.
#![no_main]
use percept_ros::rmw_zenoh::{Attachment, DataKey, LivelinessToken, Qos};
use percept_ros::ros2dds::RouteToken;
use percept_ros::{TypeHash, TypeName};

/// What is read is written, and reads again as the same.
fn read<T: std::str::FromStr + std::fmt::Display + PartialEq>(text: &str) {
    if let Ok(value) = text.parse::<T>() {
        assert!(value.to_string().parse::<T>().is_ok_and(|again| again == value));
    }
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(attachment) = Attachment::parse(bytes) {
        assert_eq!(Attachment::parse(&attachment.to_bytes()), Ok(attachment));
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        read::<DataKey>(text);
        read::<LivelinessToken>(text);
        read::<RouteToken>(text);
        read::<TypeName>(text);
        read::<TypeHash>(text);
        let _ = Qos::parse(text);
    }
});

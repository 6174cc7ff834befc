//! Type hashes as installed ROS 2 packages have them (Jazzy; `ros2 topic info --verbose`).

use percept_ros::{Message, TypeHash, messages as m};

#[test]
fn hashes_are_those_of_installed_packages() {
    let known = [
        (m::Header::type_hash(), "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"),
        (m::PointCloud2::type_hash(), "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"),
        (m::Image::type_hash(), "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"),
        (m::CameraInfo::type_hash(), "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"),
        (m::Imu::type_hash(), "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"),
        (m::NavSatFix::type_hash(), "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404"),
        (m::Odometry::type_hash(), "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
        (m::TFMessage::type_hash(), "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
        (m::LaserScan::type_hash(), "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"),
        (m::CompressedImage::type_hash(), "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"),
        (m::OccupancyGrid::type_hash(), "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"),
        (m::Path::type_hash(), "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"),
    ];
    for (hash, digits) in known {
        assert_eq!(hash.to_string(), format!("RIHS01_{digits}"));
    }
}

#[test]
fn a_hash_reads_back_and_what_is_none_is_refused() {
    let hash = m::Path::type_hash();
    assert_eq!(hash.to_string().parse(), Ok(hash));
    assert_eq!("TypeHashNotSupported".parse(), Ok(TypeHash::NotSupported));
    let short = format!("RIHS01_{}", "0".repeat(63));
    let odd = format!("RIHS01_{}é", "0".repeat(62));
    for text in ["", "RIHS01_", &short, &odd, &format!("{short}g"), &format!("RIHS02_{}", "0".repeat(64))] {
        assert!(text.parse::<TypeHash>().is_err(), "{text}");
    }
}

#[test]
fn a_definition_is_written_as_msg_files_are() {
    let header = "builtin_interfaces/Time stamp\nstring frame_id\n";
    let time = format!("{}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n", "=".repeat(80));
    assert_eq!(m::Header::definition(), format!("{header}{time}"));
    assert!(m::PointCloud2::definition().contains("\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"));
    assert!(m::CameraInfo::definition().contains("\nfloat64[] d\nfloat64[9] k\n"));
}

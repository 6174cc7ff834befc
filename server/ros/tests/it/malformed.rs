//! Bytes that are not what they say: errors that name type, field and byte, and never a panic or much memory.

use crate::golden::cases;
use percept_ros::{DecodeError, EncodeError, Encoding, Fault, Message, messages as m};
use proptest::prelude::*;
use std::borrow::Cow;

type Decode = fn(&[u8], bool) -> Result<(), DecodeError>;

macro_rules! decoders {
    ($($message:ident)*) => {
        [$((m::$message::TYPE_NAME, (|bytes, ros1| {
            let read = if ros1 { m::$message::decode_ros1(bytes) } else { m::$message::decode(bytes) };
            read.map(|message| {
                let encoding = if ros1 { Encoding::Ros1 } else { Encoding::CdrLittleEndian };
                message.encode_as(encoding).unwrap();
            })
        }) as Decode)),*]
    };
}

/// One of each kind of decoder: all others are made of the same.
fn decoders() -> [(&'static str, Decode); 19] {
    decoders! {
        Header PointCloud2 Image CompressedImage CameraInfo LaserScan Imu JointState NavSatFix Odometry OccupancyGrid Path
        OccupancyGridUpdate CompressedPointCloud2 TFMessage MarkerArray Detection3DArray PoseWithCovarianceStamped
        TwistStamped
    }
}

#[test]
fn a_message_that_is_cut_is_an_error_at_every_length() {
    for (name, decode) in decoders() {
        for case in cases(name) {
            let is_ros1 = case.encoding == Encoding::Ros1;
            for end in 0..case.bytes.len() {
                let error = decode(&case.bytes[..end], is_ros1).expect_err(name);
                assert!(error.message == name && error.byte <= end as u64, "{error:?} of {end}");
            }
        }
    }
}

#[test]
fn what_follows_a_message_is_padding_or_an_error() {
    let mut bytes = m::Time { sec: 1, nanosec: 2 }.encode().unwrap();
    bytes.extend([0; 7]);
    assert!(m::Time::decode(&bytes).is_ok());
    bytes.push(0);
    let error = m::Time::decode(&bytes).unwrap_err();
    assert_eq!((error.byte, error.fault), (12, Fault::Trailing { extra: 8 }));
}

fn cloud() -> Vec<u8> {
    let fields = vec![
        m::PointField { name: "x", offset: 0, datatype: 7, count: 1 },
        m::PointField { name: "y", offset: 4, datatype: 7, count: 1 },
    ];
    let data = Cow::Owned(vec![0; 16]);
    m::PointCloud2 { width: 2, height: 1, fields, point_step: 8, row_step: 16, data, ..Default::default() }
        .encode()
        .unwrap()
}

#[test]
fn errors_name_type_field_byte_and_remedy() {
    let bytes = cloud();
    // 4 encapsulation, 8 stamp, 5 frame, 3 padding, 8 size, 4 count: the first field begins at 32, the second at 52.
    let error = m::PointCloud2::decode(&bytes[..60]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "sensor_msgs/msg/PointCloud2, fields[1].offset, byte 58: needs 6 bytes, 2 are left; the payload is cut off or of \
         another type"
    );
    let error = m::PointCloud2::decode(&bytes[..40]).unwrap_err();
    assert_eq!((error.field.as_str(), error.byte), ("fields", 28));
    assert_eq!(error.fault, Fault::CountTooLarge { count: 2, least_bytes: 13, available: 8 });
}

#[test]
fn a_length_that_lies_takes_no_memory() {
    let mut bytes = cloud();
    bytes[28..32].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = m::PointCloud2::decode(&bytes).unwrap_err();
    let available = bytes.len() as u64 - 32;
    assert_eq!(error.field, "fields");
    assert_eq!(error.fault, Fault::CountTooLarge { count: u64::from(u32::MAX), least_bytes: 13, available });
}

#[test]
fn encapsulations_that_are_not_plain_cdr_are_refused() {
    for kind in [[0, 2], [0, 3], [0, 7], [1, 0]] {
        let error = m::Time::decode(&[kind[0], kind[1], 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]).unwrap_err();
        assert_eq!(error.fault, Fault::Encapsulation { found: kind });
        assert!(error.to_string().contains("send plain CDR"), "{error}");
    }
}

#[test]
fn strings_end_in_nul_and_an_empty_one_may_have_none() {
    let header =
        |length: u32, text: &[u8]| [&[0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0], &length.to_le_bytes()[..], text].concat();
    assert_eq!(m::Header::decode(&header(0, b"")).unwrap().frame_id, "");
    assert_eq!(m::Header::decode(&header(1, b"\0")).unwrap().frame_id, "");
    assert_eq!(m::Header::decode(&header(4, b"map\0")).unwrap().frame_id, "map");
    let error = m::Header::decode(&header(3, b"map")).unwrap_err();
    assert_eq!((error.field.as_str(), error.fault), ("frame_id", Fault::NoTerminator { length: 3, last: b'p' }));
    let error = m::Header::decode(&header(4, b"m\xffp\0")).unwrap_err();
    assert_eq!((error.byte, error.fault), (17, Fault::NotUtf8 { length: 4, at: 1 }));
}

#[test]
fn what_ros1_has_otherwise_is_not_read_or_written_as_such() {
    assert_eq!(m::Detection3DArray::decode_ros1(&[]).unwrap_err().fault, Fault::NotInRos1);
    let error = m::Detection3DArray::default().encode_as(Encoding::Ros1).unwrap_err();
    assert_eq!(error, EncodeError::NotInRos1 { message: "vision_msgs/msg/Detection3DArray" });
}

#[test]
fn large_payloads_are_borrowed() {
    let bytes = cloud();
    let cloud = m::PointCloud2::decode(&bytes).unwrap();
    assert!(matches!(cloud.data, Cow::Borrowed(data) if bytes.as_ptr_range().contains(&data.as_ptr())));
}

proptest! {
    #[test]
    fn any_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..400), plain in any::<bool>(), ros1 in any::<bool>()) {
        if plain && bytes.len() > 1 {
            bytes[..2].copy_from_slice(&[0, 1]);
        }
        for (_, decode) in decoders() {
            let _ = decode(&bytes, ros1);
        }
    }

    #[test]
    fn damaged_bytes_never_panic(
        kind in 0usize..19, case in any::<prop::sample::Index>(), end in any::<prop::sample::Index>(),
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let (name, decode) = decoders()[kind];
        let cases = cases(name);
        let case = case.get(&cases);
        let mut bytes = case.bytes.clone();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] ^= value;
        }
        let is_ros1 = case.encoding == Encoding::Ros1;
        let _ = (decode(&bytes, is_ros1), decode(&bytes[..end.index(bytes.len())], is_ros1));
    }
}

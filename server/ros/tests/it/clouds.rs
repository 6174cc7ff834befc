//! Clouds of the layouts that drivers send, made here byte by byte.

use nalgebra::{Point3, Vector3};
use percept_geometry::{PointCloud, Timestamp};
use percept_ros::convert::{ConvertError, PointTimes, TimeUnit, cloud, cloud_message};
use percept_ros::messages::{Header, PointCloud2, PointField};
use percept_ros::{Encoding, Message};
use proptest::prelude::*;
use std::borrow::Cow;

const STAMP: Timestamp = Timestamp(1_763_692_800_100_000_000);

fn field(name: &str, offset: u32, datatype: u8) -> PointField<'_> {
    PointField { name, offset, datatype, count: 1 }
}

/// An organised cloud of two rows of three in a layout of 22 bytes with holes; rows end in 5 bytes of padding.
fn organised(big_endian: bool) -> PointCloud2<'static> {
    let fields = vec![
        field("x", 0, 7),
        field("y", 4, 8),
        field("z", 12, 3),
        field("reflectivity", 15, 2),
        field("t", 16, 6),
        field("ring", 20, 4),
    ];
    let mut data = vec![];
    for row in 0..2 {
        for column in 0..3u32 {
            let i = row * 3 + column;
            let x = if i == 4 { f32::NAN } else { i as f32 + 0.25 };
            let (y, z, t, ring) = (-f64::from(i), -(i as i16) * 10, i * 1_000_000, 7u16);
            if big_endian {
                data.extend(x.to_be_bytes());
                data.extend(y.to_be_bytes());
                data.extend(z.to_be_bytes());
                data.extend([9, i as u8 * 10]);
                data.extend(t.to_be_bytes());
                data.extend(ring.to_be_bytes());
            } else {
                data.extend(x.to_le_bytes());
                data.extend(y.to_le_bytes());
                data.extend(z.to_le_bytes());
                data.extend([9, i as u8 * 10]);
                data.extend(t.to_le_bytes());
                data.extend(ring.to_le_bytes());
            }
        }
        data.extend([0xee; 5]);
    }
    PointCloud2 {
        header: Header::new(STAMP, "lidar"),
        height: 2,
        width: 3,
        fields,
        is_bigendian: big_endian,
        point_step: 22,
        row_step: 71,
        data: Cow::Owned(data),
        is_dense: false,
    }
}

#[test]
fn layouts_with_holes_and_padding_read_alike_in_both_byte_orders() {
    for big_endian in [false, true] {
        let read = cloud(&organised(big_endian), None).unwrap();
        assert_eq!((read.num_dropped, read.times), (1, PointTimes::Relative(TimeUnit::Nanoseconds)));
        let at = |i: i16| Point3::new(f32::from(i) + 0.25, -f32::from(i), f32::from(-i * 10));
        assert_eq!(read.cloud.positions, [0, 1, 2, 3, 5].map(at));
        assert_eq!(read.cloud.intensities.unwrap(), [0.0, 10.0, 20.0, 30.0, 50.0]);
        assert_eq!(read.cloud.time_offsets_s.unwrap(), [0.0, 0.001, 0.002, 0.003, 0.005]);
        assert!(read.cloud.colors.is_none() && read.cloud.normals.is_none());
    }
}

#[test]
fn the_last_rows_padding_may_be_left_out() {
    let mut message = organised(false);
    message.data.to_mut().truncate(71 + 66);
    assert_eq!(cloud(&message, None).unwrap().cloud.len(), 5);
    message.data.to_mut().truncate(71 + 65);
    let error = cloud(&message, None).unwrap_err();
    assert!(matches!(error, ConvertError::Truncated { needed: 137, available: 136, .. }), "{error}");
}

#[test]
fn absolute_times_of_64_bits_become_offsets() {
    let fields = vec![field("x", 0, 7), field("y", 4, 7), field("z", 8, 7), field("timestamp", 12, 8)];
    let first = STAMP.as_secs_f64();
    let data = [0.0, 0.05, 0.1].iter().flat_map(|t| [&[0; 12][..], &(first + t).to_le_bytes()].concat()).collect();
    let mut message = PointCloud2 {
        header: Header::new(STAMP, ""),
        height: 1,
        width: 3,
        fields,
        point_step: 20,
        ..Default::default()
    };
    message.data = data;
    let read = cloud(&message, None).unwrap();
    assert_eq!(read.times, PointTimes::Absolute(TimeUnit::Seconds));
    for (offset, expected) in read.cloud.time_offsets_s.unwrap().iter().zip([0.0, 0.05, 0.1]) {
        assert!((offset - expected).abs() < 1e-6, "{offset}");
    }
    // A lidar that nobody has told the time.
    message.header.stamp = Timestamp(5_000_000_000_000).into();
    assert_eq!(cloud(&message, None).unwrap().times, PointTimes::OtherClock(TimeUnit::Seconds));
}

#[test]
fn packed_colours_are_blue_first_whatever_number_they_pass_for() {
    for (name, datatype) in [("rgb", 7), ("rgba", 6), ("rgb", 5)] {
        let fields = vec![field("x", 0, 7), field("y", 4, 7), field("z", 8, 7), field(name, 12, datatype)];
        let data = Cow::Owned([[0; 12].as_slice(), &[3, 2, 1, 255]].concat());
        let message =
            PointCloud2 { height: 1, width: 1, fields, point_step: 16, row_step: 16, data, ..Default::default() };
        assert_eq!(cloud(&message, None).unwrap().cloud.colors.unwrap(), [[1, 2, 3]]);
    }
}

#[test]
fn sizes_that_lie_are_errors_that_name_the_field() {
    let change = |change: fn(&mut PointCloud2<'_>)| {
        let mut message = organised(false);
        change(&mut message);
        cloud(&message, None).unwrap_err().to_string()
    };
    assert!(change(|m| m.width = u32::MAX).contains("step of rows"));
    assert!(change(|m| (m.width, m.row_step, m.point_step) = (u32::MAX, u32::MAX, u32::MAX)).contains("step of rows"));
    assert!(change(|m| m.height = u32::MAX).contains("bytes are declared by width, height and steps, 142 are there"));
    assert!(change(|m| m.point_step = 0).contains("fields[0].offset of x"));
    assert!(change(|m| m.fields[4].offset = u32::MAX).contains("fields[4].offset of t: 4294967295 found"));
    assert!(change(|m| m.fields[2].datatype = 9).contains("fields[2].datatype of z: 9 found, expected 1 to 8"));
    assert!(change(|m| m.fields[2].name = "Z").contains("send fields x, y and z"));
    assert!(change(|m| m.row_step = 65).contains("step of rows: 65 found"));
}

#[test]
fn an_empty_cloud_is_one() {
    let read = cloud(&PointCloud2::default(), None).unwrap();
    assert!(read.cloud.is_empty() && read.num_dropped == 0);
}

fn any_cloud() -> impl Strategy<Value = PointCloud> {
    let number = -100.0f32..100.0;
    let point = (prop::array::uniform3(number.clone()), number, any::<[u8; 3]>(), -0.05f32..0.1);
    (prop::collection::vec(point, 1..20), any::<[bool; 4]>()).prop_map(|(points, has)| PointCloud {
        positions: points.iter().map(|(p, ..)| Point3::from(*p)).collect(),
        intensities: has[0].then(|| points.iter().map(|p| p.1).collect()),
        colors: has[1].then(|| points.iter().map(|p| p.2).collect()),
        normals: has[2].then(|| points.iter().map(|p| Vector3::from(p.0)).collect()),
        time_offsets_s: has[3].then(|| points.iter().map(|p| p.3).collect()),
    })
}

proptest! {
    #[test]
    fn what_is_published_reads_back(ours in any_cloud(), encoding in 0usize..3) {
        let message = cloud_message(&ours, Header::new(STAMP, "map")).unwrap();
        let encoding = [Encoding::CdrLittleEndian, Encoding::CdrBigEndian, Encoding::Ros1][encoding];
        let bytes = message.encode_as(encoding).unwrap();
        let read = if encoding == Encoding::Ros1 { PointCloud2::decode_ros1(&bytes) } else { PointCloud2::decode(&bytes) };
        let read = cloud(&read.unwrap(), None).unwrap();
        prop_assert_eq!(read.num_dropped, 0);
        prop_assert_eq!(read.cloud, ours);
    }

    #[test]
    fn any_layout_never_panics(
        sizes in prop::array::uniform4(prop_oneof![0u32..40, any::<u32>()]), big_endian in any::<bool>(),
        fields in prop::collection::vec((0usize..16, prop_oneof![0u32..40, any::<u32>()], 0u8..10, any::<u32>()), 0..8),
        data in prop::collection::vec(any::<u8>(), 0..600),
    ) {
        const NAMES: [&str; 16] = ["x", "y", "z", "x", "y", "z", "rgb", "r", "g", "b", "intensity", "t", "timestamp", "normal_x", "normal_y", "normal_z"];
        let mut fields: Vec<_> =
            fields.into_iter().map(|(n, offset, datatype, count)| PointField { name: NAMES[n], offset, datatype, count }).collect();
        fields.extend([field("x", 0, 7), field("y", 0, 1), field("z", 1, 2)]);
        let [height, width, point_step, row_step] = sizes;
        let message = PointCloud2 {
            height, width, fields, is_bigendian: big_endian, point_step, row_step, data: Cow::Owned(data), ..Default::default()
        };
        if let Ok(read) = cloud(&message, None) {
            read.cloud.validate().unwrap();
            prop_assert_eq!((read.cloud.len() + read.num_dropped) as u64, u64::from(width) * u64::from(height));
        }
    }
}

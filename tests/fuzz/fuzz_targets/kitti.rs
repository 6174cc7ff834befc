//! KITTI: velodyne points, calibration.
#![no_main]
use percept_formats::{Limits, kitti};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = kitti::decode_bin(bytes, &Limits::default()) {
        assert!(cloud.positions.len() <= bytes.len() / 16);
    }
    let _ = kitti::parse_calibration(bytes);
});

//! PLY clouds.
#![no_main]
use percept_formats::{Limits, ply};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = ply::decode(bytes, &Limits::default()) {
        assert!(cloud.positions.len() <= bytes.len());
        for encoding in [ply::Encoding::Ascii, ply::Encoding::BinaryLittleEndian, ply::Encoding::BinaryBigEndian] {
            let again = ply::encode(&cloud, encoding).unwrap();
            assert_eq!(ply::decode(&again, &Limits::default()).unwrap().len(), cloud.len());
        }
    }
});

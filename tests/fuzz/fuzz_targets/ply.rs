//! PLY clouds.
#![no_main]
use percept_formats::{Limits, ply};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = ply::decode(bytes, &Limits::default()) {
        assert!(cloud.positions.len() <= bytes.len());
        let _ = ply::encode(&cloud, ply::Encoding::BinaryLittleEndian);
    }
});

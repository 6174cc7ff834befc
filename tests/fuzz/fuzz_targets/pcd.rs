//! PCD clouds.
#![no_main]
use percept_formats::{Limits, pcd};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(read) = pcd::decode(bytes, &Limits { max_points: 100_000, ..Limits::default() }) {
        read.cloud.validate().unwrap();
        for encoding in [pcd::Encoding::Ascii, pcd::Encoding::Binary, pcd::Encoding::BinaryCompressed] {
            let again = pcd::encode_as(&read.cloud, encoding).unwrap();
            assert_eq!(pcd::decode(&again, &Limits::default()).unwrap().cloud.len(), read.cloud.len());
        }
    }
});

//! PCD clouds.
#![no_main]
use percept_formats::{Limits, pcd};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(read) = pcd::decode(bytes, &Limits::default()) {
        let _ = pcd::encode(&read.cloud);
    }
});

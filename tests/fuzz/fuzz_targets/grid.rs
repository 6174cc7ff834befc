//! Occupancy grids of nav2: the YAML, a zero byte, the PGM.
#![no_main]
use percept_formats::{Limits, nav2, pgm};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = pgm::decode(bytes, &Limits::default());
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    if let Ok(yaml) = nav2::parse_yaml(&bytes[..end]) {
        let _ = nav2::decode(&yaml, &bytes[(end + 1).min(bytes.len())..], &Limits::default());
    }
});

//! Pose graphs; what was read is written and read again.
#![no_main]
use percept_formats::{Limits, parse_g2o, write_g2o};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits::default();
    if let Ok(file) = parse_g2o(bytes, &limits) {
        let mut text = Vec::new();
        if write_g2o(&mut text, &file).is_ok() {
            assert!(parse_g2o(&text, &limits).is_ok(), "what was written is not read");
        }
    }
});

//! CARMEN logs and their relations files.
#![no_main]
use percept_formats::{Limits, carmen};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = carmen::parse(bytes, &Limits::default());
    let _ = carmen::parse_relations(bytes);
});

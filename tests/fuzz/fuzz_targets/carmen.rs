//! CARMEN logs and their relations files, and BreezySLAM's logs.
#![no_main]
use percept_formats::{Limits, breezy, carmen};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = carmen::parse(bytes, &Limits::default());
    let _ = carmen::parse_relations(bytes);
    let _ = breezy::is_row(bytes);
    let _ = breezy::parse(bytes, &Limits::default());
});

//! Pose graphs; what was read is written and read again.
#![no_main]
use percept_formats::g2o::Indefinite;
use percept_formats::{Limits, parse_g2o, write_g2o};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits::default();
    for indefinite in [Indefinite::Refuse, Indefinite::Project] {
        let Ok(file) = parse_g2o(bytes, &limits, indefinite) else { continue };
        let mut text = Vec::new();
        if write_g2o(&mut text, &file).is_ok() {
            assert!(parse_g2o(&text, &limits, Indefinite::Project).is_ok(), "what was written is not read");
        }
    }
});

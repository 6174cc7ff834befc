//! Depth images.
#![no_main]
use percept_formats::{Limits, images};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // Small enough that a lying header is refused before memory is taken.
    let limits = Limits { max_pixels: 1 << 20, ..Limits::default() };
    let _ = images::png_size(bytes);
    let _ = images::decode_gray16(bytes, &limits);
    if let Ok(depth) = images::decode_depth_png(bytes, 1e-3, &limits) {
        let again = images::encode_depth_png(&depth, 1e-3).and_then(|b| images::decode_depth_png(&b, 1e-3, &limits));
        assert!(again.is_ok_and(|a| a == depth));
    }
});

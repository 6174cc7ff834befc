//! Colour images: PNG and JPEG.
#![no_main]
use percept_formats::{Limits, images};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // Small enough that a lying header is refused before memory is taken.
    let limits = Limits { max_pixels: 1 << 20, ..Limits::default() };
    let _ = images::decode_color(bytes, &limits);
});

//! Occupancy grids of nav2: the YAML, a zero byte, the PGM or PNG.
#![no_main]
use percept_formats::{Limits, geotiff, nav2, pgm};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_pixels: 1 << 20, ..Limits::default() };
    let _ = pgm::decode(bytes, &limits);
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    if let Ok(yaml) = nav2::parse_yaml(&bytes[..end]) {
        if let Ok(map) = nav2::decode(&yaml, &bytes[(end + 1).min(bytes.len())..], &limits) {
            assert_eq!(map.cells.len(), map.width * map.height);
            assert!(map.cells.iter().all(|c| (-1..=100).contains(c)));
            assert!(geotiff::encode(&map, "map").is_ok() != map.cells.is_empty());
        }
    }
});

//! Whole recordings of ROS messages: MCAP, bags of ROS 1, rosbag2's SQLite files, and what is replayed of them.
#![no_main]
use percept_formats::Limits;
use percept_formats::dataset::{OpenOptions, open_with};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = std::env::temp_dir().join(format!("percept-fuzz-{}.mcap", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let limits = Limits { max_pixels: 100_000, max_points: 100_000, ..Limits::default() };
    if let Ok(recording) = open_with(&path, &OpenOptions { limits, ..OpenOptions::default() }) {
        assert!(recording.stamps().windows(2).all(|w| w[0] < w[1]));
        assert!(recording.frames(None).take(100).count() <= 100);
    }
    let _ = std::fs::remove_file(&path);
});

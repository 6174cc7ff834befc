//! Clouds of any format, found by content and name.
#![no_main]
use percept_formats::{CloudFormat, Limits, load_cloud, save_cloud};

libfuzzer_sys::fuzz_target!(
    init: std::panic::set_hook(Box::new(|_| ())),
    |bytes: &[u8]| {
        let limits = Limits { max_points: 10_000, ..Limits::default() };
        for name in ["", "a.bin", "a.xyz", "a.pcd"] {
            if let Ok(file) = load_cloud(bytes, name, &limits) {
                file.cloud.validate().unwrap();
                let _ = save_cloud(&file.cloud, file.origin_m, CloudFormat::Laz);
            }
        }
    }
);

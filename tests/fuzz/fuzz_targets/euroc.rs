//! A EuRoC recording's descriptions of sensors and its lists of images, inertial samples and poses.
#![no_main]
use percept_formats::{Limits, euroc};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_points: 100_000, ..Limits::default() };
    if let Ok(camera) = euroc::parse_camera(bytes) {
        assert!(camera.intrinsics.validate().is_ok());
    }
    let _ = euroc::parse_extrinsics(bytes);
    if let Ok(rows) = euroc::parse_images(bytes, &limits) {
        assert!(rows.windows(2).all(|w| w[0].stamp < w[1].stamp));
        assert!(rows.iter().all(|row| !row.value.contains('/')));
    }
    if let Ok(rows) = euroc::parse_imu(bytes, &limits) {
        assert!(rows.iter().all(|row| row.value.validate().is_ok()));
    }
    let _ = euroc::parse_poses(bytes, &limits);
});

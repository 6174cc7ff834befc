//! Open3D's description of a camera.
#![no_main]
use percept_formats::open3d;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(camera) = open3d::parse_intrinsics(bytes) {
        assert!(camera.intrinsics.validate().is_ok());
        assert!(camera.depth_scale.is_none_or(|scale| scale > 0.0) && camera.rate_hz.is_none_or(|rate| rate > 0.0));
    }
});

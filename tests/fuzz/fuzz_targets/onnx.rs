//! Models of detectors; what is taken finds things in an image. Panics of the library that runs models are caught, so they
//! may fire here, too.
#![no_main]
use percept_geometry::RgbImage;
use percept_inference::{Detector, DetectorSpec, InferenceThreads, ModelLimits, OutputLayout};
use std::sync::LazyLock;

static THREADS: LazyLock<InferenceThreads> = LazyLock::new(|| InferenceThreads::new(1));

libfuzzer_sys::fuzz_target!(
    init: std::panic::set_hook(Box::new(|_| ())),
    |bytes: &[u8]| {
        // As much as is done in a moment.
        let limits = ModelLimits { max_input_px: 64, max_multiply_adds: 10_000_000, ..ModelLimits::default() };
        for layout in [OutputLayout::FastestDet, OutputLayout::YoloV8] {
            let spec = DetectorSpec { score_threshold: 0.0, ..DetectorSpec::new("fuzzed", &["a", "b"], layout) };
            let Ok(detector) = Detector::new(bytes, spec, &limits, &THREADS) else { continue };
            let image = RgbImage::new(5, 3, (0..45).map(|i| i * 5).collect()).unwrap();
            let found = detector.detect(&image).unwrap_or_default();
            assert!(found.iter().all(|d| d.bbox.is_proper() && (0.0..=1.0).contains(&d.score)));
        }
    }
);

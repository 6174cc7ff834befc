//! What is found, by closed forms.

use crate::models::{build, floats, graph, node, spec, squares, tiny, tiny_with_size, write};
use percept_geometry::RgbImage;
use percept_inference::{Detector, DetectorSpec, Fit, InferenceError, InferenceThreads, InputSpec, ModelLimits};
use percept_perception::detection::ImageBox;

/// Black, with a square of 4 x 4 of a colour.
fn image(width: usize, height: usize, (u0, v0): (usize, usize), color: [u8; 3]) -> RgbImage {
    let within = |u: usize, v: usize| (u0..u0 + 4).contains(&u) && (v0..v0 + 4).contains(&v);
    let pixel = |i: usize| if within(i % width, i / width) { color } else { [0; 3] };
    RgbImage::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
}

#[test]
fn a_square_is_found_where_it_is_and_as_what_it_is() {
    let detector = build(&write(tiny())).unwrap();
    assert_eq!(detector.input_px(), [8, 8]);
    // 4 cells of 7 sums of 48 products.
    assert_eq!(detector.multiply_adds(), 4 * 7 * 48);
    let found = detector.detect(&image(8, 8, (4, 0), [255, 0, 0])).unwrap();
    assert_eq!(found.len(), 1);
    assert_eq!((&*found[0].label, found[0].label_index), ("red", 0));
    assert!((found[0].score - 0.5f64.powf(0.4)).abs() < 1e-6);
    // Centre at (4, 0) of 8, half of the image in size, cut off at its top.
    assert_eq!(found[0].bbox, ImageBox { left_px: 2.0, top_px: 0.0, right_px: 6.0, bottom_px: 2.0 });
    let found = detector.detect(&image(8, 8, (0, 4), [204, 255, 0])).unwrap();
    assert_eq!((&*found[0].label, found[0].label_index), ("yellow", 1));
    assert!((found[0].score - 0.8f64.powf(0.6)).abs() < 1e-6);
}

#[test]
fn thresholds_are_kept() {
    let with = |score_threshold: f64, iou_threshold: f64| {
        let spec = DetectorSpec { score_threshold, iou_threshold, ..spec() };
        let limits = ModelLimits::default();
        let detector =
            Detector::new(&write(tiny_with_size(3f32.ln())), spec, &limits, &InferenceThreads::new(1)).unwrap();
        detector.detect(&RgbImage::new(8, 8, [255, 0, 0].repeat(64)).unwrap()).unwrap().len()
    };
    // Four boxes of 6 x 6, 4 apart: beside each other 12 of 60 in common, across 4 of 68.
    assert_eq!(with(0.75, 0.21), 4);
    assert_eq!(with(0.75, 0.19), 2);
    assert_eq!(with(0.75, 0.05), 1);
    assert_eq!(with(0.76, 0.21), 0);
}

#[test]
fn boxes_are_in_pixels_of_the_image_whatever_its_shape() {
    let fitted = |fit: Fit, width: usize, height: usize| {
        let spec =
            DetectorSpec { input: Some(InputSpec { fit, ..InputSpec::default() }), score_threshold: 0.7, ..spec() };
        let limits = ModelLimits::default();
        let detector = Detector::new(&write(tiny()), spec, &limits, &InferenceThreads::new(1)).unwrap();
        let pixel = |i: usize| if i % width >= width / 2 { [255, 0, 0] } else { [0; 3] };
        let image = RgbImage::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap();
        detector.detect(&image).unwrap()
    };
    let found = fitted(Fit::Stretch, 32, 8);
    assert_eq!(found.len(), 2);
    assert_eq!(found[0].bbox, ImageBox { left_px: 8.0, top_px: 0.0, right_px: 24.0, bottom_px: 2.0 });
    // The image has rows 2 to 6 of 8: each cell is half grey, so that it is three quarters as red.
    let found = fitted(Fit::Letterbox, 16, 8);
    let red = (0.5 + 0.5 * 114.0 / 255.0f64).powf(0.6) * 0.5f64.powf(0.4);
    assert!(red < 0.7 && found.is_empty(), "{found:?}");
}

#[test]
fn one_pixel_is_an_image_and_none_is_not() {
    let detector = build(&write(tiny())).unwrap();
    let found = detector.detect(&RgbImage::new(1, 1, vec![255, 0, 0]).unwrap()).unwrap();
    assert!(found.iter().all(|d| d.bbox.right_px <= 1.0 && d.bbox.bottom_px <= 1.0));
    for (width, height) in [(0, 0), (0, 5), (5, 0)] {
        let error = detector.detect(&RgbImage::new(width, height, vec![]).unwrap()).unwrap_err();
        assert_eq!(error, InferenceError::EmptyImage { width, height });
    }
}

#[test]
fn a_model_that_gives_no_numbers_finds_nothing() {
    for bad in [f32::NAN, f32::INFINITY] {
        let weights = vec![floats("weights", &[7, 3, 4, 4], vec![bad; 7 * 48])];
        let conv = node("Conv", &["image", "weights"], "out", squares(4, 4, 0));
        let detector = build(&write(graph(vec![conv], weights))).unwrap();
        assert_eq!(detector.detect(&image(8, 8, (0, 0), [255; 3])).unwrap(), []);
    }
}

#[test]
fn a_detector_can_be_shared_between_threads() {
    fn shared<T: Send + Sync + 'static>() {}
    shared::<Detector>();
}

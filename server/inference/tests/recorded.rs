//! FastestDet on recorded images against ONNX Runtime; skipped where model or images are absent.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use percept_formats::{Limits, images};
use percept_geometry::RgbImage;
use percept_inference::{Detector, DetectorSpec, InferenceError, InferenceThreads, ModelLimits, OutputLayout};
use percept_perception::detection::Detection2d;
use std::collections::BTreeMap;
use std::path::Path;

/// Written by `onnxruntime_boxes.py` beside it.
const TRUTH: &str = include_str!("boxes.json");

percept_recorded::tests! {
    boxes_of_lossless_images_are_those_of_onnx_runtime: "model-fastestdet", "objects-kitti";
    boxes_of_jpegs_are_those_of_onnx_runtime: "model-fastestdet", "rgbd-7scenes-a";
    detections_do_not_depend_on_the_number_of_threads: "model-fastestdet", "rgbd-7scenes-a";
    a_cut_model_is_refused_wherever_it_is_cut: "model-fastestdet";
    a_damaged_model_is_refused_or_runs: "model-fastestdet";
    a_model_that_does_too_much_is_refused_with_figures: "model-fastestdet";
    labels_of_another_number_are_refused: "model-fastestdet";
}

#[derive(serde::Deserialize)]
struct Truth {
    score_threshold: f64,
    iou_threshold: f64,
    images: BTreeMap<String, Vec<Expected>>,
}

#[derive(serde::Deserialize)]
struct Expected {
    label: String,
    score: f64,
    box_px: [f64; 4],
}

fn truth() -> Truth {
    serde_json::from_str(TRUTH).unwrap()
}

fn model(data: &Path) -> Vec<u8> {
    std::fs::read(data.join("model-fastestdet/FastestDet.onnx")).unwrap()
}

fn spec(data: &Path) -> DetectorSpec {
    let labels = std::fs::read_to_string(data.join("model-fastestdet/coco.names")).unwrap();
    let labels: Vec<&str> = labels.lines().collect();
    let Truth { score_threshold, iou_threshold, .. } = truth();
    DetectorSpec { score_threshold, iou_threshold, ..DetectorSpec::new("fastest", &labels, OutputLayout::FastestDet) }
}

fn build(model: &[u8], spec: DetectorSpec) -> Result<Detector, InferenceError> {
    Detector::new(model, spec, &ModelLimits::default(), &InferenceThreads::new(1))
}

fn image(data: &Path, name: &str) -> RgbImage {
    images::decode_color(&std::fs::read(data.join(name)).unwrap(), &Limits::default()).unwrap()
}

/// Largest differences of edges (pixels) and of scores. What is within `max_score` of the threshold may be there or not.
fn difference(expected: &[Expected], found: &[Detection2d], max_score: f64) -> (f64, f64) {
    let sure = truth().score_threshold + max_score;
    let mut left: Vec<&Detection2d> = found.iter().collect();
    let (mut worst_px, mut worst_score) = (0.0f64, 0.0f64);
    for e in expected {
        let edges = |d: &Detection2d| [d.bbox.left_px, d.bbox.top_px, d.bbox.right_px, d.bbox.bottom_px];
        let off = |d: &Detection2d| edges(d).iter().zip(&e.box_px).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let same = left.iter().enumerate().filter(|(_, d)| *d.label == *e.label);
        let Some((i, d)) = same.min_by(|a, b| off(a.1).total_cmp(&off(b.1))) else {
            assert!(e.score < sure, "{} {:?} is not found", e.label, e.box_px);
            continue;
        };
        (worst_px, worst_score) = (worst_px.max(off(d)), worst_score.max((d.score - e.score).abs()));
        left.remove(i);
    }
    assert!(left.iter().all(|d| d.score < sure), "not among those of ONNX Runtime: {left:?}");
    (worst_px, worst_score)
}

fn compare(data: &Path, folder: &str, (max_px, max_score): (f64, f64)) {
    let detector = build(&model(data), spec(data)).unwrap();
    for (name, expected) in truth().images.iter().filter(|(name, _)| name.starts_with(folder)) {
        let found = detector.detect(&image(data, name)).unwrap();
        let (px, score) = difference(expected, &found, max_score);
        println!("{name}: {} boxes, edges within {px:.3} px, scores within {score:.6}", found.len());
        assert!(px <= max_px && score <= max_score, "{name}: {px} px, {score}");
    }
}

fn boxes_of_lossless_images_are_those_of_onnx_runtime(data: &Path) {
    compare(data, "objects-kitti", (1.0, 1e-3));
}

fn boxes_of_jpegs_are_those_of_onnx_runtime(data: &Path) {
    // Decoders of JPEG differ by shades, which moves the edges of a table of 600 pixels by 5.
    compare(data, "rgbd-7scenes-a", (8.0, 0.02));
}

fn detections_do_not_depend_on_the_number_of_threads(data: &Path) {
    let image = image(data, "rgbd-7scenes-a/frame-000000.color.jpg");
    let detector = build(&model(data), spec(data)).unwrap();
    let several = Detector::new(&model(data), spec(data), &ModelLimits::default(), &InferenceThreads::new(3)).unwrap();
    let found = detector.detect(&image).unwrap();
    let all: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..6).map(|_| scope.spawn(|| several.detect(&image).unwrap())).collect();
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    assert!(all.iter().all(|one| *one == found));
}

fn a_cut_model_is_refused_wherever_it_is_cut(data: &Path) {
    let whole = model(data);
    for i in 0..50 {
        let cut = &whole[..whole.len() * i / 50];
        let error = build(cut, spec(data)).map(|_| ()).unwrap_err();
        assert!(matches!(error, InferenceError::NotOnnx { .. }), "{}: {error}", cut.len());
    }
    let error = build(&whole[..whole.len() - 1], spec(data)).map(|_| ()).unwrap_err();
    assert!(matches!(error, InferenceError::NotOnnx { .. }), "{error}");
}

/// Bits changed one at a time, in the file's structure and in its weights.
fn a_damaged_model_is_refused_or_runs(data: &Path) {
    let whole = model(data);
    let image = image(data, "rgbd-7scenes-a/frame-000000.color.jpg");
    let (mut refused, mut ran) = (0, 0);
    for i in 0..60 {
        let mut bytes = whole.clone();
        // The operators are the first 21 thousand bytes or so, the weights the rest.
        let at = if i % 4 == 0 { i * 7919 * 631 % bytes.len() } else { i * 7919 % 21_700 };
        bytes[at] ^= 1 << (i % 8);
        match build(&bytes, spec(data)) {
            Ok(detector) => {
                detector.detect(&image).unwrap();
                ran += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        }
    }
    println!("{refused} refused, {ran} ran");
}

fn a_model_that_does_too_much_is_refused_with_figures(data: &Path) {
    let try_with =
        |limits: ModelLimits| Detector::new(&model(data), spec(data), &limits, &InferenceThreads::new(1)).map(|_| ());
    let whole = model(data).len();
    let needed = build(&model(data), spec(data)).unwrap().multiply_adds();
    println!("{needed} multiplications and additions");
    for (what, limits) in [
        ("bytes", ModelLimits { max_bytes: whole - 1, ..ModelLimits::default() }),
        ("pixels along an edge of the input", ModelLimits { max_input_px: 351, ..ModelLimits::default() }),
        ("multiplications", ModelLimits { max_multiply_adds: needed - 1, ..ModelLimits::default() }),
    ] {
        let error = try_with(limits).unwrap_err();
        assert!(matches!(error, InferenceError::TooLarge { what: w, .. } if w == what), "{error}");
    }
    let just = ModelLimits { max_bytes: whole, max_input_px: 352, max_multiply_adds: needed };
    assert_eq!(try_with(just), Ok(()));
}

fn labels_of_another_number_are_refused(data: &Path) {
    let mut spec = spec(data);
    spec.labels.pop();
    let error = build(&model(data), spec).map(|_| ()).unwrap_err();
    assert_eq!(error, InferenceError::LabelsMismatch { num_labels: 79, num_classes: 80 });
}

//! A model's output in, boxes in pixels of its input out. See [`OutputLayout`] for layouts and sources.

use crate::network::Tensor;
use crate::{InferenceError, OutputLayout};
use percept_perception::detection::ImageBox;

/// A box before others are compared with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) bbox: ImageBox,
    pub(crate) label: usize,
    pub(crate) score: f64,
}

/// Checks that outputs are of a layout's shape for so many labels.
pub(crate) fn check(layout: OutputLayout, outputs: &[Tensor], num_labels: usize) -> Result<(), InferenceError> {
    let shapes: Vec<&[usize]> = outputs.iter().map(|o| o.shape.as_slice()).collect();
    let mismatch = |expected| {
        let told = |shape: &&[usize]| match shape {
            [] => "of one number".to_owned(),
            _ => shape.iter().take(8).map(usize::to_string).collect::<Vec<_>>().join(" x "),
        };
        let actual = shapes.iter().map(told).collect::<Vec<_>>().join(", ");
        Err(InferenceError::OutputMismatch { expected, actual })
    };
    let num_classes = match (layout, &shapes[..]) {
        (OutputLayout::FastestDet, &[&[1, channels, _, _]]) if channels > 5 => channels - 5,
        (OutputLayout::FastestDet, _) => return mismatch("one of 1 x (5 + classes) x H x W"),
        (OutputLayout::YoloV8, &[&[1, channels, _]]) if channels > 4 => channels - 4,
        (OutputLayout::YoloV8, _) => return mismatch("one of 1 x (4 + classes) x N"),
        (OutputLayout::BoxesScores, &[&[1, n, 4], &[1, m, classes]]) if n == m && classes > 0 => classes,
        (OutputLayout::BoxesScores, _) => return mismatch("two, of 1 x N x 4 and of 1 x N x classes"),
    };
    if num_classes == num_labels { Ok(()) } else { Err(InferenceError::LabelsMismatch { num_labels, num_classes }) }
}

/// Boxes whose score is at least `threshold`, in the order of the output; none that is not finite. `outputs` have passed
/// [`check`].
pub(crate) fn decode(layout: OutputLayout, outputs: &[Tensor], threshold: f64, input_px: [usize; 2]) -> Vec<Candidate> {
    match (layout, outputs) {
        (OutputLayout::FastestDet, [output]) => fastest_det(output, threshold, input_px),
        (OutputLayout::YoloV8, [output]) => yolo_v8(output, threshold),
        (OutputLayout::BoxesScores, [boxes, scores]) => boxes_scores(boxes, scores, threshold),
        _ => vec![],
    }
}

/// A candidate with a score from `threshold` on, none if something is not finite.
fn candidate(numbers: [f64; 4], bbox: ImageBox, (label, score): (usize, f64), threshold: f64) -> Option<Candidate> {
    let is_fine = numbers.iter().all(|n| n.is_finite()) && bbox.is_proper() && score.is_finite() && score >= threshold;
    // Half floats may come to a little more than 1.
    is_fine.then_some(Candidate { bbox, label, score: score.min(1.0) })
}

/// The class of the greatest share, the first of equals; NaN is never it.
fn best(shares: impl Iterator<Item = f32>) -> (usize, f64) {
    let first = (0, f64::NEG_INFINITY);
    shares.enumerate().fold(first, |best, (i, share)| if f64::from(share) > best.1 { (i, share.into()) } else { best })
}

fn fastest_det(output: &Tensor, threshold: f64, input_px: [usize; 2]) -> Vec<Candidate> {
    let [_, channels, rows, columns] = output.shape[..] else { return vec![] };
    let cells = rows * columns;
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let cell = |cell: usize| {
        let at = |channel: usize| output.data[channel * cells + cell];
        let (label, share) = best((5..channels).map(at));
        let score = f64::from(at(0)).powf(0.6) * share.powf(0.4);
        let numbers = [1, 2, 3, 4].map(|channel| f64::from(at(channel)));
        let [dx, dy, w, h] = numbers;
        let place = |offset: f64, index: usize, count: usize| (offset.tanh() + index as f64) / count as f64;
        let center = [place(dx, cell % columns, columns), place(dy, cell / columns, rows)];
        let [width, height] = input_px.map(|px| px as f64);
        let bbox = ImageBox::around([center[0] * width, center[1] * height], [sigmoid(w) * width, sigmoid(h) * height]);
        candidate(numbers, bbox, (label, score), threshold)
    };
    (0..cells).filter_map(cell).collect()
}

fn yolo_v8(output: &Tensor, threshold: f64) -> Vec<Candidate> {
    let [_, channels, count] = output.shape[..] else { return vec![] };
    let one = |i: usize| {
        let at = |channel: usize| output.data[channel * count + i];
        let numbers = [0, 1, 2, 3].map(|channel| f64::from(at(channel)));
        let [x, y, w, h] = numbers;
        candidate(numbers, ImageBox::around([x, y], [w, h]), best((4..channels).map(at)), threshold)
    };
    (0..count).filter_map(one).collect()
}

fn boxes_scores(boxes: &Tensor, scores: &Tensor, threshold: f64) -> Vec<Candidate> {
    let classes = scores.shape.last().copied().unwrap_or(1).max(1);
    let one = |(edges, shares): (&[f32], &[f32])| {
        let numbers = [0, 1, 2, 3].map(|i| f64::from(edges[i]));
        let [left_px, top_px, right_px, bottom_px] = numbers;
        let bbox = ImageBox { left_px, top_px, right_px, bottom_px };
        candidate(numbers, bbox, best(shares.iter().copied()), threshold)
    };
    boxes.data.chunks_exact(4).zip(scores.data.chunks_exact(classes)).filter_map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tensor(shape: &[usize], data: &[f32]) -> Tensor {
        assert_eq!(shape.iter().product::<usize>(), data.len());
        Tensor { shape: shape.to_vec(), data: data.to_vec() }
    }

    #[test]
    fn a_cell_of_fastest_det_is_a_box_by_its_formulas() {
        // A grid of 1 x 2; the second cell holds something of class 1.
        let data = [0.0, 0.9, 0.0, 0.5, 0.0, -0.25, 0.0, 0.3, 0.0, -1.0, 1.0, 0.2, 0.0, 0.8];
        let output = [tensor(&[1, 7, 1, 2], &data)];
        check(OutputLayout::FastestDet, &output, 2).unwrap();
        let found = decode(OutputLayout::FastestDet, &output, 0.5, [200, 100]);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].label, 1);
        assert!((found[0].score - 0.9f64.powf(0.6) * 0.8f64.powf(0.4)).abs() < 1e-7);
        let (x, y) = ((0.5f64.tanh() + 1.0) / 2.0 * 200.0, (-0.25f64).tanh() * 100.0);
        let (w, h) = (200.0 / (1.0 + (-0.3f64).exp()), 100.0 / (1.0 + 1f64.exp()));
        let expected = ImageBox::around([x, y], [w, h]);
        assert!((found[0].bbox.left_px - expected.left_px).abs() < 1e-4);
        assert!((found[0].bbox.bottom_px - expected.bottom_px).abs() < 1e-4);
    }

    #[test]
    fn yolo_and_plain_boxes_are_read_where_they_lie() {
        let yolo = [tensor(&[1, 6, 2], &[10.0, 50.0, 20.0, 60.0, 4.0, 8.0, 6.0, 2.0, 0.1, 0.2, 0.3, 0.7])];
        check(OutputLayout::YoloV8, &yolo, 2).unwrap();
        let found = decode(OutputLayout::YoloV8, &yolo, 0.5, [64, 64]);
        let bbox = ImageBox { left_px: 46.0, top_px: 59.0, right_px: 54.0, bottom_px: 61.0 };
        assert_eq!(found, [Candidate { bbox, label: 1, score: f64::from(0.7f32) }]);
        let boxes = tensor(&[1, 2, 4], &[1.0, 2.0, 3.0, 4.0, 46.0, 59.0, 54.0, 61.0]);
        let plain = [boxes, tensor(&[1, 2, 2], &[0.1, 0.2, 0.3, 0.7])];
        check(OutputLayout::BoxesScores, &plain, 2).unwrap();
        assert_eq!(decode(OutputLayout::BoxesScores, &plain, 0.5, [64, 64]), found);
    }

    #[test]
    fn what_is_not_finite_is_not_there() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for layout in [OutputLayout::FastestDet, OutputLayout::YoloV8] {
                let shape: &[usize] = if layout == OutputLayout::YoloV8 { &[1, 6, 9] } else { &[1, 6, 3, 3] };
                let output = [tensor(shape, &[bad; 54])];
                assert_eq!(decode(layout, &output, 0.0, [64, 64]), [], "{layout:?} {bad}");
            }
        }
    }

    #[test]
    fn outputs_of_another_shape_are_refused_with_both_shapes() {
        let zero = [tensor(&[], &[1.0])];
        let flat = [tensor(&[1, 6, 4], &[0.0; 24])];
        for (layout, outputs) in [
            (OutputLayout::FastestDet, &zero[..]),
            (OutputLayout::FastestDet, &flat),
            (OutputLayout::YoloV8, &zero),
            (OutputLayout::BoxesScores, &flat),
            (OutputLayout::YoloV8, &[]),
        ] {
            let error = check(layout, outputs, 2).unwrap_err();
            assert!(matches!(error, InferenceError::OutputMismatch { .. }), "{error}");
        }
        let error = check(OutputLayout::YoloV8, &flat, 80).unwrap_err();
        assert_eq!(error, InferenceError::LabelsMismatch { num_labels: 80, num_classes: 2 });
    }
}

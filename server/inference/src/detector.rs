//! An image in, labelled boxes out.

use crate::decode::{Candidate, check, decode};
use crate::network::Network;
use crate::prepare::{Placement, prepare};
use crate::{DetectorSpec, InferenceError, InferenceThreads, ModelLimits};
use percept_geometry::RgbImage;
use percept_perception::detection::{Detection2d, ImageDetector};
use std::sync::Arc;

/// The most boxes that are compared with each other, the best ones first, and that are reported: what YOLOv8 reports at
/// most, and ten times that.
const MAX_CANDIDATES: usize = 3000;
const MAX_DETECTIONS: usize = 300;

/// A learned detector of things in images, of an ONNX model and what has to be known of it.
///
/// Immutable: share it between sessions in an `Arc`. The same image gives the same detections, whatever the number of
/// threads.
#[derive(Debug)]
pub struct Detector {
    spec: DetectorSpec,
    labels: Vec<Arc<str>>,
    network: Network,
}

impl Detector {
    /// Loads a model and tries it on a black image, within a second or two for the largest that are taken. `model` is an
    /// ONNX file: one input of 1 x 3 x H x W float32 of fixed size, operators of the standard domain, weights inside.
    ///
    /// Nothing in the file is believed before it is checked: memory is taken within what `limits` and the constants of this
    /// crate allow, and what a run takes is counted beforehand.
    ///
    /// # Errors
    /// `OutOfRange` or `BadText` naming the specification's field; `TooLarge`, `NotOnnx`, `Unsupported`, `InputMismatch`
    /// for the file; `OutputMismatch` or `LabelsMismatch` if the output is not what the specification says; `Failed` with
    /// the library's words if it cannot load or run the model.
    pub fn new(
        model: &[u8],
        spec: DetectorSpec,
        limits: &ModelLimits,
        threads: &InferenceThreads,
    ) -> Result<Self, InferenceError> {
        spec.validate()?;
        let (network, outputs) = Network::load(model, limits, threads)?;
        check(spec.layout, &outputs, spec.labels.len())?;
        let labels = spec.labels.iter().map(|label| label.as_str().into()).collect();
        Ok(Self { spec, labels, network })
    }

    /// The specification.
    pub fn spec(&self) -> &DetectorSpec {
        &self.spec
    }

    /// Columns and rows of the model's input, pixels.
    pub fn input_px(&self) -> [usize; 2] {
        self.network.input_px
    }

    /// Sides of the model's input: 1, 3, rows, columns.
    pub fn input_shape(&self) -> Vec<usize> {
        let [width, height] = self.network.input_px;
        vec![1, 3, height, width]
    }

    /// Bytes of the model's file.
    pub fn num_bytes(&self) -> usize {
        self.network.num_bytes
    }

    /// Multiplications and additions that an image takes, about.
    pub fn multiply_adds(&self) -> u64 {
        self.network.work.multiply_adds
    }

    /// Bytes of memory that it takes while it works on an image, at most, about.
    pub fn memory_bytes(&self) -> u64 {
        self.network.memory_bytes()
    }

    /// The things in an image, in pixels of that image and cut off at its edges, best score first. Of boxes of one label that
    /// overlap the best one stays (non-maximum suppression). At most 300; none where the model's output is not finite.
    ///
    /// # Errors
    /// `EmptyImage`; `Failed` with the library's words.
    pub fn detect(&self, image: &RgbImage) -> Result<Vec<Detection2d>, InferenceError> {
        let (width, height) = (image.width(), image.height());
        if width == 0 || height == 0 {
            return Err(InferenceError::EmptyImage { width, height });
        }
        let (spec, input_px) = (&self.spec, self.network.input_px);
        let input = spec.input();
        let placement = Placement::of(image, input_px, input.fit);
        let outputs = self.network.run(&prepare(image, input_px, &placement, &input))?;
        check(spec.layout, &outputs, spec.labels.len())?;
        let candidates = decode(spec.layout, &outputs, spec.score_threshold, input_px);
        let detection = |c: &Candidate| Detection2d {
            label: self.labels[c.label].clone(),
            label_index: c.label,
            score: c.score,
            bbox: placement.to_image(&c.bbox).clipped(width, height),
        };
        let mut found: Vec<Detection2d> = suppress(candidates, spec.iou_threshold).iter().map(detection).collect();
        found.retain(|d| d.bbox.is_proper());
        Ok(found)
    }
}

impl ImageDetector for Detector {
    fn detect(&self, image: &RgbImage) -> Result<Vec<Detection2d>, String> {
        Self::detect(self, image).map_err(|e| e.to_string())
    }

    fn labels(&self) -> &[String] {
        &self.spec.labels
    }
}

/// The best boxes, best first, without those that overlap a better one of the same label by more than `iou_threshold`.
fn suppress(mut candidates: Vec<Candidate>, iou_threshold: f64) -> Vec<Candidate> {
    // Stable, so that equals stay in the order of the output.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    candidates.truncate(MAX_CANDIDATES);
    let mut kept: Vec<Candidate> = vec![];
    for c in candidates {
        if kept.len() == MAX_DETECTIONS {
            break;
        }
        if !kept.iter().any(|k| k.label == c.label && k.bbox.iou(&c.bbox) > iou_threshold) {
            kept.push(c);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_perception::detection::ImageBox;

    #[test]
    fn of_boxes_that_overlap_the_best_of_each_label_stays() {
        let candidate =
            |x: f64, label, score| Candidate { bbox: ImageBox::around([x, 10.0], [10.0, 10.0]), label, score };
        let all =
            vec![candidate(10.0, 0, 0.6), candidate(11.0, 0, 0.9), candidate(12.0, 1, 0.7), candidate(30.0, 0, 0.6)];
        let kept = suppress(all.clone(), 0.45);
        assert_eq!(kept, [all[1], all[2], all[3]]);
        assert_eq!(suppress(all.clone(), 1.0), [all[1], all[2], all[0], all[3]]);
        assert_eq!(suppress(vec![all[0]; 5000], 1.0).len(), MAX_DETECTIONS);
    }
}

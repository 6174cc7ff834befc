//! What has to be known of a model beside its file.

use crate::InferenceError;
use crate::error::shortened;
use serde::{Deserialize, Serialize};

/// The most labels.
pub const MAX_LABELS: usize = 1000;
/// The longest label, bytes: as those of objects.
pub const MAX_LABEL_BYTES: usize = 31;
/// The longest name, bytes.
pub const MAX_NAME_BYTES: usize = 63;

/// A detector: how images are laid before the model, and what its output means.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorSpec {
    /// What the detector is called, 1 to 63 bytes.
    pub name: String,
    /// Names of the model's classes in its order; 1 to 1000, each of 1 to 31 bytes.
    pub labels: Vec<String>,
    /// What has a lower score is not reported, 0 to 1.
    #[serde(default = "default_score_threshold")]
    pub score_threshold: f64,
    /// Of boxes of one label that overlap by more than this (intersection over union) the best one stays, 0 to 1.
    #[serde(default = "default_iou_threshold")]
    pub iou_threshold: f64,
    /// How the output is laid out.
    pub layout: OutputLayout,
    /// How an image becomes the input; none as models of the layout usually have it ([`OutputLayout::usual_input`]).
    #[serde(default)]
    pub input: Option<InputSpec>,
}

/// Between the 0.25 from which FastestDet and YOLOv8 tell boxes and the 0.65 from which FastestDet's own demo draws them.
fn default_score_threshold() -> f64 {
    0.5
}

/// FastestDet's own (`handle_preds`).
fn default_iou_threshold() -> f64 {
    0.45
}

impl DetectorSpec {
    /// One with the usual thresholds and the input as models of this layout usually have it.
    pub fn new(name: &str, labels: &[&str], layout: OutputLayout) -> Self {
        Self {
            name: name.to_owned(),
            labels: labels.iter().map(|&l| l.to_owned()).collect(),
            score_threshold: default_score_threshold(),
            iou_threshold: default_iou_threshold(),
            layout,
            input: None,
        }
    }

    /// How an image becomes the input.
    pub fn input(&self) -> InputSpec {
        self.input.unwrap_or_else(|| self.layout.usual_input())
    }

    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` or `BadText` naming the field.
    pub fn validate(&self) -> Result<(), InferenceError> {
        text("name".to_owned(), &self.name, MAX_NAME_BYTES)?;
        if !(1..=MAX_LABELS).contains(&self.labels.len()) {
            return Err(InferenceError::OutOfRange {
                field: "labels",
                value: self.labels.len() as f64,
                requirement: "a number of labels from 1 to 1000",
            });
        }
        for (i, label) in self.labels.iter().enumerate() {
            text(format!("labels[{i}]"), label, MAX_LABEL_BYTES)?;
        }
        for (field, value) in [("score_threshold", self.score_threshold), ("iou_threshold", self.iou_threshold)] {
            if !(0.0..=1.0).contains(&value) {
                return Err(InferenceError::OutOfRange { field, value, requirement: "from 0 to 1" });
            }
        }
        self.input().validate()
    }
}

fn text(field: String, value: &str, limit: usize) -> Result<(), InferenceError> {
    if (1..=limit).contains(&value.len()) && !value.chars().any(char::is_control) && !value.trim().is_empty() {
        return Ok(());
    }
    Err(InferenceError::BadText { field, value: shortened(value, MAX_NAME_BYTES), limit })
}

/// How a model's output is laid out; C is the number of labels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputLayout {
    /// One output of 1 x (5 + C) x H x W: for each cell of a grid that something is there, x and y of its centre in the
    /// cell, width and height, and the classes' shares.
    ///
    /// Source: dog-qiuqiu, FastestDet, commit 50473cd, `utils/tool.py` (`handle_preds`): the score is `obj^0.6 * share^0.4`, the
    /// centre `(tanh(x) + column) / W`, `(tanh(y) + row) / H`, the size `sigmoid(w)`, `sigmoid(h)`, all as parts of the
    /// input.
    FastestDet,
    /// One output of 1 x (4 + C) x N: x and y of the centre, width and height in pixels of the input, and the classes' scores.
    ///
    /// Source: Jocher, Chaurasia and Qiu, Ultralytics YOLOv8, 2023, as exported to ONNX; later versions export the same.
    YoloV8,
    /// Two outputs, first boxes of 1 x N x 4 (left, top, right, bottom in pixels of the input), then scores of 1 x N x C:
    /// what is common to models that end with both decoded.
    BoxesScores,
}

impl OutputLayout {
    /// The input as the models of this layout were trained with.
    pub fn usual_input(self) -> InputSpec {
        match self {
            Self::FastestDet => InputSpec { channel_order: ChannelOrder::Bgr, ..InputSpec::default() },
            Self::YoloV8 => InputSpec { fit: Fit::Letterbox, ..InputSpec::default() },
            Self::BoxesScores => InputSpec::default(),
        }
    }
}

/// The order of the input's channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChannelOrder {
    /// Red first.
    #[default]
    Rgb,
    /// Blue first, as OpenCV reads images.
    Bgr,
}

/// How an image of another shape is brought to the input's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// Columns and rows each by a scale of their own.
    #[default]
    Stretch,
    /// By one scale, in the middle of a grey ground (114 of 255).
    Letterbox,
}

/// How an image becomes the model's input: pixels times `scale`, less `mean`, over `std`. Its size is the model's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InputSpec {
    /// Order of the channels, also of `mean` and `std`.
    pub channel_order: ChannelOrder,
    /// How the image is brought to the input's shape.
    pub fit: Fit,
    /// What pixels (0 to 255) are multiplied by, above 0 to 1000.
    pub scale: f64,
    /// What is taken off then, by channel of the input, -1000 to 1000.
    pub mean: [f64; 3],
    /// What it is divided by then, by channel of the input, 0.000001 to 1000.
    pub std: [f64; 3],
}

impl Default for InputSpec {
    fn default() -> Self {
        Self {
            channel_order: ChannelOrder::default(),
            fit: Fit::default(),
            scale: 1.0 / 255.0,
            mean: [0.0; 3],
            std: [1.0; 3],
        }
    }
}

impl InputSpec {
    fn validate(&self) -> Result<(), InferenceError> {
        let check = |field, value, is_fine: bool, requirement| {
            if is_fine { Ok(()) } else { Err(InferenceError::OutOfRange { field, value, requirement }) }
        };
        check("input.scale", self.scale, self.scale > 0.0 && self.scale <= 1000.0, "above 0, at most 1000")?;
        for i in 0..3 {
            let (mean, std) = (self.mean[i], self.std[i]);
            check("input.mean", mean, (-1000.0..=1000.0).contains(&mean), "from -1000 to 1000")?;
            check("input.std", std, (1e-6..=1000.0).contains(&std), "from 0.000001 to 1000")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> DetectorSpec {
        DetectorSpec::new("fastest", &["person", "chair"], OutputLayout::FastestDet)
    }

    #[test]
    fn both_sides_of_each_limit() {
        assert_eq!(spec().validate(), Ok(()));
        let with_labels = |labels: Vec<String>| DetectorSpec { labels, ..spec() }.validate();
        assert_eq!(with_labels(vec!["x".repeat(31); 1000]), Ok(()));
        assert!(matches!(with_labels(vec![]), Err(InferenceError::OutOfRange { field: "labels", .. })));
        assert!(matches!(with_labels(vec!["x".into(); 1001]), Err(InferenceError::OutOfRange { field: "labels", .. })));
        for bad in ["", " ", "a\nb", &"x".repeat(32), &"ä".repeat(16)] {
            let error = with_labels(vec!["chair".into(), bad.into()]).unwrap_err().to_string();
            assert!(error.starts_with("labels[1]: "), "{error}");
        }
        for (field, spec) in [
            ("score_threshold", DetectorSpec { score_threshold: 1.1, ..spec() }),
            ("iou_threshold", DetectorSpec { iou_threshold: f64::NAN, ..spec() }),
            ("input.scale", DetectorSpec { input: Some(InputSpec { scale: 0.0, ..InputSpec::default() }), ..spec() }),
            (
                "input.mean",
                DetectorSpec { input: Some(InputSpec { mean: [0.0, 1e9, 0.0], ..InputSpec::default() }), ..spec() },
            ),
            (
                "input.std",
                DetectorSpec { input: Some(InputSpec { std: [1.0, 1.0, 0.0], ..InputSpec::default() }), ..spec() },
            ),
        ] {
            let error = spec.validate().unwrap_err().to_string();
            assert!(error.starts_with(&format!("{field}: ")), "{error}");
        }
    }

    #[test]
    fn what_is_not_said_is_as_usual_and_what_is_not_known_is_refused() {
        let read = |more: &str| {
            let text =
                format!(r#"{{"name": "fastest", "labels": ["person", "chair"], "layout": "fastest_det"{more}}}"#);
            serde_json::from_str::<DetectorSpec>(&text)
        };
        assert_eq!(read("").unwrap(), spec());
        assert_eq!(spec().input().channel_order, ChannelOrder::Bgr);
        let other = read(r#", "input": {"fit": "letterbox"}, "score_threshold": 0.25"#).unwrap();
        assert_eq!(other.input(), InputSpec { fit: Fit::Letterbox, ..InputSpec::default() });
        assert!(read(r#", "treshold": 0.25"#).is_err());
    }
}

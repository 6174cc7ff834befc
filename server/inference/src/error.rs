//! Why a detector could not be built or run.

/// Facts about refused models, specifications and images. What a file says of itself is told in at most 64 characters.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InferenceError {
    /// A number of the specification is NaN, infinite or outside its bounds.
    #[error("{field}: {value} is not {requirement}")]
    OutOfRange {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
    },
    /// The detector's name or a label cannot be shown.
    #[error("{field}: {value:?} is not of 1 to {limit} bytes without control characters")]
    BadText {
        /// `name`, or `labels[i]`.
        field: String,
        /// The text as given, shortened.
        value: String,
        /// The most bytes.
        limit: usize,
    },
    /// The specification has fewer or more labels than the model has classes.
    #[error("labels: {num_labels} given, the model tells {num_classes} classes apart: give one for each, in its order")]
    LabelsMismatch {
        /// Labels of the specification.
        num_labels: usize,
        /// Classes of the model's output.
        num_classes: usize,
    },
    /// There is more of something than is taken.
    #[error("model: {actual} {what}, more than {limit}: {remedy}")]
    TooLarge {
        /// What is counted.
        what: &'static str,
        /// How much there is, or what it is at least.
        actual: u64,
        /// The most that is taken.
        limit: u64,
        /// What can be done.
        remedy: &'static str,
    },
    /// The bytes are no ONNX file, or a damaged one.
    #[error("model: not a whole ONNX file, {reason} at byte {at}")]
    NotOnnx {
        /// What is wrong.
        reason: &'static str,
        /// Where, from the beginning of the file.
        at: usize,
    },
    /// The model uses what no detector here may.
    #[error("model: {what} {name:?} is not supported: {remedy}")]
    Unsupported {
        /// What kind of thing.
        what: &'static str,
        /// What it is called in the file.
        name: String,
        /// What can be done.
        remedy: &'static str,
    },
    /// The model has other inputs than one image.
    #[error("model: input {actual} is not one image of 1 x 3 x H x W numbers (float32) of fixed size: export it so")]
    InputMismatch {
        /// Names and shapes as in the file.
        actual: String,
    },
    /// The model's outputs are not laid out as the specification says.
    #[error("layout: the model's output {actual} is not {expected}: choose the layout that it was exported with")]
    OutputMismatch {
        /// What the layout asks for.
        expected: &'static str,
        /// Shapes as the model gives them.
        actual: String,
    },
    /// The library could not take or run the model.
    #[error("model: cannot be {step}: {reason}")]
    Failed {
        /// `loaded` or `run`.
        step: &'static str,
        /// The library's own words, shortened.
        reason: String,
    },
    /// An image without pixels.
    #[error("image: {width} x {height} pixels, at least 1 x 1 are needed")]
    EmptyImage {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
}

/// At most `limit` characters of it, control characters as spaces.
pub(crate) fn shortened(text: &str, limit: usize) -> String {
    let plain = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut out: String = plain.take(limit).collect();
    if text.chars().nth(limit).is_some() {
        out.push('…');
    }
    out
}

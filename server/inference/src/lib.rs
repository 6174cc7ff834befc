//! Learned detectors: an ONNX model and an image in, labelled boxes out.
//!
//! Comes in: the bytes of a model, a [`DetectorSpec`] that says what its input and output mean, then [`RgbImage`]s. Goes out:
//! [`Detection2d`]s, in pixels of the image. `perception` lifts these to boxes in space. No files, no network, no memory from
//! one image to the next. Start with [`Detector`].
//!
//! Models come from users. A file is read here first (`outline.rs`), then by the library that runs it (rten, which is safe
//! but promises nothing about memory and time), and what a run takes is counted (`work.rs`) before the first one. A panic of
//! the library becomes an error.
//!
//! [`RgbImage`]: percept_geometry::RgbImage
//! [`Detection2d`]: percept_perception::detection::Detection2d

mod decode;
mod detector;
mod error;
mod network;
mod operators;
mod outline;
mod prepare;
mod protobuf;
mod spec;
mod threads;
mod work;

pub use detector::Detector;
pub use error::InferenceError;
pub use network::ModelLimits;
pub use spec::{ChannelOrder, DetectorSpec, Fit, InputSpec, MAX_LABEL_BYTES, MAX_LABELS, MAX_NAME_BYTES, OutputLayout};
pub use threads::InferenceThreads;

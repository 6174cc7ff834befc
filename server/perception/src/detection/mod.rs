//! A cloud in, objects out: propose, fit a box, classify.
//!
//! Comes in: a cloud in a frame with z up and the floor near z = 0, best the fused cloud around the robot, one
//! frame's cloud as well. Goes out: [`Detection`]s, each a class with its probability and an upright box.
//! What holds the room together (floor, ceiling, walls) is recognised and left out; nothing is remembered
//! from one call to the next. Start with [`Detector::detect`]. What detectors of images find is taken into space by [`Lifter`].

mod amodal;
mod classify;
mod descriptor;
mod detector;
mod image_box;
mod image_detector;
mod lift;
pub mod outdoor;
mod params;
mod passing;
mod propose;
mod sides;
mod structure;
mod walls;

pub use classify::{Candidate, Classifier, GaussianClassifier, Posterior};
pub use descriptor::{ClassExample, Descriptor};
pub use detector::{Detection, Detector};
pub use image_box::{Detection2d, ImageBox};
pub use image_detector::{ImageDetector, ImageDetectors};
pub use lift::{LiftParams, Lifted, Lifter, NotLifted};
pub use params::DetectionParams;
pub use passing::{PassingThing, find_passing};
pub use structure::{Structure, find_structure};
pub use walls::Wall;

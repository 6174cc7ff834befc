//! One lidar scan of a street in, its road users out: cars, vans, trucks, buses, cyclists, motorcycles, people.
//!
//! Comes in: a scan in its sensor's frame, z up. Goes out: [`Detection`](super::Detection)s in that frame, their boxes
//! whole though one side is seen. The way: what stands on the ground, uneven as it may be (`standing`); parts of it
//! that hang together at several gaps (`segments`); for each part a rectangle (`rectangle`) and some numbers
//! (`traits`); what it is by these (`model`, `trained`); of parts and wholes the likelier ones; and their boxes grown
//! to what is hidden (`complete`). Start with [`OutdoorDetector::detect`].

mod complete;
mod detector;
mod model;
mod params;
mod rectangle;
mod segments;
mod standing;
mod trained;
mod traits;
mod voxels;

pub use complete::usual_size;
pub use detector::{OutdoorCandidate, OutdoorDetector};
pub use model::{CLASSES, DEPTH, OutdoorModel, Tree, probabilities};
pub use params::OutdoorParams;
pub use traits::{NUM_TRAITS, Traits};

//! What an object is.

use super::Descriptor;
use crate::cloud::ShapeFeatures;
use nalgebra::Point3;
use percept_geometry::{ObjectClass, OrientedBox3};

/// Probability of each class, in the order of [`ObjectClass::ALL`]; sums to 1.
pub type Posterior = [f64; ObjectClass::ALL.len()];

/// What a classifier is shown: one object's thinned points, box and numbers.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<'a> {
    /// One point a voxel, in the cloud's frame.
    pub points: &'a [Point3<f32>],
    /// The box, standing on the floor if the object does.
    pub bbox: &'a OrientedBox3,
    /// Shape.
    pub features: &'a ShapeFeatures,
    /// Size and build.
    pub descriptor: &'a Descriptor,
}

/// Tells what an object is.
pub trait Classifier: std::fmt::Debug + Send + Sync {
    /// Probability of each class.
    fn posterior(&self, candidate: &Candidate<'_>) -> Posterior;
}

/// Mean and deviation of each number of a [`Descriptor`], in the order of its fields, and how common the
/// class is.
#[derive(Debug, Clone, Copy)]
struct Model {
    class: ObjectClass,
    prior: f64,
    numbers: [(f64, f64); 7],
}

/// Bayes' rule over independent normal distributions, one a class, with sizes of furniture as it is made and
/// sold, and of people; `Unknown` is a flat distribution over everything of that size, so that what fits
/// nothing well is unknown rather than the least bad class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GaussianClassifier;

/// Numbers: height, length, width (m), top share, low fill, high fill, squareness. Deviations leave room for
/// sides that were not seen; fills are above 1 because noise makes surfaces in a fused cloud two voxels thick.
const MODELS: [Model; 6] = [
    Model {
        class: ObjectClass::Table,
        prior: 1.0,
        numbers: [(0.74, 0.05), (1.3, 0.28), (0.78, 0.14), (0.62, 0.18), (0.45, 0.3), (2.8, 1.6), (0.4, 0.25)],
    },
    Model {
        class: ObjectClass::Chair,
        prior: 1.0,
        numbers: [(0.88, 0.07), (0.52, 0.08), (0.47, 0.07), (0.13, 0.05), (1.0, 0.45), (0.8, 0.3), (0.55, 0.2)],
    },
    Model {
        class: ObjectClass::Shelf,
        prior: 1.0,
        numbers: [(1.75, 0.2), (0.97, 0.2), (0.32, 0.09), (0.12, 0.07), (2.2, 0.7), (2.3, 0.7), (0.65, 0.25)],
    },
    Model {
        class: ObjectClass::Box,
        prior: 1.0,
        numbers: [(0.45, 0.12), (0.52, 0.12), (0.42, 0.12), (0.43, 0.16), (1.25, 0.45), (1.3, 0.45), (0.68, 0.2)],
    },
    Model {
        class: ObjectClass::Cylinder,
        prior: 1.0,
        numbers: [(0.8, 0.2), (0.43, 0.1), (0.36, 0.1), (0.2, 0.1), (1.25, 0.45), (1.3, 0.45), (0.13, 0.13)],
    },
    Model {
        class: ObjectClass::Person,
        prior: 0.3,
        numbers: [(1.7, 0.12), (0.48, 0.12), (0.34, 0.1), (0.06, 0.05), (0.8, 0.45), (0.9, 0.45), (0.25, 0.2)],
    },
];

/// Ranges over which `Unknown` is flat, in the same order.
const FLAT: [f64; 7] = [2.0, 2.5, 1.5, 1.0, 3.0, 4.0, 1.0];
const UNKNOWN_PRIOR: f64 = 0.03;

impl Classifier for GaussianClassifier {
    fn posterior(&self, candidate: &Candidate<'_>) -> Posterior {
        posterior(candidate.descriptor)
    }
}

fn posterior(d: &Descriptor) -> Posterior {
    let numbers = [d.height_m, d.length_m, d.width_m, d.top_share, d.low_fill, d.high_fill, d.squareness];
    let mut logs = [f64::NEG_INFINITY; ObjectClass::ALL.len()];
    logs[0] = UNKNOWN_PRIOR.ln() - FLAT.iter().map(|r: &f64| r.ln()).sum::<f64>();
    for model in &MODELS {
        let fit: f64 = numbers.iter().zip(&model.numbers).map(|(x, (mean, sigma))| log_normal(*x, *mean, *sigma)).sum();
        logs[index(model.class)] = model.prior.ln() + fit;
    }
    let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights = logs.map(|l| (l - top).exp());
    let total: f64 = weights.iter().sum();
    weights.map(|w| w / total)
}

fn log_normal(x: f64, mean: f64, sigma: f64) -> f64 {
    -0.5 * ((x - mean) / sigma).powi(2) - (sigma * std::f64::consts::TAU.sqrt()).ln()
}

fn index(class: ObjectClass) -> usize {
    ObjectClass::ALL.iter().position(|c| *c == class).unwrap_or(0)
}

/// The most probable class and its probability; of equals the first.
pub(super) fn most_probable(posterior: &Posterior) -> (ObjectClass, f64) {
    let mut best = (ObjectClass::Unknown, posterior[0]);
    for (class, p) in ObjectClass::ALL.into_iter().zip(posterior) {
        if *p > best.1 {
            best = (class, *p);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(height_m: f64, length_m: f64, width_m: f64, rest: [f64; 4]) -> ObjectClass {
        let [top_share, low_fill, high_fill, squareness] = rest;
        let d = Descriptor { height_m, length_m, width_m, top_share, low_fill, high_fill, squareness };
        let p = posterior(&d);
        assert!((p.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        most_probable(&p).0
    }

    #[test]
    fn things_of_usual_size_and_build_are_what_they_are() {
        assert_eq!(named(0.72, 1.4, 0.8, [0.7, 0.3, 2.5, 0.5]), ObjectClass::Table);
        assert_eq!(named(0.9, 0.45, 0.43, [0.12, 0.7, 0.6, 0.7]), ObjectClass::Chair);
        assert_eq!(named(1.9, 0.8, 0.3, [0.12, 1.8, 1.8, 0.8]), ObjectClass::Shelf);
        assert_eq!(named(0.4, 0.45, 0.4, [0.45, 0.9, 0.9, 0.9]), ObjectClass::Box);
        assert_eq!(named(0.9, 0.45, 0.44, [0.2, 0.9, 0.9, 0.03]), ObjectClass::Cylinder);
        assert_eq!(named(1.7, 0.5, 0.4, [0.05, 0.5, 0.8, 0.1]), ObjectClass::Person);
    }

    #[test]
    fn what_fits_nothing_is_unknown() {
        assert_eq!(named(1.2, 2.8, 1.9, [0.2, 2.0, 2.0, 0.6]), ObjectClass::Unknown);
        assert_eq!(named(0.0, 0.0, 0.0, [0.0; 4]), ObjectClass::Unknown);
    }
}

//! What an object is.

use super::{ClassExample, Descriptor};
use crate::cloud::ShapeFeatures;
use nalgebra::Point3;
use percept_geometry::{ObjectClass, OrientedBox3};

/// Probability of each class that the classifier knows, each once; sums to 1.
pub type Posterior = Vec<(ObjectClass, f64)>;

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
#[derive(Debug, Clone, Copy, PartialEq)]
struct Model {
    class: ObjectClass,
    prior: f64,
    numbers: [(f64, f64); 7],
}

/// Bayes' rule over independent normal distributions, one a class, with sizes of furniture as it is made and
/// sold, and of people; `Unknown` is a flat distribution over everything of that size, so that what fits
/// nothing well is unknown rather than the least bad class. Classes that people showed by examples stand beside the built-in ones.
#[derive(Debug, Clone, PartialEq)]
pub struct GaussianClassifier {
    models: Vec<Model>,
}

impl Default for GaussianClassifier {
    fn default() -> Self {
        Self::with_examples(&[])
    }
}

impl GaussianClassifier {
    /// The built-in classes, and those of the examples: a normal distribution around the mean of each class' examples. Examples of
    /// a built-in class stand beside what is known of it.
    ///
    /// Source: the deviations are the posterior means of normal variances with a scaled inverse chi-squared prior (Gelman et al.,
    /// Bayesian Data Analysis, section 3.3) that counts like [`PRIOR_EXAMPLES`] examples and deviates as the built-in classes do.
    pub fn with_examples(examples: &[ClassExample]) -> Self {
        let mut by_class = std::collections::BTreeMap::<ObjectClass, Vec<[f64; 7]>>::new();
        for example in examples {
            by_class.entry(example.class).or_default().push(numbers(&example.descriptor));
        }
        let learned = by_class.into_iter().map(|(class, examples)| learned(class, &examples));
        Self { models: MODELS.into_iter().chain(learned).collect() }
    }

    fn posterior_of(&self, descriptor: &Descriptor) -> Posterior {
        let numbers = numbers(descriptor);
        let unknown = UNKNOWN_PRIOR.ln() - FLAT.iter().map(|r: &f64| r.ln()).sum::<f64>();
        let mut logs = vec![(ObjectClass::Unknown, unknown)];
        for model in &self.models {
            let fit = numbers.iter().zip(&model.numbers).map(|(x, (mean, sigma))| log_normal(*x, *mean, *sigma));
            logs.push((model.class, model.prior.ln() + fit.sum::<f64>()));
        }
        let top = logs.iter().map(|l| l.1).fold(f64::NEG_INFINITY, f64::max);
        let mut out = Posterior::new();
        for (class, log) in logs {
            let weight = (log - top).exp();
            match out.iter_mut().find(|o| o.0 == class) {
                Some(same) => same.1 += weight,
                None => out.push((class, weight)),
            }
        }
        let total: f64 = out.iter().map(|o| o.1).sum();
        out.iter_mut().for_each(|o| o.1 /= total);
        out
    }
}

/// What is thought of a class before there are examples counts like so many of them: one example alone says little of how its class
/// differs in itself. Chosen: of two or three, as people give, the spread is believed half.
const PRIOR_EXAMPLES: f64 = 3.0;

fn learned(class: ObjectClass, examples: &[[f64; 7]]) -> Model {
    let count = examples.len() as f64;
    let numbers = std::array::from_fn(|i| {
        let mean = examples.iter().map(|e| e[i]).sum::<f64>() / count;
        let squares: f64 = examples.iter().map(|e| (e[i] - mean).powi(2)).sum();
        let usual = MODELS.iter().map(|m| m.numbers[i].1).sum::<f64>() / MODELS.len() as f64;
        (mean, ((PRIOR_EXAMPLES * usual * usual + squares) / (PRIOR_EXAMPLES + count - 1.0)).sqrt())
    });
    Model { class, prior: 1.0, numbers }
}

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
        self.posterior_of(candidate.descriptor)
    }
}

fn numbers(d: &Descriptor) -> [f64; 7] {
    [d.height_m, d.length_m, d.width_m, d.top_share, d.low_fill, d.high_fill, d.squareness]
}

fn log_normal(x: f64, mean: f64, sigma: f64) -> f64 {
    -0.5 * ((x - mean) / sigma).powi(2) - (sigma * std::f64::consts::TAU.sqrt()).ln()
}

/// The most probable class and its probability; of equals the first.
pub(super) fn most_probable(posterior: &Posterior) -> (ObjectClass, f64) {
    let mut best = (ObjectClass::Unknown, 0.0);
    for &(class, p) in posterior {
        if p > best.1 {
            best = (class, p);
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
        let p = GaussianClassifier::default().posterior_of(&d);
        assert!((p.iter().map(|p| p.1).sum::<f64>() - 1.0).abs() < 1e-12);
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
    /// A tall plant in a pot: thin below, wide above, round.
    fn plant(height_m: f64, length_m: f64) -> Descriptor {
        let width_m = 0.9 * length_m;
        Descriptor { height_m, length_m, width_m, top_share: 0.1, low_fill: 0.4, high_fill: 2.2, squareness: 0.1 }
    }

    #[test]
    fn a_class_is_learned_from_examples() {
        let class = ObjectClass::parse("plant").unwrap();
        let example = |h, l| ClassExample { class, descriptor: plant(h, l) };
        let best = |examples: &[ClassExample], d: &Descriptor| {
            most_probable(&GaussianClassifier::with_examples(examples).posterior_of(d))
        };
        assert_ne!(best(&[], &plant(1.2, 0.7)).0, class);
        for examples in [&[example(1.2, 0.7)][..], &[example(1.2, 0.7), example(1.0, 0.6), example(1.4, 0.85)]] {
            assert_eq!(best(examples, &plant(1.15, 0.75)).0, class);
            // Other things are what they were.
            let d = |height_m, length_m, width_m, rest: [f64; 4]| {
                let [top_share, low_fill, high_fill, squareness] = rest;
                Descriptor { height_m, length_m, width_m, top_share, low_fill, high_fill, squareness }
            };
            assert_eq!(best(examples, &d(0.72, 1.4, 0.8, [0.7, 0.3, 2.5, 0.5])).0, ObjectClass::Table);
            assert_eq!(best(examples, &d(0.9, 0.45, 0.43, [0.12, 0.7, 0.6, 0.7])).0, ObjectClass::Chair);
            assert_eq!(best(examples, &d(1.2, 2.8, 1.9, [0.2, 2.0, 2.0, 0.6])).0, ObjectClass::Unknown);
        }
    }

    #[test]
    fn examples_of_a_built_in_class_widen_it() {
        // A bar table.
        let tall = Descriptor {
            height_m: 1.1,
            length_m: 0.7,
            width_m: 0.7,
            top_share: 0.6,
            low_fill: 0.3,
            high_fill: 0.5,
            squareness: 0.3,
        };
        let before = most_probable(&GaussianClassifier::default().posterior_of(&tall));
        assert_ne!(before.0, ObjectClass::Table);
        let example = ClassExample { class: ObjectClass::Table, descriptor: tall };
        let after = GaussianClassifier::with_examples(&[example]).posterior_of(&tall);
        assert_eq!(most_probable(&after).0, ObjectClass::Table);
        assert_eq!(after.iter().filter(|p| p.0 == ObjectClass::Table).count(), 1);
    }
}

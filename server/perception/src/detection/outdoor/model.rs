//! What a candidate is, from its traits.

use super::traits::{NUM_TRAITS, Traits};
use percept_geometry::ObjectClass;
use std::borrow::Cow;

/// Questions that lead to a leaf.
pub const DEPTH: usize = 3;

/// Classes that are told apart, `Unknown` first: all that is no road user.
pub const CLASSES: [ObjectClass; 8] = [
    ObjectClass::Unknown,
    ObjectClass::Person,
    ObjectClass::Car,
    ObjectClass::Van,
    ObjectClass::Truck,
    ObjectClass::Bus,
    ObjectClass::Cyclist,
    ObjectClass::Motorcycle,
];

/// A tree of decision: three questions in turn, each whether a trait exceeds a value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tree {
    /// Trait and value; the questions after number i are 2 i + 1 (no) and 2 i + 2 (yes).
    pub splits: [(u8, f32); (1 << DEPTH) - 1],
    /// What is added to the score of the tree's class, from all no to all yes.
    pub leaves: [f32; 1 << DEPTH],
}

impl Tree {
    /// What it adds.
    pub fn score(&self, traits: &Traits) -> f64 {
        let mut node = 0;
        for _ in 0..DEPTH {
            let (trait_index, value) = self.splits[node];
            let is_more = traits[usize::from(trait_index) % NUM_TRAITS] > f64::from(value);
            node = 2 * node + 1 + usize::from(is_more);
        }
        f64::from(self.leaves[node + 1 - (1 << DEPTH)])
    }
}

/// Boosted trees: each class has a score, a sum over its trees; probabilities are proportional to the exponents of
/// scores.
///
/// Source: Friedman, "Greedy function approximation: a gradient boosting machine", 2001, algorithm 6 (K classes).
/// Temperature: Guo et al., "On calibration of modern neural networks", 2017.
#[derive(Debug, Clone, PartialEq)]
pub struct OutdoorModel {
    /// Trees in rounds of one a class, in the order of [`CLASSES`].
    pub trees: Cow<'static, [Tree]>,
    /// What scores are divided by, so that probabilities say how often they are right; positive.
    pub temperature: f64,
}

impl OutdoorModel {
    /// Probability of each of [`CLASSES`]; sums to 1.
    pub fn posterior(&self, traits: &Traits) -> [f64; CLASSES.len()] {
        let mut scores = [0.0; CLASSES.len()];
        for (i, tree) in self.trees.iter().enumerate() {
            scores[i % CLASSES.len()] += tree.score(traits);
        }
        probabilities(&scores.map(|s| s / self.temperature))
    }
}

/// Exponents of scores over their sum.
pub fn probabilities(scores: &[f64; CLASSES.len()]) -> [f64; CLASSES.len()] {
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights = scores.map(|s| (s - most).exp());
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_lead_to_the_leaf_that_they_say() {
        let mut splits = [(0, 1.0); 7];
        // No, then trait 1 above 5, then trait 2 above 0.
        (splits[1], splits[4]) = ((1, 5.0), (2, 0.0));
        let tree = Tree { splits, leaves: std::array::from_fn(|i| i as f32) };
        let mut traits = [0.0; NUM_TRAITS];
        (traits[0], traits[1], traits[2]) = (0.5, 6.0, -1.0);
        assert_eq!(tree.score(&traits), 2.0);
        traits[2] = 1.0;
        assert_eq!(tree.score(&traits), 3.0);
        traits[0] = 2.0;
        assert_eq!(tree.score(&traits), 7.0);
        let model = OutdoorModel { trees: Cow::Owned(vec![tree]), temperature: 2.0 };
        let p = model.posterior(&traits);
        assert!((p[0] / p[1] - 3.5f64.exp()).abs() < 1e-9 && (p.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}

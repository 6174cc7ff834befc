//! What class an object is, after many looks.

use percept_geometry::ObjectClass;

const CLASSES: usize = ObjectClass::ALL.len();

/// Log-probabilities of the classes, in the order of [`ObjectClass::ALL`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClassBelief {
    log_odds: [f64; CLASSES],
}

impl ClassBelief {
    /// Every class equally likely.
    pub fn uniform() -> Self {
        Self { log_odds: [0.0; CLASSES] }
    }

    /// The belief with these probabilities (in the order of [`ObjectClass::ALL`]; need not sum to 1).
    pub fn from_probabilities(probabilities: &[f64; CLASSES]) -> Self {
        Self { log_odds: probabilities.map(|p| if p > 1e-12 { p.ln() } else { 1e-12f64.ln() }) }
    }

    /// Adds one look that said `class` with `confidence` in 0..1, the rest shared by the other classes.
    ///
    /// Looks at one and the same object are not independent: older ones fade by `1 - 1 / memory`, so that at most
    /// `memory` (at least 1) of them count together. Bayes' rule with exponential forgetting.
    pub fn observe(&mut self, class: ObjectClass, confidence: f64, memory: f64) {
        // Never certain, and never evidence against the class that was named.
        let p = confidence.clamp(1.0 / CLASSES as f64, 0.99);
        let rest = (1.0 - p) / (CLASSES - 1) as f64;
        let keep = 1.0 - 1.0 / memory.max(1.0);
        for (log_odds, c) in self.log_odds.iter_mut().zip(ObjectClass::ALL) {
            *log_odds = keep * *log_odds + if c == class { p.ln() } else { rest.ln() };
        }
    }

    /// Probabilities in the order of [`ObjectClass::ALL`]; they sum to 1.
    pub fn probabilities(&self) -> [f64; CLASSES] {
        let most = self.log_odds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights = self.log_odds.map(|l| (l - most).exp());
        let sum: f64 = weights.iter().sum();
        weights.map(|w| w / sum)
    }

    /// The likeliest class (the first of equals) and its probability.
    pub fn best(&self) -> (ObjectClass, f64) {
        let p = self.probabilities();
        let mut best = 0;
        for i in 1..CLASSES {
            if p[i] > p[best] {
                best = i;
            }
        }
        (ObjectClass::ALL[best], p[best])
    }

    /// The mean of two beliefs in log-probability, for two tracks that turn out to be one object.
    pub fn pooled(&self, other: &Self) -> Self {
        Self { log_odds: std::array::from_fn(|i| 0.5 * (self.log_odds[i] + other.log_odds[i])) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ObjectClass::{Chair, Table};

    #[test]
    fn one_look_gives_its_own_confidence_back() {
        let mut belief = ClassBelief::uniform();
        belief.observe(Chair, 0.7, 3.0);
        assert_eq!(belief.best().0, Chair);
        assert!((belief.best().1 - 0.7).abs() < 1e-12);
    }

    #[test]
    fn two_equal_looks_follow_bayes_where_nothing_is_forgotten() {
        let mut belief = ClassBelief::uniform();
        belief.observe(Chair, 0.7, 1e12);
        belief.observe(Chair, 0.7, 1e12);
        let others = (CLASSES - 1) as f64;
        let expected = 0.49 / (0.49 + others * (0.3 / others).powi(2));
        assert!((belief.best().1 - expected).abs() < 1e-9);
    }

    #[test]
    fn many_looks_never_make_more_than_the_memory_and_can_be_overruled() {
        let mut belief = ClassBelief::uniform();
        for _ in 0..1000 {
            belief.observe(Table, 0.6, 3.0);
        }
        let others = (CLASSES - 1) as f64;
        let three = 0.6f64.powi(3) / (0.6f64.powi(3) + others * (0.4 / others).powi(3));
        assert!((belief.best().1 - three).abs() < 1e-9);
        for _ in 0..4 {
            belief.observe(Chair, 0.6, 3.0);
        }
        assert_eq!(belief.best().0, Chair);
        let sum: f64 = belief.probabilities().iter().sum();
        assert!((sum - 1.0).abs() < 1e-12);
        let again = ClassBelief::from_probabilities(&belief.probabilities());
        assert!((again.best().1 - belief.best().1).abs() < 1e-12);
    }
}

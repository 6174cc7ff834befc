//! What class an object is, after many looks.

use percept_geometry::ObjectClass;
use std::cmp::Ordering;

/// Classes that an unseen thing may be: what one look leaves over is shared by all but the one that was named. More may be named.
const CLASSES: f64 = ObjectClass::BUILT_IN.len() as f64;
/// Classes that one thing is taken for, at most: of more the least likely is forgotten.
const MAX_NAMED: usize = 32;

/// Log-probabilities of the classes that a thing was taken for, and of any other.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassBelief {
    /// In the order in which they were first named.
    named: Vec<(ObjectClass, f64)>,
    /// Of each that was not.
    other: f64,
}

impl ClassBelief {
    /// Every class equally likely.
    pub fn uniform() -> Self {
        Self { named: Vec::new(), other: 0.0 }
    }

    /// The belief with these probabilities; what they lack to 1 is shared by the classes that are not among them.
    pub fn from_probabilities(probabilities: &[(ObjectClass, f64)]) -> Self {
        let log = |p: f64| if p > 1e-12 { p.ln() } else { 1e-12f64.ln() };
        let rest = (1.0 - probabilities.iter().map(|p| p.1).sum::<f64>()).max(0.0);
        let named: Vec<(ObjectClass, f64)> = probabilities.iter().map(|&(class, p)| (class, log(p))).collect();
        let other = log(rest / num_others(named.len()));
        Self { named, other }
    }

    /// Adds one look that said `class` with `confidence` in 0..1, the rest shared by the other classes.
    ///
    /// Looks at one and the same object are not independent: older ones fade by `1 - 1 / memory`, so that at most
    /// `memory` (at least 1) of them count together. Bayes' rule with exponential forgetting.
    pub fn observe(&mut self, class: ObjectClass, confidence: f64, memory: f64) {
        // Never certain, and never evidence against the class that was named.
        let p = confidence.clamp(1.0 / CLASSES, 0.99);
        let rest = (1.0 - p) / (CLASSES - 1.0);
        let keep = 1.0 - 1.0 / memory.max(1.0);
        if self.named.iter().all(|n| n.0 != class) {
            self.named.push((class, self.other));
        }
        for (c, log_odds) in &mut self.named {
            *log_odds = keep * *log_odds + if *c == class { p.ln() } else { rest.ln() };
        }
        self.other = keep * self.other + rest.ln();
        if self.named.len() > MAX_NAMED
            && let Some(least) = (0..self.named.len()).min_by(|&a, &b| self.named[a].1.total_cmp(&self.named[b].1))
        {
            self.named.remove(least);
        }
    }

    /// Probabilities of the classes that it was taken for, likeliest first (equals in the order of the classes). What they lack to 1
    /// is shared by all others.
    pub fn probabilities(&self) -> Vec<(ObjectClass, f64)> {
        let most = self.named.iter().map(|n| n.1).fold(self.other, f64::max);
        let weigh = |log_odds: f64| (log_odds - most).exp();
        let sum: f64 =
            self.named.iter().map(|n| weigh(n.1)).sum::<f64>() + num_others(self.named.len()) * weigh(self.other);
        let mut out: Vec<(ObjectClass, f64)> = self.named.iter().map(|n| (n.0, weigh(n.1) / sum)).collect();
        out.sort_by(likeliest_first);
        out
    }

    /// Probability of a class.
    pub fn probability(&self, class: ObjectClass) -> f64 {
        let all = self.probabilities();
        let rest = 1.0 - all.iter().map(|p| p.1).sum::<f64>();
        all.iter().find(|p| p.0 == class).map_or(rest.max(0.0) / num_others(all.len()), |p| p.1)
    }

    /// The likeliest class (the first of equals) and its probability.
    pub fn best(&self) -> (ObjectClass, f64) {
        self.probabilities().first().copied().unwrap_or((ObjectClass::Unknown, 1.0 / CLASSES))
    }

    /// The mean of two beliefs in log-probability, for two tracks that turn out to be one object.
    pub fn pooled(&self, other: &Self) -> Self {
        let of = |belief: &Self, class| belief.named.iter().find(|n| n.0 == class).map_or(belief.other, |n| n.1);
        let only_theirs = other.named.iter().filter(|n| self.named.iter().all(|m| m.0 != n.0));
        let mut named: Vec<(ObjectClass, f64)> =
            self.named.iter().chain(only_theirs).map(|&(c, _)| (c, 0.5 * (of(self, c) + of(other, c)))).collect();
        named.sort_by(likeliest_first);
        named.truncate(MAX_NAMED);
        Self { named, other: 0.5 * (self.other + other.other) }
    }
}

fn likeliest_first(a: &(ObjectClass, f64), b: &(ObjectClass, f64)) -> Ordering {
    b.1.total_cmp(&a.1).then(a.0.cmp(&b.0))
}

/// Classes beside so many that have a name of their own; one at least.
fn num_others(named: usize) -> f64 {
    (CLASSES - named as f64).max(1.0)
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
        let others = CLASSES - 1.0;
        let expected = 0.49 / (0.49 + others * (0.3 / others).powi(2));
        assert!((belief.best().1 - expected).abs() < 1e-9);
    }

    #[test]
    fn many_looks_never_make_more_than_the_memory_and_can_be_overruled() {
        let mut belief = ClassBelief::uniform();
        for _ in 0..1000 {
            belief.observe(Table, 0.6, 3.0);
        }
        let others = CLASSES - 1.0;
        let three = 0.6f64.powi(3) / (0.6f64.powi(3) + others * (0.4 / others).powi(3));
        assert!((belief.best().1 - three).abs() < 1e-9);
        for _ in 0..4 {
            belief.observe(Chair, 0.6, 3.0);
        }
        assert_eq!(belief.best().0, Chair);
        let sum = [Table, Chair].map(|c| belief.probability(c)).iter().sum::<f64>()
            + (CLASSES - 2.0) * belief.probability(ObjectClass::Bus);
        assert!((sum - 1.0).abs() < 1e-12);
        let again = ClassBelief::from_probabilities(&belief.probabilities());
        assert!((again.best().1 - belief.best().1).abs() < 1e-12);
    }
    #[test]
    fn a_class_that_nobody_knew_is_believed_like_any_other() {
        let plant = ObjectClass::parse("plant").unwrap();
        let mut belief = ClassBelief::uniform();
        belief.observe(plant, 0.8, 3.0);
        assert_eq!(belief.best().0, plant);
        assert!((belief.best().1 - 0.8).abs() < 1e-12);
        let mut other = ClassBelief::uniform();
        other.observe(Chair, 0.6, 3.0);
        assert_eq!(belief.pooled(&other).best().0, plant);
        assert_eq!(belief.pooled(&other), ClassBelief { named: belief.pooled(&other).named, ..other.pooled(&belief) });
    }

    #[test]
    fn a_thousand_names_take_bounded_memory() {
        let mut belief = ClassBelief::uniform();
        for i in 0..1000 {
            belief.observe(ObjectClass::parse(&format!("c{}", i % 500)).unwrap(), 0.5, 3.0);
        }
        belief.observe(Table, 0.9, 3.0);
        assert!(belief.probabilities().len() <= MAX_NAMED);
        assert_eq!(belief.best().0, Table);
        assert!(belief.probabilities().iter().map(|p| p.1).sum::<f64>() <= 1.0 + 1e-12);
    }
}

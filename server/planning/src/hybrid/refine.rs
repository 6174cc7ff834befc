//! Cheaper ways than the first, by finer searches.

use super::levels::{Level, Steering};
use super::{Arcs, DrivingCost, HybridParams, HybridPath, Limits, shortcut};

/// Finer and finer, each a search for what is cheaper than what is known; the first has a third of the expansions, the second what
/// is left.
const LEVELS: [Level; 2] = [
    Level { share: 0.125, as_map: false, headings: 1, is_exact: true, max_expansions: usize::MAX },
    Level { share: 0.0625, as_map: false, headings: 2, is_exact: true, max_expansions: usize::MAX },
];

/// Paths of more turning radii are left as they are: so few expansions do not lead to their end.
const LONGEST: f64 = 12.0;

/// A cheaper way has to save this share.
const LEAST_GAIN: f64 = 2e-3;

/// What came of it.
pub(crate) struct Refined {
    pub(crate) arcs: Arcs,
    /// Of this and all before.
    pub(crate) expansions: usize,
    /// False if the caller ended it.
    pub(crate) is_final: bool,
}

impl Steering<'_> {
    /// The cheapest of a way and those that finer searches find; and expansions, those given among them.
    ///
    /// Their estimates are not made larger, so that a level that comes to its end has found what is the cheapest at its fineness.
    pub(crate) fn refined(&self, arcs: Arcs, expansions: usize, limits: &Limits<'_>) -> Refined {
        let cost = DrivingCost { costmap: self.costmap, params: self.params };
        let exactly = Steering { params: HybridParams { tolerance: 0.0, ..self.params }, ..*self };
        let (mut best, mut spent) = (arcs, expansions);
        let most = self.params.refine_expansions.min(limits.max_expansions.saturating_sub(spent)) + spent;
        for (level, share) in LEVELS.iter().zip([3, 1]) {
            let max_expansions = (most - spent) / share;
            if max_expansions == 0 {
                break;
            }
            let length: f64 = best.iter().map(|(_, arc)| arc.length.abs()).sum();
            let known = cost.of_arcs(&best, None);
            if length > LONGEST * self.params.turning_radius_m {
                break;
            }
            let of_level = Limits { max_expansions, cheaper_than: known * (1.0 - LEAST_GAIN), ..*limits };
            let search = exactly.at(level);
            // It costs what the unobstructed curve does.
            if known <= search.unobstructed_at_least(&self.start) * (1.0 + LEAST_GAIN) {
                break;
            }
            match search.search(&self.start, &of_level) {
                HybridPath::Found { arcs, expansions, .. } => {
                    spent += expansions;
                    let arcs = shortcut(&cost, self.fit, arcs);
                    if cost.of_arcs(&arcs, None) < known {
                        best = arcs;
                    }
                }
                HybridPath::Exhausted { expansions } => spent += expansions,
                HybridPath::Stopped { by_caller: false } => spent += max_expansions,
                HybridPath::Stopped { by_caller: true } => {
                    return Refined { arcs: best, expansions: spent, is_final: false };
                }
                HybridPath::Apart => break,
            }
        }
        Refined { arcs: best, expansions: spent, is_final: true }
    }
}

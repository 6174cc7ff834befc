//! Kinds of evidence, and what planar marks make of each.

use super::OccupancyParams;
use super::evidence::Evidence;
use super::mark::{Heights, Mark};
use rustc_hash::FxHashMap;

/// What evidence there is in the cells of a grid, each kind once under a number. Cells are many, and kinds few: planar marks of one height
/// lead from each kind to one other if free, and to one other if hit, so that a cell's evidence moves on by looking up a number.
#[derive(Debug, Clone, Default)]
pub(super) struct Kinds {
    all: Vec<Evidence>,
    known: FxHashMap<[u64; 6], u16>,
    steps: Vec<Steps>,
}

/// Where planar marks of these heights lead to, by kind; what was not asked for yet is [`Step::UNKNOWN`], or beyond the end.
#[derive(Debug, Clone)]
struct Steps {
    heights: Heights,
    free: Vec<Step>,
    hit: Vec<Step>,
}

/// The kind that a mark leads to, and whether further free marks of the same heights change nothing any more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step(u32);

impl Step {
    const UNKNOWN: Self = Self(u32::MAX);

    #[inline]
    pub(super) fn kind(self) -> u16 {
        self.0 as u16
    }

    /// A bit: 1 if it is settled.
    #[inline]
    pub(super) fn settled(self) -> u64 {
        u64::from(self.0 >> 16 & 1)
    }

    #[inline]
    pub(super) fn is_known(self) -> bool {
        self != Self::UNKNOWN
    }
}

impl Kinds {
    /// Numbers that there are.
    const MOST: usize = 1 << 16;

    /// The kind of a number that it gave.
    #[inline]
    pub(super) fn get(&self, kind: u16) -> Option<&Evidence> {
        self.all.get(usize::from(kind))
    }

    /// Whether so many more will find a number.
    pub(super) fn has_room(&self, more: usize) -> bool {
        self.all.len() + more <= Self::MOST
    }

    /// The number of a kind that it has.
    pub(super) fn find(&self, evidence: &Evidence) -> Option<u16> {
        self.known.get(&evidence.bits()).copied()
    }

    /// The number of a kind; there has to be room.
    pub(super) fn number(&mut self, evidence: &Evidence) -> u16 {
        *self.known.entry(evidence.bits()).or_insert_with(|| {
            self.all.push(*evidence);
            (self.all.len() - 1) as u16
        })
    }

    /// Where planar marks lead to, free and hit, as far as it is known.
    #[inline]
    pub(super) fn steps(&self, heights: Heights) -> (&[Step], &[Step]) {
        let steps = self.steps.iter().find(|steps| steps.heights == heights);
        steps.map_or((&[], &[]), |steps| (&steps.free, &steps.hit))
    }

    /// Finds where a planar mark leads to from a kind; there has to be room for one more.
    #[cold]
    pub(super) fn learn(&mut self, kind: u16, mark: Mark, params: &OccupancyParams) {
        let (Mark::Free(heights) | Mark::Hit(heights)) = mark else { return };
        let then = |evidence: &Evidence, mark| {
            let mut then = *evidence;
            then.add(mark, true, params);
            then
        };
        let Some(next) = self.get(kind).map(|evidence| then(evidence, mark)) else { return };
        let is_settled = then(&next, Mark::Free(heights)).bits() == next.bits();
        let step = Step(u32::from(is_settled) << 16 | u32::from(self.number(&next)));
        let place = self.steps.iter().position(|steps| steps.heights == heights).unwrap_or_else(|| {
            self.steps.push(Steps { heights, free: vec![], hit: vec![] });
            self.steps.len() - 1
        });
        let Steps { free, hit, .. } = &mut self.steps[place];
        let steps = if matches!(mark, Mark::Hit(_)) { hit } else { free };
        steps.resize(steps.len().max(usize::from(kind) + 1), Step::UNKNOWN);
        steps[usize::from(kind)] = step;
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        let steps: usize = self.steps.iter().map(|s| size_of::<Step>() * (s.free.len() + s.hit.len())).sum();
        self.all.len() * (size_of::<Evidence>() + size_of::<([u64; 6], u16)>()) + steps
    }
}

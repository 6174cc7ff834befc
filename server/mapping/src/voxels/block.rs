//! Evidence of a block of voxels, in twentieths of log-odds.

use crate::blocks::BLOCK;
use percept_geometry::by_processor;

/// Voxels of a block.
pub(super) const VOXELS: usize = (BLOCK * BLOCK * BLOCK) as usize;
/// What log-odds are kept in: small enough for OctoMap's steps of 0.85 and -0.4, and 6 still fits into a byte.
pub(super) const QUANTUM: f32 = 0.05;
/// Nobody saw this voxel.
pub(super) const UNKNOWN: i8 = i8::MIN;

/// Voxels of a block, 64 a word by slot.
pub(super) type Bits = [u64; VOXELS / 64];
/// What is known of a block: log-odds by slot, [`UNKNOWN`] where nobody looked.
pub(super) type Values = [i8; VOXELS];

/// Steps and limits, in quanta.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LogOdds {
    pub(super) hit: i8,
    pub(super) free: i8,
    pub(super) min: i8,
    pub(super) max: i8,
}

/// What the keyframes of one submap say about a block's voxels, in a form that can be laid over what earlier ones say: what their steps,
/// each clamped, make of a voxel of which nothing is known, and of one that is as occupied as can be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Evidence {
    pub(super) values: Values,
    pub(super) most: Values,
}

impl Evidence {
    pub(super) fn none(of: &LogOdds) -> Self {
        Self { values: [UNKNOWN; VOXELS], most: [of.max; VOXELS] }
    }

    /// Adds what one keyframe passed and hit; what was hit was not passed.
    pub(super) fn add(&mut self, free: &Bits, hit: &Bits, of: &LogOdds) {
        let words = self.values.chunks_exact_mut(64).zip(self.most.chunks_exact_mut(64)).zip(free.iter().zip(hit));
        for ((values, most), (free, hit)) in words.filter(|(_, (free, hit))| **free | **hit != 0) {
            step(values, most, *free, *hit, of);
        }
    }

    /// What this makes of what earlier submaps say of a voxel.
    pub(super) fn over(&self, slot: usize, under: i8, of: &LogOdds) -> i8 {
        match (self.values[slot], under) {
            (UNKNOWN, known) => known,
            (value, UNKNOWN) => value,
            (value, known) => known.saturating_add(value).min(self.most[slot]).clamp(of.min, of.max),
        }
    }
}

/// A byte for each of eight bits, all ones where it is set.
#[inline(always)]
fn spread(bits: u64) -> u64 {
    // Each byte keeps its own bit of eight copies; what is not nothing becomes 0x80, and that 0xff.
    let own = (bits & 0xff).wrapping_mul(0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
    let any = own.wrapping_add(0x7f7f_7f7f_7f7f_7f7f) >> 7 & 0x0101_0101_0101_0101;
    any.wrapping_mul(0xff)
}

by_processor! {
    /// Steps the log-odds of 64 voxels, those in `hit` up, those in `free` down.
    fn step(values: &mut [i8], most: &mut [i8], free: u64, hit: u64, of: &LogOdds) {
        let (mut seen, mut hits) = ([0u8; 64], [0u8; 64]);
        for i in 0..8 {
            seen[8 * i..8 * i + 8].copy_from_slice(&spread((free | hit) >> (8 * i)).to_le_bytes());
            hits[8 * i..8 * i + 8].copy_from_slice(&spread(hit >> (8 * i)).to_le_bytes());
        }
        // No branch: 16 to 32 voxels are one operation.
        for (((value, most), seen), hit) in values.iter_mut().zip(most).zip(&seen).zip(&hits) {
            let step = if *hit != 0 { of.hit } else { of.free };
            let known = if *value == UNKNOWN { 0 } else { *value };
            let clamped = |v: i8| v.saturating_add(step).clamp(of.min, of.max);
            *value = if *seen != 0 { clamped(known) } else { *value };
            *most = if *seen != 0 { clamped(*most) } else { *most };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const OF: LogOdds = LogOdds { hit: 17, free: -8, min: -40, max: 70 };

    fn one(evidence: &mut Evidence, is_hit: bool) {
        let mut bits = Bits::default();
        bits[0] = 1 << 3;
        let none = Bits::default();
        if is_hit { evidence.add(&none, &bits, &OF) } else { evidence.add(&bits, &none, &OF) }
    }

    proptest! {
        /// Later evidence laid over earlier is what all steps in turn give wherever none of the two ran into a limit, and says the
        /// same of free and occupied after as much evidence as takes any value to the other side.
        #[test]
        fn parts_laid_over_each_other_are_what_all_steps_give(first in prop::collection::vec(any::<bool>(), 1..6),
                                                             second in prop::collection::vec(any::<bool>(), 1..14)) {
            let (mut a, mut b, mut all) = (Evidence::none(&OF), Evidence::none(&OF), Evidence::none(&OF));
            first.iter().for_each(|h| { one(&mut a, *h); one(&mut all, *h) });
            second.iter().for_each(|h| { one(&mut b, *h); one(&mut all, *h) });
            let laid = b.over(3, a.values[3], &OF);
            let sum = |steps: &[bool]| steps.iter().map(|h| if *h { 17i32 } else { -8 }).collect::<Vec<_>>();
            let runs = |steps: Vec<i32>| steps.iter().scan(0, |s, v| { *s += v; Some(*s) }).all(|s| (-40..=70).contains(&s));
            if runs(sum(&[first.clone(), second.clone()].concat())) && runs(sum(&second)) {
                prop_assert_eq!(laid, all.values[3]);
            }
            let same = |wanted: bool| second.iter().all(|h| *h == wanted);
            if same(false) && second.len() >= 14 { prop_assert!(laid < 0); }
            if same(true) && second.len() >= 3 { prop_assert!(laid > 0); }
        }
    }

    #[test]
    fn each_bit_becomes_a_byte() {
        for bits in 0..=255u64 {
            let bytes = spread(bits).to_le_bytes();
            assert!((0..8).all(|i| bytes[i] == if bits >> i & 1 == 1 { 0xff } else { 0 }), "{bits}: {bytes:?}");
        }
    }

    #[test]
    fn what_nobody_saw_stays_as_it_was() {
        let mut e = Evidence::none(&OF);
        one(&mut e, true);
        assert_eq!((e.values[3], e.values[4]), (17, UNKNOWN));
        assert_eq!((e.over(4, 9, &OF), e.over(3, UNKNOWN, &OF), e.over(3, 9, &OF)), (9, 17, 26));
        assert_eq!(e.over(4, UNKNOWN, &OF), UNKNOWN);
    }
}

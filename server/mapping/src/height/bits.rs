//! Sets of heights, by which what stands somewhere is told from where beams passed.

use super::HeightParams;

/// Bins of a set.
const BINS: i32 = 32;
/// So many bins are a robot's clearance; the rest keeps what is a little under the ground apart from what is over it.
const BINS_OF_CLEARANCE: f64 = 28.0;

/// Heights in bins of a 28th of the clearance, numbered from the frame's zero upward and again from zero after 32: within one
/// storey they are told apart whatever the ground is taken to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Bits(pub(super) u32);

impl Bits {
    pub(super) const NONE: Self = Self(0);

    /// Height of a bin, metres.
    pub(super) fn bin_m(params: &HeightParams) -> f64 {
        params.clearance_m / BINS_OF_CLEARANCE
    }

    /// That of one height; `per_m` is one over that of a bin.
    pub(super) fn at(z: f64, per_m: f64) -> Self {
        // A float beyond the range of i64 becomes the nearest that is in it.
        Self(1 << ((z * per_m).floor() as i64).rem_euclid(i64::from(BINS)))
    }

    pub(super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    pub(super) fn joined(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(super) fn shared(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    pub(super) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// With the bins above and below.
    pub(super) fn widened(self) -> Self {
        Self(self.0 | self.0.rotate_left(1) | self.0.rotate_right(1))
    }

    /// The same after so much upward, to the bin.
    pub(super) fn raised(self, by_m: f64, params: &HeightParams) -> Self {
        let bins = (by_m / Self::bin_m(params)).round() as i64;
        Self(self.0.rotate_left(bins.rem_euclid(i64::from(BINS)) as u32))
    }

    /// As seen from a ground at `z`: the first bin is the one in which that lies.
    fn counted_from(self, z: f64, per_m: f64) -> u32 {
        self.0.rotate_right(Self::at(z, per_m).0.trailing_zeros())
    }

    /// Those of these that are higher above a ground at `z` than all of the others.
    pub(super) fn above(self, others: Self, z: f64, params: &HeightParams) -> Self {
        let per_m = 1.0 / Self::bin_m(params);
        let highest = BINS as u32 - others.counted_from(z, per_m).leading_zeros();
        let mask = u32::MAX.checked_shl(highest).unwrap_or(0);
        Self((self.counted_from(z, per_m) & mask).rotate_left(Self::at(z, per_m).0.trailing_zeros()))
    }

    /// The upper edge of the highest, above a ground at `z`, metres; none of no height.
    pub(super) fn top(self, z: f64, params: &HeightParams) -> Option<f64> {
        let bin = Self::bin_m(params);
        let bins = BINS as u32 - self.counted_from(z, 1.0 / bin).leading_zeros();
        (bins > 0).then(|| ((z / bin).floor() + f64::from(bins)) * bin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_over_any_ground_are_told_apart_and_move_with_it() {
        let params = HeightParams::default();
        let per_m = 1.0 / Bits::bin_m(&params);
        for ground in [-7.3, -0.01, 0.0, 1.9, 250.04] {
            let of = |h: f64| Bits::at(ground + h, per_m);
            let (low, high) = (of(0.4), of(1.2));
            assert!(!low.meets(high) && !of(-0.2).meets(of(1.75)));
            let both = low.joined(high);
            assert_eq!(both.above(of(0.6), ground, &params), high);
            assert_eq!(both.above(Bits::NONE, ground, &params), both);
            let top = both.top(ground, &params).unwrap_or(f64::NAN) - ground;
            assert!((1.2..1.2 + 1.001 * Bits::bin_m(&params)).contains(&top), "{top}");
            assert_eq!(both.without(high).top(ground, &params).map(|z| (z - ground - 0.4) < 0.07), Some(true));
            let up = 20.0 * Bits::bin_m(&params);
            assert_eq!(low.raised(up, &params), Bits::at(ground + 0.4 + up, per_m));
        }
        assert_eq!(Bits::NONE.top(0.0, &params), None);
    }
}

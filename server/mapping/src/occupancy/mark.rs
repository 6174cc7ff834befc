//! What a keyframe says about one cell.

use super::OccupancyParams;

/// What a keyframe says about a cell, and at which heights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// Not seen.
    Unseen,
    /// Behind something, beams went over it at these heights: what stood there so high has gone. What is lower was not seen.
    Over(Heights),
    /// Beams passed at these heights, none ended here.
    Free(Heights),
    /// Beams ended here, at these heights.
    Hit(Heights),
    /// The robot's body came through, at these heights.
    Driven(Heights),
}

impl Mark {
    /// Both marks of one keyframe: a hit outweighs what passed, and the robot itself both; heights of a kind join.
    pub(super) fn joined(self, other: Self) -> Self {
        match (self, other) {
            (Self::Driven(_), _) => self,
            (_, Self::Driven(_)) => other,
            (Self::Hit(a), Self::Hit(b)) => Self::Hit(a.joined(b)),
            (Self::Free(a), Self::Free(b)) => Self::Free(a.joined(b)),
            (Self::Over(a), Self::Over(b)) => Self::Over(a.joined(b)),
            (Self::Hit(_), _) | (_, Self::Unseen) | (Self::Free(_), Self::Over(_)) => self,
            _ => other,
        }
    }
}

/// A set of heights: a bit for each 64th of the band, the lowest first. Sampled beams leave gaps between them, in
/// which the edge of a table may stand unseen; an interval would not know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Heights(u64);

impl Heights {
    /// No height.
    pub(super) const NONE: Self = Self(0);

    /// One height above the floor, metres; none outside of the band.
    pub(super) fn at(params: &OccupancyParams, height: f64) -> Self {
        let share = Self::share(params, height);
        if (0.0..1.0).contains(&share) { Self(1 << (share * 64.0) as u32) } else { Self::NONE }
    }

    /// From one height above the floor to another, metres: what of that lies in the band.
    pub(super) fn between(params: &OccupancyParams, low: f64, high: f64) -> Self {
        let (low, high) = (64.0 * Self::share(params, low), 64.0 * Self::share(params, high));
        if !(high >= 0.0 && low < 64.0) {
            return Self::NONE;
        }
        let (low, high) = (low.max(0.0) as u32, (high as u32).min(63));
        Self(u64::MAX >> (63 - (high - low)) << low)
    }

    /// All from the bottom of the band up to a height above the floor, metres; the lowest at least.
    pub(super) fn up_to(params: &OccupancyParams, height: f64) -> Self {
        Self(u64::MAX >> (63 - (Self::share(params, height).clamp(0.0, 0.999) * 64.0) as u32))
    }

    /// The height of a planar scan, which speaks for the band wherever it lies.
    pub(super) fn of_plane(params: &OccupancyParams, height: f64) -> Self {
        Self(1 << (Self::share(params, height).clamp(0.0, 0.999) * 64.0) as u32)
    }

    fn share(params: &OccupancyParams, height: f64) -> f64 {
        (height - params.band_min_m) / (params.band_max_m - params.band_min_m)
    }

    /// The heights of both.
    pub(super) fn joined(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// These heights but not the others.
    pub(super) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether the other holds all of these.
    pub(super) fn within(self, other: Self) -> bool {
        self.0 & !other.0 == 0
    }

    /// The heights that are in both.
    pub(super) fn shared(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Those of them at which beams surely passed. Where beams are dense they pass just below a board, and above it, as near as they
    /// can: within the bit in which it begins. So the ends of a run of three bits or more do not count; the band's ends do.
    pub(super) fn sure(self) -> Self {
        let (below, above) = (self.0 << 1 | 1, self.0 >> 1 | 1 << 63);
        let middle = self.0 & below & above;
        // Single beams stand alone, or are as wide as two bits.
        let dense = middle | middle << 1 | middle >> 1;
        Self(middle | self.0 & !dense)
    }

    /// As bits, the lowest height first.
    pub(super) fn bits(self) -> u64 {
        self.0
    }

    pub(super) fn of_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// Whether they share a height.
    pub(super) fn meet(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_what_passed_densely_do_not_count() {
        let sure = |bits: u64| Heights(bits).sure().bits();
        assert_eq!(sure(0b1111 << 20), 0b0110 << 20);
        assert_eq!(sure(0b111 << 20), 0b010 << 20);
        // A beam by itself.
        assert_eq!(sure(0b11 << 20 | 1 << 30), 0b11 << 20 | 1 << 30);
        // Nothing is below the band, nor above it.
        assert_eq!(sure(0b111), 0b011);
        assert_eq!(sure(u64::MAX), u64::MAX);
        assert_eq!(sure(0b111 << 61), 0b11 << 62);
    }
}

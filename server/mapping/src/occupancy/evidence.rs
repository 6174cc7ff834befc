//! What the keyframes of one submap say about a cell, in a form that can be laid over what earlier submaps say.

use super::OccupancyParams;
use super::mark::{Heights, Mark};

/// What was seen in a cell. Evidence counts for its own heights: the floor seen under a table does not free its top, nor
/// do the beams of a planar lidar; and what was free for these can still be hit at another height.
///
/// The same marks move whatever was known before. A sum of steps that is clamped after each is itself a step that is
/// clamped: `x -> clamp(x + sum, least, most)`. So a submap keeps what its marks make of nothing, of the least and of
/// the most that a cell keeps, and [`State::overlay`] needs no marks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    /// What the marks make of a cell of which nothing is known; NaN where there is none.
    pub(super) log_odds: f32,
    /// What they make of one that is as free as can be, and of one that is as occupied as can be.
    pub(super) least: f32,
    pub(super) most: f32,
    /// Keyframes of planar sensors that saw it free since it was last hit by one; counts to 2.
    pub(super) planar_passes: u8,
    /// The heights at which something was hit here and not freed since, and those at which beams passed.
    pub(super) standing: Heights,
    pub(super) passed: Heights,
    /// Those at which beams of sensors that are not planar passed in one keyframe, and in several.
    pub(super) passed_once: Heights,
    pub(super) passed_often: Heights,
}

impl Evidence {
    /// Of a cell that nobody saw.
    pub(super) fn none(params: &OccupancyParams) -> Self {
        Self {
            log_odds: f32::NAN,
            least: params.min_log_odds,
            most: params.max_log_odds,
            planar_passes: 0,
            standing: Heights::NONE,
            passed: Heights::NONE,
            passed_once: Heights::NONE,
            passed_often: Heights::NONE,
        }
    }

    /// Adds what a keyframe says.
    pub(super) fn add(&mut self, mark: Mark, planar: bool, params: &OccupancyParams) {
        let before = if self.log_odds.is_nan() { 0.0 } else { self.log_odds };
        let (after, step) = match mark {
            Mark::Unseen => return,
            Mark::Driven(heights) => return self.add_driven(heights, params),
            Mark::Over(heights) => {
                let heights = heights.sure();
                self.add_passes(heights);
                if self.log_odds.is_nan() || !self.standing.meet(heights) {
                    return;
                }
                (before + params.free_log_odds, params.free_log_odds)
            }
            Mark::Free(heights) => {
                let heights = heights.sure();
                self.passed = self.passed.joined(heights);
                if planar {
                    self.planar_passes = (self.planar_passes + 1).min(2);
                } else {
                    self.add_passes(heights);
                }
                // A planar beam may pass between the legs of what other sensors saw whole.
                let blind = if planar { !self.standing.within(heights) } else { !self.standing.meet(heights) };
                if self.standing != Heights::NONE && blind {
                    return;
                }
                (before + params.free_log_odds, params.free_log_odds)
            }
            Mark::Hit(heights) => {
                let news = !self.passed.meet(heights);
                self.standing = self.standing.joined(heights);
                self.passed = self.passed.without(heights);
                self.passed_once = self.passed_once.without(heights);
                self.passed_often = self.passed_often.without(heights);
                if planar {
                    self.planar_passes = 0;
                }
                let before = if news { before.max(params.free_log_odds) } else { before };
                (before + params.hit_log_odds, params.hit_log_odds)
            }
        };
        let clamped = |v: f32| v.clamp(params.min_log_odds, params.max_log_odds);
        (self.least, self.most) = (clamped(self.least + step), clamped(self.most + step));
        self.log_odds = clamped(after);
        if self.log_odds <= 0.0 {
            self.standing = Heights::NONE;
        }
    }

    fn add_passes(&mut self, heights: Heights) {
        self.passed_often = self.passed_often.joined(self.passed_once.shared(heights));
        self.passed_once = self.passed_once.joined(heights);
    }

    /// The robot's body came through: nothing stands at these heights, whatever was seen before, and what comes to stand there is
    /// news. Higher up nothing is known by it.
    fn add_driven(&mut self, heights: Heights, params: &OccupancyParams) {
        self.passed = self.passed.joined(heights);
        self.passed_once = self.passed_once.joined(heights);
        self.passed_often = self.passed_often.joined(heights);
        self.planar_passes = 2;
        self.standing = self.standing.without(heights);
        if self.standing != Heights::NONE {
            return;
        }
        // As free as one look makes it, so that what is seen twice afterwards stands.
        let most = params.free_log_odds.max(params.min_log_odds);
        self.log_odds = if self.log_odds.is_nan() { most } else { self.log_odds.min(most) };
        (self.least, self.most) = (self.least.min(most), self.most.min(most));
    }

    /// As bits that are equal only if all is.
    pub(super) fn bits(&self) -> [u64; 6] {
        let pair = |a: f32, b: f32| u64::from(a.to_bits()) << 32 | u64::from(b.to_bits());
        [
            pair(self.log_odds, self.least),
            u64::from(self.most.to_bits()) << 8 | u64::from(self.planar_passes),
            self.standing.bits(),
            self.passed.bits(),
            self.passed_once.bits(),
            self.passed_often.bits(),
        ]
    }

    pub(super) fn of_bits(bits: [u64; 6]) -> Self {
        let float = |v: u64| f32::from_bits((v & 0xffff_ffff) as u32);
        Self {
            log_odds: float(bits[0] >> 32),
            least: float(bits[0]),
            most: float(bits[1] >> 8),
            planar_passes: (bits[1] & 0xff) as u8,
            standing: Heights::of_bits(bits[2]),
            passed: Heights::of_bits(bits[3]),
            passed_once: Heights::of_bits(bits[4]),
            passed_often: Heights::of_bits(bits[5]),
        }
    }

    /// How many keyframes passed where this stands: 0, 1, or 2 for more.
    fn passes(&self, standing: Heights) -> u8 {
        let spatial = u8::from(self.passed_once.meet(standing)) + u8::from(self.passed_often.meet(standing));
        let planar = if standing.within(self.passed) { self.planar_passes } else { 0 };
        spatial.max(planar)
    }
}

/// What is known of a cell of the map, submap after submap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    pub(super) log_odds: f32,
    standing: Heights,
    passed: Heights,
}

impl State {
    /// Nothing.
    pub(super) const UNKNOWN: Self = Self { log_odds: f32::NAN, standing: Heights::NONE, passed: Heights::NONE };

    /// Lays what a later submap says over this, with the rules that hold within one.
    pub(super) fn overlay(&mut self, later: &Evidence, params: &OccupancyParams) {
        if later.log_odds.is_nan() {
            // Seen over at most.
            return self.lose(later.passes(self.standing), params);
        }
        if self.log_odds.is_nan() {
            *self = Self { log_odds: later.log_odds, standing: later.standing, passed: later.passed };
            return;
        }
        let stands = later.standing != Heights::NONE;
        let moved = |x: f32| (x + later.log_odds).clamp(later.least, later.most);
        if self.standing == Heights::NONE {
            let news = stands && !self.passed.meet(later.standing);
            self.log_odds = moved(if news { self.log_odds.max(params.free_log_odds) } else { self.log_odds });
            self.standing = later.standing;
        } else {
            let passes = later.passes(self.standing);
            if passes == 0 {
                // What stood here was not looked at: it stays, and what was hit besides adds to it.
                let gain = if stands { later.log_odds.max(0.0) } else { 0.0 };
                self.log_odds = (self.log_odds + gain).min(params.max_log_odds);
            } else if passes == 1 && !stands {
                self.lose(passes, params);
            } else {
                self.log_odds = moved(self.log_odds);
                if stands && !self.standing.meet(later.standing) {
                    self.standing = self.standing.without(later.passed_often);
                }
            }
            self.standing = self.standing.joined(later.standing);
        }
        self.passed = self.passed.joined(later.passed).without(later.standing);
        if self.log_odds <= 0.0 {
            self.standing = Heights::NONE;
        }
    }

    /// So many keyframes passed where this stands.
    fn lose(&mut self, passes: u8, params: &OccupancyParams) {
        if passes > 0 {
            self.log_odds = (self.log_odds + f32::from(passes) * params.free_log_odds).max(params.min_log_odds);
            if self.log_odds <= 0.0 {
                self.standing = Heights::NONE;
            }
        }
    }
}

//! What is known of a cell, and how what keyframes and submaps say about it is fused.

use super::HeightParams;
use super::bits::Bits;

/// Ground that is found farther from what was known than this, metres, and than so many standard deviations, is other ground.
const APART_M: f32 = 0.1;
const APART_SIGMAS: f32 = 3.0;
/// Keyframes that find ground elsewhere count so many times, and no ground holds out against more than half of so many.
const AGAINST: u16 = 2;
const MOST_AGAINST: u16 = 20;
/// Variance below which none gets, square metres: 5 mm, what a pose errs by in height at best. So no ground becomes immovable.
const LEAST_VARIANCE: f32 = 2.5e-5;
/// Evidence in a fifth of log-odds: that of a return, of a keyframe whose beams passed, and the most that is kept. These are the
/// occupancy grid's 0.6, -0.4 and 3.5.
const HIT: u8 = 3;
const PASS: u8 = 2;
/// What stands where beams passed before has to be seen twice: so counts the first return there. Those who go by leave nothing.
const NEWS: u8 = 1;
const MOST_EVIDENCE: u8 = 18;
/// A drop outweighs ground that fewer keyframes saw, or so many; and they count to one more.
const MOST_AGAINST_DROP: u16 = 3;
const MOST_DROPS: u8 = 4;

/// What is known of a cell, in one frame. Equal in every bit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    /// Height of the ground, or where it ought to be if it was not seen, metres.
    pub(super) z: f32,
    /// Variance of that, square metres.
    pub(super) variance: f32,
    /// Keyframes that saw it; 0 if it was not seen.
    pub(super) num: u16,
    /// Keyframes that saw a drop where it ought to be, and since then no ground.
    pub(super) drops: u8,
    /// That something stands here.
    pub(super) evidence: u8,
    /// At which heights.
    pub(super) standing: Bits,
    /// The highest of that, and the lowest that hangs above the robot's clearance, metres; NaN for none.
    pub(super) top: f32,
    pub(super) overhang: f32,
}

/// Where beams passed in a block of cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pass {
    /// At these heights in one keyframe, and in several.
    pub(super) once: Bits,
    pub(super) often: Bits,
    /// Height of the ground there, or where it ought to be, metres.
    pub(super) z: f32,
    /// Keyframes.
    pub(super) num: u8,
}

impl Pass {
    pub(super) const NONE: Self = Self { once: Bits::NONE, often: Bits::NONE, z: 0.0, num: 0 };

    pub(super) fn add(&mut self, passed: Bits, z: f32) {
        if passed.is_empty() {
            return;
        }
        if self.num == 0 {
            self.z = z;
        }
        self.often = self.often.joined(self.once.shared(passed));
        self.once = self.once.joined(passed);
        self.num = self.num.saturating_add(1);
    }

    /// How many keyframes passed where this stands.
    fn times(&self, standing: Bits) -> u8 {
        if self.often.meets(standing) { self.num } else { u8::from(self.once.meets(standing)) }
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        let bits = |c: &Self| {
            let floats = [c.z, c.variance, c.top, c.overhang].map(f32::to_bits);
            (floats, c.num, c.drops, c.evidence, c.standing)
        };
        bits(self) == bits(other)
    }
}

impl Cell {
    /// Of which nothing is known but where its ground ought to be.
    pub(super) fn unknown(z: f32) -> Self {
        let (top, overhang) = (f32::NAN, f32::NAN);
        let standing = Bits::NONE;
        Self { z, variance: f32::INFINITY, num: 0, drops: 0, evidence: 0, standing, top, overhang }
    }

    /// Whether anything is known.
    pub(super) fn is_known(&self) -> bool {
        self.num > 0 || self.drops > 0 || !self.standing.is_empty() || !self.overhang.is_nan()
    }

    /// Whether there is a drop where ground ought to be: single beams end below the ground, mirrored, where it was seen before and after.
    pub(super) fn is_drop(&self) -> bool {
        u16::from(self.drops) > self.num.min(MOST_AGAINST_DROP)
    }

    /// The highest of what stands here, metres; NaN for none.
    pub(super) fn standing_top(&self) -> f32 {
        if self.evidence >= HIT { self.top } else { f32::NAN }
    }

    /// Whether they lie on one storey.
    pub(super) fn is_level_with(&self, z: f32, params: &HeightParams) -> bool {
        f64::from((self.z - z).abs()) < params.clearance_m
    }

    /// Ground as `num` keyframes saw it. Kalman's update, if it is the same ground.
    fn find_ground(&mut self, z: f32, variance: f32, num: u16) {
        let off = (z - self.z).abs();
        let is_apart = off > APART_M && off * off > APART_SIGMAS * APART_SIGMAS * (variance + self.variance);
        if self.num > 0 && is_apart {
            let against = num.saturating_mul(AGAINST);
            let held = self.num.min(MOST_AGAINST);
            if held > against {
                self.num = held - against;
                return;
            }
        }
        if self.num == 0 || is_apart {
            (self.z, self.variance, self.num) = (z, variance.max(LEAST_VARIANCE), num);
            return;
        }
        let gain = self.variance / (self.variance + variance);
        self.z += gain * (z - self.z);
        self.variance = ((1.0 - gain) * self.variance).max(LEAST_VARIANCE);
        self.num = self.num.saturating_add(num);
    }

    /// Nothing stands here any more.
    fn clear(&mut self) {
        (self.standing, self.top, self.evidence) = (Bits::NONE, f32::NAN, 0);
    }

    /// Takes heights out of what stands here.
    fn take_away(&mut self, gone: Bits, params: &HeightParams) {
        if gone.meets(self.standing) {
            self.standing = self.standing.without(gone);
            match self.standing.top(self.z.into(), params) {
                Some(top) => self.top = self.top.min(top as f32),
                None => self.clear(),
            }
        }
    }

    /// Beams of so many keyframes passed where it stands.
    fn see_through(&mut self, times: u8) {
        self.evidence = self.evidence.saturating_sub(times.saturating_mul(PASS));
        if self.evidence == 0 {
            self.clear();
        }
    }

    /// Something stands here, up to `top`. What is higher and was seen through goes.
    fn stand(&mut self, standing: Bits, top: f32, evidence: u8, pass: &Pass, params: &HeightParams) {
        let higher = self.standing.without(standing).above(standing, self.z.into(), params);
        self.take_away(higher.shared(pass.often), params);
        self.standing = self.standing.joined(standing);
        // NaN gives way.
        self.top = self.top.max(top);
        self.evidence = self.evidence.saturating_add(evidence).min(MOST_EVIDENCE);
    }

    /// Adds what one keyframe saw, whose beams passed at these heights; `pass` is what all of the submap's did.
    pub(super) fn look(&mut self, seen: &Cell, passed: Bits, pass: &Pass, params: &HeightParams) {
        if seen.num > 0 {
            self.find_ground(seen.z, seen.variance, 1);
        }
        self.drops = match (seen.drops, seen.num) {
            (0, 0) => self.drops,
            (0, _) => self.drops.saturating_sub(1),
            _ => self.drops.saturating_add(1).min(MOST_DROPS),
        };
        // NaN gives way.
        self.overhang = self.overhang.min(seen.overhang);
        if !seen.standing.is_empty() {
            let is_news = self.standing.is_empty() && pass.once.meets(seen.standing);
            self.stand(seen.standing, seen.top, if is_news { NEWS } else { HIT }, pass, params);
        } else {
            self.pass(passed);
        }
    }

    /// Adds a keyframe that saw nothing here, and whose beams passed at these heights.
    pub(super) fn pass(&mut self, passed: Bits) {
        if self.standing.meets(passed) {
            self.see_through(1);
        }
    }

    /// Lays what a later submap says over this: of the cell, and of the beams that passed there.
    pub(super) fn overlay(&mut self, later: Option<&Cell>, pass: &Pass, params: &HeightParams) {
        let Some(later) = later else {
            if !self.standing.is_empty() {
                self.see_through_by(pass);
            }
            return;
        };
        if later.num > 0 {
            self.find_ground(later.z, later.variance, later.num);
        }
        if later.num > 0 || later.drops > 0 {
            self.drops = later.drops;
        }
        if !later.overhang.is_nan() {
            self.overhang = later.overhang;
        }
        if later.standing.is_empty() {
            self.see_through_by(pass);
        } else {
            self.stand(later.standing, later.top, later.evidence, pass, params);
        }
    }

    fn see_through_by(&mut self, pass: &Pass) {
        match pass.times(self.standing) {
            0 => {}
            times => self.see_through(times),
        }
    }

    /// The same in a frame in which it lies so much higher.
    pub(super) fn raised(&self, by_m: f64, params: &HeightParams) -> Self {
        let up = |z: f32| (f64::from(z) + by_m) as f32;
        let standing = self.standing.raised(by_m, params);
        Self { z: up(self.z), top: up(self.top), overhang: up(self.overhang), standing, ..*self }
    }
}

impl Pass {
    /// The same in a frame in which it lies so much higher.
    pub(super) fn raised(&self, by_m: f64, params: &HeightParams) -> Self {
        let up = |bits: Bits| bits.raised(by_m, params);
        Self { once: up(self.once), often: up(self.often), z: (f64::from(self.z) + by_m) as f32, num: self.num }
    }
}

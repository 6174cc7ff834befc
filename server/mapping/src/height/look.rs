//! What one keyframe shows of a cell: which of its returns are ground, and what stands on it.

use super::HeightParams;
use super::bits::Bits;
use super::cell::Cell;
use crate::ground::{Patch, Place};
use nalgebra::Point3;

/// What is so far above the lowest return of a cell is its ground, metres, as in `ground.rs`; what is higher stands on it.
const THICK_M: f64 = 0.1;
/// What is flat and no higher above the ground around is ground that is higher, metres: two treads. It takes so many returns.
const CLIMB_M: f64 = 0.3;
const CLIMB_RETURNS: u32 = 3;
/// Ground is not so much deeper than where it goes on, metres, but for a drop.
pub(super) const DEEP_M: f64 = 0.2;
/// Standard deviation that returns of one keyframe share, metres: what its pose errs by.
const SHARED_SIGMA_M: f64 = 0.01;

/// What is gathered of a cell.
#[derive(Clone, Copy)]
pub(super) struct Look {
    /// Lowest return that may be ground; where the ground ought to be.
    lowest: f64,
    expected: f64,
    num: u32,
    sum_z: f64,
    sum_variance: f64,
    pub(super) standing: Bits,
    top: f64,
    overhang: f64,
    pub(super) is_drop: bool,
}

impl Look {
    pub(super) fn unseen(expected: f64) -> Self {
        Self {
            lowest: f64::INFINITY,
            expected,
            num: 0,
            sum_z: 0.0,
            sum_variance: 0.0,
            standing: Bits::NONE,
            top: f64::NAN,
            overhang: f64::NAN,
            is_drop: false,
        }
    }

    /// Takes note of a return, where the ground ought to be so high: it may be the lowest.
    pub(super) fn lower(&mut self, z: f64, expected: f64, patch: &Patch) {
        let height = z - expected;
        if height < CLIMB_M - patch.doubt && (height > -DEEP_M || patch.is_drop) {
            self.lowest = self.lowest.min(z);
        }
    }

    /// Adds a return, when it is known which is the lowest.
    pub(super) fn add(
        &mut self,
        params: &HeightParams,
        sensor: &Point3<f64>,
        p: &Point3<f64>,
        (place, patch): (&Place, &Patch),
        per_m: f64,
    ) {
        let range = f64::from(place.range);
        let expected = patch.z_at(range);
        let has_ground = self.lowest.is_finite();
        let (foot, thick) = if has_ground { (self.lowest, THICK_M) } else { (expected, THICK_M + patch.doubt) };
        if has_ground && p.z - foot <= thick {
            if p.z >= foot {
                self.num += 1;
                self.sum_z += p.z;
                self.sum_variance += params.height_variance(range, sensor.z - p.z);
            }
        } else if p.z - foot > params.clearance_m {
            self.overhang = self.overhang.min(p.z);
        } else if p.z - foot > thick {
            self.standing = self.standing.joined(Bits::at(p.z, per_m));
            self.top = self.top.max(p.z);
        }
    }

    /// Decides what is ground, when all returns are known.
    pub(super) fn settle(&mut self, per_m: f64) {
        if self.num == 0 {
            return;
        }
        let mean = self.sum_z / f64::from(self.num);
        if mean - self.expected > THICK_M && (!self.standing.is_empty() || self.num < CLIMB_RETURNS) {
            // The face of something, or too little to tell.
            self.standing = self.standing.joined(Bits::at(self.lowest, per_m));
            self.top = self.top.max(self.lowest);
            self.num = 0;
        }
        self.is_drop &= self.num == 0;
    }

    pub(super) fn cell(&self) -> Cell {
        let mut cell = Cell::unknown(self.expected as f32);
        if self.num > 0 {
            let num = f64::from(self.num);
            cell.z = (self.sum_z / num) as f32;
            cell.variance = (self.sum_variance / (num * num) + SHARED_SIGMA_M * SHARED_SIGMA_M) as f32;
            cell.num = 1;
        }
        cell.drops = u8::from(self.is_drop);
        (cell.standing, cell.top, cell.overhang) = (self.standing, self.top as f32, self.overhang as f32);
        cell
    }
}

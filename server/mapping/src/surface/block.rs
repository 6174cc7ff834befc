//! Voxels in blocks: distance and weight of all, colours where a camera gave them.

use super::params::{LOOKS_TO_CARVE, SurfaceParams};

/// Voxels of a block.
pub(super) const VOXELS: usize = 512;
/// What the truncation distance is stored as. The smallest step is 2.4 um at 8 cm: far below what means err by.
pub(super) const ONE: f32 = 32767.0;
/// What a weight of 1 is stored as, so that parts of a look count.
pub(super) const UNIT: f32 = 256.0;
/// What a step of colour is stored as: means of 255 looks do not get stuck on whole steps.
const COLOR_UNIT: f32 = 256.0;

/// `8 x 8 x 8` voxels, one array a channel so that loops over them become vector instructions. Place in each:
/// `(z * 8 + y) * 8 + x`.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceBlock {
    /// Signed distance to the surface, of the truncation: `-ONE` to `ONE`, negative behind the surface.
    pub(super) distance: [i16; VOXELS],
    /// Weight in parts of `UNIT`; 0: nothing is known.
    pub(super) weight: [u16; VOXELS],
    /// Red, green, blue in parts of a step, and 1 more; 0: there is no colour.
    pub(super) color: Option<Box<Colors>>,
}

/// Three channels.
pub(super) type Colors = [[u16; VOXELS]; 3];

impl SurfaceBlock {
    /// Nothing known.
    pub(super) fn unknown() -> Self {
        Self { distance: [0; VOXELS], weight: [0; VOXELS], color: None }
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.color.as_ref().map_or(0, |_| size_of::<Colors>())
    }

    /// Whether it holds anything behind a surface.
    pub(super) fn has_inside(&self) -> bool {
        self.distance.iter().fold(0, |all, d| all | d) < 0
    }

    /// Colour of a voxel, 0 to 255; none if it has none.
    pub(super) fn color_at(&self, slot: usize) -> Option<[f32; 3]> {
        let color = self.color.as_ref()?;
        let stored = [color[0][slot], color[1][slot], color[2][slot]];
        (stored[0] > 0).then(|| stored.map(from_color))
    }

    /// Folds an observation into a voxel: `distance` of the truncation, -1 to 1; `weight` above 0.
    pub(super) fn fold(&mut self, slot: usize, seen: &Observation, max_weight: f32) {
        let (old, known) = (f32::from(self.distance[slot]), f32::from(self.weight[slot]));
        let sum = known + seen.weight * UNIT;
        self.distance[slot] = round_i16((old * known + seen.distance * ONE * seen.weight * UNIT) / sum);
        self.weight[slot] = round_u16(sum.min(max_weight * UNIT)).max(1);
        if let Some(color) = seen.color {
            let share = seen.weight * UNIT / sum;
            let channels = self.color.get_or_insert_with(|| Box::new([[0; VOXELS]; 3]));
            for (channel, value) in channels.iter_mut().zip(color) {
                let old = channel[slot];
                let mean = if old == 0 { value } else { from_color(old) + (value - from_color(old)) * share };
                channel[slot] = to_color(mean);
            }
        }
    }

    /// Takes the weight of so many looks through a voxel that lies behind a surface; what has none left is free.
    pub(super) fn carve(&mut self, slot: usize, looks: f32, max_weight: f32) {
        let left = f32::from(self.weight[slot]) - looks * loss(max_weight);
        if left > 0.0 {
            self.weight[slot] = round_u16(left).max(1);
        } else {
            (self.distance[slot], self.weight[slot]) = (ONE as i16, UNIT as u16);
        }
    }

    /// A voxel as it would be observed; none if nothing is known of it.
    pub(super) fn observation(&self, slot: usize) -> Option<Observation> {
        let weight = f32::from(self.weight[slot]) / UNIT;
        let distance = f32::from(self.distance[slot]) / ONE;
        (weight > 0.0).then(|| Observation { distance, weight, color: self.color_at(slot) })
    }

    /// Lays another block over this one, by weight.
    pub(super) fn merge(&mut self, other: &Self, params: &SurfaceParams) {
        for slot in 0..VOXELS {
            if let Some(seen) = other.observation(slot) {
                self.fold(slot, &seen, params.max_weight);
            }
        }
    }
}

/// What is seen of a voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observation {
    /// Of the truncation, -1 to 1.
    pub(super) distance: f32,
    /// Looks.
    pub(super) weight: f32,
    /// 0 to 255.
    pub(super) color: Option<[f32; 3]>,
}

/// What a look through a voxel takes of its weight, as stored.
pub(super) fn loss(max_weight: f32) -> f32 {
    (max_weight * UNIT / LOOKS_TO_CARVE).ceil()
}

/// Adding this leaves a number of less than `2^22` in the lowest bits, rounded: a conversion that becomes a vector instruction,
/// unlike `as`, which asks for each number whether it fits.
const SHIFT: f32 = 12_582_912.0;

/// To the nearest whole number, halves to the even one; of less than `2^22`.
#[inline(always)]
pub(super) fn round_i32(v: f32) -> i32 {
    (v + SHIFT).to_bits().wrapping_sub(SHIFT.to_bits()) as i32
}

#[inline(always)]
pub(super) fn round_i16(v: f32) -> i16 {
    round_i32(v) as i16
}

#[inline(always)]
pub(super) fn round_u16(v: f32) -> u16 {
    round_i32(v) as u16
}

#[inline(always)]
pub(super) fn to_color(v: f32) -> u16 {
    round_u16(v * COLOR_UNIT) + 1
}

#[inline(always)]
pub(super) fn from_color(v: u16) -> f32 {
    (f32::from(v) - 1.0) * (1.0 / COLOR_UNIT)
}

//! Where the beams of a scan passed, and at which heights.

use super::HeightParams;
use super::bits::Bits;
use super::tile::BLOCK;
use crate::ground::{Ground, Place};
use nalgebra::{Point2, Point3};
use percept_geometry::GridGeometry;
use std::f32::consts::{PI, TAU};

/// Slopes of beams, from 45 degrees down to 45 degrees up, in so many bins: some 0.4 degrees, the distance of a lidar's rings.
/// Steeper beams end or rise out of reach near the sensor.
const SLOPES: usize = 256;
/// A beam this far under the ground is over none, metres.
const UNDER_M: f64 = 0.2;
/// Heights along beams are counted in so small a part of a bin: a tenth of a millimetre at most for bins of 0.4 m.
const FRACTION: i32 = 4096;

/// The beams of a scan by direction. Of those that are much alike the shortest counts.
pub(super) struct Beams {
    num_columns: usize,
    /// Column by column, bin by bin: how far it went, horizontally, metres (0 for no beam), and its slope, rise over run.
    beams: Vec<(f32, f32)>,
}

/// A square window of blocks around a sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Its first block's column and row.
    pub(super) min: (i32, i32),
    /// Blocks along an edge.
    pub(super) width: usize,
}

impl Beams {
    /// Room for beams of a range (m).
    pub(super) fn new(params: &HeightParams, range: f64) -> Self {
        // As many columns as blocks on the circle, so that none is skipped.
        let around = f64::from(TAU) * range / (f64::from(BLOCK) * params.resolution_m);
        let num_columns = around.ceil().max(90.0) as usize;
        Self { num_columns, beams: vec![(0.0, 0.0); num_columns * SLOPES] }
    }

    /// A beam that went so far, and rose by `rise` (m) on its way.
    pub(super) fn add(&mut self, place: &Place, rise: f64) {
        let slope = rise as f32 / place.range;
        if !(slope.abs() < 1.0 && place.range.is_finite()) {
            return;
        }
        let column = ((place.azimuth + PI) / TAU * self.num_columns as f32) as usize;
        let bin = ((slope + 1.0) * (0.5 * SLOPES as f32)) as usize;
        let beam = &mut self.beams[column.min(self.num_columns - 1) * SLOPES + bin.min(SLOPES - 1)];
        if beam.0 == 0.0 || place.range < beam.0 {
            *beam = (place.range, slope);
        }
    }

    /// Heights at which beams passed, and that of the ground (m), row-major over the window: up to a block before where they
    /// ended, and no higher than the robot's clearance.
    pub(super) fn passed(
        &self,
        params: &HeightParams,
        sensor: &Point3<f64>,
        ground: &Ground,
        range: f64,
        window: Window,
    ) -> Vec<(Bits, f32)> {
        let block = f64::from(BLOCK) * params.resolution_m;
        let mut out = vec![(Bits::NONE, 0.0); window.width * window.width];
        let blocks = GridGeometry::new(block, Point2::origin());
        let steps = (range / block).ceil() as usize;
        let (mut at, mut heights) = (vec![usize::MAX; steps], vec![0.0; steps]);
        let (mut lowest, mut bits) = (vec![0; steps], vec![0u32; steps]);
        // Counted from a whole turn of bins near the sensor, in fractions of a bin, so that rounding down is shifting.
        let turn = f64::from(u32::BITS) * Bits::bin_m(params);
        let zero = (sensor.z / turn).floor() * turn;
        let fixed = |z: f64| (z / Bits::bin_m(params) * f64::from(FRACTION)) as i32;
        let (from, span) = (fixed(sensor.z - zero), fixed(params.clearance_m + UNDER_M) as u32);
        for column in 0..self.num_columns {
            let beams = &self.beams[column * SLOPES..(column + 1) * SLOPES];
            let longest = beams.iter().fold(0.0, |most: f32, beam| most.max(beam.0));
            let last = steps_before(longest, block as f32).min(steps);
            let azimuth = f64::from((column as f32 + 0.5) / self.num_columns as f32 * TAU - PI);
            let (sin, cos) = azimuth.sin_cos();
            for step in 0..last {
                let r = (step as f64 + 0.5) * block;
                let p = Point2::new(sensor.x + cos * r, sensor.y + sin * r);
                let index = |i: i32, min: i32| usize::try_from(i64::from(i) - i64::from(min)).ok();
                let (x, y) =
                    blocks.cell(&p).map_or((None, None), |c| (index(c.x, window.min.0), index(c.y, window.min.1)));
                at[step] = match (x, y) {
                    (Some(x), Some(y)) if x < window.width && y < window.width => y * window.width + x,
                    _ => usize::MAX,
                };
                heights[step] = ground.at(azimuth, r).z_at(r);
                lowest[step] = fixed(heights[step] - UNDER_M - zero);
            }
            bits[..last].fill(0);
            for (far, slope) in beams.iter().filter(|beam| beam.0 > 0.0) {
                let end = steps_before(*far, block as f32).min(last);
                let rise = fixed(f64::from(*slope) * block);
                let mut z = from.wrapping_add(rise / 2);
                for (bits, lowest) in bits[..end].iter_mut().zip(&lowest) {
                    let is_over = z.wrapping_sub(*lowest) as u32 <= span;
                    *bits |= u32::from(is_over) << ((z >> FRACTION.trailing_zeros()) & 31);
                    z = z.wrapping_add(rise);
                }
            }
            for step in (0..last).filter(|step| bits[*step] != 0) {
                if let Some(passed) = out.get_mut(at[step]) {
                    *passed = (passed.0.joined(Bits(bits[step])), heights[step] as f32);
                }
            }
        }
        out
    }
}

/// How many blocks a beam of a range passed whole before the one it ended in.
fn steps_before(range: f32, block: f32) -> usize {
    (range / block - 1.0).max(0.0) as usize
}

//! What a beam says of the voxels around its end: layer after layer across its main axis.

use super::block::round_i32;
use super::touched::floor;
use crate::blocks::{BLOCK, BlockKey};
use nalgebra::{Point3, Vector3};
use percept_geometry::by_processor;

/// Layers that are worked on together.
const LANES: usize = 16;
/// Layers that a beam crosses around its end, at most: the longest truncation, 16 voxels, and one more to either side.
const MOST_LAYERS: usize = 3 * LANES;
/// Blocks along an edge of the neighbourhood of an end, of which it lies in the fourth: the same reach.
pub(super) const NEAR: i32 = 8;

/// The voxels around the end of a beam. Where the beam crosses the plane through the centres of a layer of voxels, it speaks for
/// the four around, bilinearly.
pub(super) struct Around {
    /// First block of the neighbourhood.
    pub(super) first: BlockKey,
    layers: usize,
    lanes: [Lanes; MOST_LAYERS / LANES],
}

/// Of some layers, by corner of the four.
#[derive(Clone, Copy)]
struct Lanes {
    /// Block of the neighbourhood and slot: see [`place`].
    at: [[u32; LANES]; 4],
    /// Of the truncation, before the end.
    distance: [[f32; LANES]; 4],
    weight: [[f32; LANES]; 4],
}

/// Voxels are numbered within this, so that none next to them falls out of an `i32`.
const MOST_VOXELS: f64 = (1u64 << 30) as f64;

impl Around {
    pub(super) const NOTHING: Self = Self {
        first: (0, 0, 0),
        layers: 0,
        lanes: [Lanes { at: [[0; LANES]; 4], distance: [[0.0; LANES]; 4], weight: [[0.0; LANES]; 4] };
            MOST_LAYERS / LANES],
    };

    /// Follows a beam to its end. All lengths in voxels; the direction is of length 1. Nothing is around an end for which voxels have
    /// no number.
    pub(super) fn follow(&mut self, end: &Point3<f64>, direction: &Vector3<f64>, range: f64, truncation: f64) {
        self.layers = 0;
        // Not a number is not below.
        if !end.iter().all(|v| v.abs() < MOST_VOXELS) {
            return;
        }
        let first = end.map(|v| (floor(v) >> 3) - (NEAR / 2 - 1));
        self.first = (first.x, first.y, first.z);
        // From the neighbourhood's corner, centres at whole numbers: so near that an `f32` errs by a millionth of a voxel.
        let local = Vector3::from_fn(|i, _| (end[i] - f64::from(first[i] * BLOCK) - 0.5) as f32);
        let main = direction.iamax();
        let axes = [main, (main + 1) % 3, (main + 2) % 3];
        let (end, direction) = (axes.map(|a| local[a]), axes.map(|a| direction[a] as f32));
        let reach = (truncation + 1.0) as f32;
        let (from, to) = (end[0] - direction[0] * reach.min(range as f32), end[0] + direction[0] * reach);
        let (low, high) = (-floor(f64::from(-from.min(to))), floor(f64::from(from.max(to))));
        self.layers = usize::try_from(high - low + 1).unwrap_or(0).min(MOST_LAYERS);
        let lanes = &mut self.lanes[..self.layers.div_ceil(LANES)];
        around_end(end, direction, low as f32, truncation as f32, axes.map(|a| 3 * a as u32), lanes);
    }

    /// Shows place, distance and weight of each voxel that the beam speaks for.
    #[inline(always)]
    pub(super) fn visit(&self, mut visit: impl FnMut(u32, f32, f32)) {
        for layer in 0..self.layers {
            let (lanes, i) = (&self.lanes[layer / LANES], layer % LANES);
            for corner in 0..4 {
                let weight = lanes.weight[corner][i];
                if weight > 0.0 {
                    visit(lanes.at[corner][i], lanes.distance[corner][i], weight);
                }
            }
        }
    }
}

/// What a voxel's number along an axis, of whose three bits these are the lowest, adds to its place: nine bits for the block in the
/// neighbourhood, nine for the slot.
#[inline(always)]
fn place(at: i32, shift: u32) -> u32 {
    ((at as u32 >> 3 & 7) << 9 | at as u32 & 7) << shift
}

/// What a beam counts at so much of the truncation distance before its return: less behind it, from a voxel on, down to nothing. Beams
/// that graze what is round pass far behind its surface beside few that pass before it, and would push it outward. Source: the
/// linear weight of Bylow et al., "Real-time camera tracking and 3D reconstruction using signed distance functions", 2013.
#[inline(always)]
fn behind(distance: f32, per_truncation: f32) -> f32 {
    let share = (1.0 + distance) * (1.0 / (1.0 - per_truncation));
    if share < 1.0 { share } else { 1.0 }
}

by_processor! {
    [avx512]
    /// What is around an end, in layers from `low` on. Axes are the main one and those after it; `shifts` are those of their places.
    fn around_end(
        end: [f32; 3],
        direction: [f32; 3],
        low: f32,
        truncation: f32,
        shifts: [u32; 3],
        out: &mut [Lanes],
    ) {
        let (per_layer, per_truncation) = (1.0 / direction[0], 1.0 / truncation);
        for (chunk, lanes) in out.iter_mut().enumerate() {
            for i in 0..LANES {
                let layer = low + (LANES * chunk + i) as f32;
                // Beyond the end, along the beam.
                let along = (layer - end[0]) * per_layer;
                let (b, c) = (end[1] + direction[1] * along, end[2] + direction[2] * along);
                // The centre before the crossing; of a crossing at a centre it may be the one before that, which makes no difference.
                let (voxel_b, voxel_c) = (round_i32(b - 0.5), round_i32(c - 0.5));
                let (beyond_b, beyond_c) = (b - voxel_b as f32, c - voxel_c as f32);
                let here = place(round_i32(layer), shifts[0]);
                for corner in 0..4 {
                    let (step_b, step_c) = ((corner & 1) as i32, (corner >> 1) as i32);
                    // From the crossing to the voxel's centre.
                    let (off_b, off_c) = (step_b as f32 - beyond_b, step_c as f32 - beyond_c);
                    let distance = -(along + off_b * direction[1] + off_c * direction[2]) * per_truncation;
                    let weight = (1.0 - off_b.abs()) * (1.0 - off_c.abs()) * behind(distance, per_truncation);
                    let (at_b, at_c) = (place(voxel_b + step_b, shifts[1]), place(voxel_c + step_c, shifts[2]));
                    lanes.at[corner][i] = here | at_b | at_c;
                    lanes.distance[corner][i] = distance;
                    lanes.weight[corner][i] = if distance.abs() <= 1.0 { weight } else { 0.0 };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Voxel by voxel of the neighbourhood: what a beam says of it where it crosses the plane of its layer.
    fn plainly(
        end: &Point3<f64>,
        direction: &Vector3<f64>,
        range: f64,
        truncation: f64,
    ) -> BTreeMap<[i32; 3], [f64; 2]> {
        let main = direction.iamax();
        let corner = end.map(|v| v.floor() as i32 - 20);
        let mut out = BTreeMap::new();
        for i in 0..41 * 41 * 41 {
            let voxel = [corner.x + i % 41, corner.y + i / 41 % 41, corner.z + i / 41 / 41];
            let center = Point3::from(voxel.map(|v| f64::from(v) + 0.5));
            let along = (center[main] - end[main]) / direction[main];
            let off = center - (end + direction * along);
            let distance = -(center - end).dot(direction) / truncation;
            let aside: f64 = (0..3).filter(|a| *a != main).map(|a| (1.0 - off[a].abs()).max(0.0)).product();
            let weight = aside * ((1.0 + distance) / (1.0 - 1.0 / truncation)).min(1.0);
            let is_on_beam = along >= -range && along.abs() <= truncation + 1.0;
            if weight > 0.0 && distance.abs() <= 1.0 && is_on_beam {
                out.insert(voxel, [distance, weight]);
            }
        }
        out
    }

    #[test]
    fn a_beam_speaks_for_the_voxels_around_its_end_as_each_by_itself_has_it() {
        let spread = |i: u32, m: u32| f64::from(i.wrapping_mul(m) >> 8) / f64::from(1u32 << 24) - 0.5;
        let (mut around, mut num) = (Around::NOTHING, 0);
        for i in 1..120u32 {
            let end = Point3::new(spread(i, 2_654_435_761), spread(i, 40_503), spread(i, 97_531))
                * [9.0, 1e4][i as usize % 2];
            let direction =
                Vector3::new(spread(i, 2_246_822_519), spread(i, 3_266_489_917), spread(i, 668_265_263)).normalize();
            let truncation = [2.0, 3.0, 7.3, 16.0][i as usize / 2 % 4];
            let range = if i % 7 == 0 { 2.2 } else { 60.0 };
            around.follow(&end, &direction, range, truncation);
            let mut plain = plainly(&end, &direction, range, truncation);
            let first = [around.first.0, around.first.1, around.first.2];
            around.visit(|at, distance, weight| {
                let voxel = std::array::from_fn(|a| {
                    8 * (first[a] + (at >> (9 + 3 * a) & 7) as i32) + (at >> (3 * a) & 7) as i32
                });
                let [d, w] = plain.remove(&voxel).unwrap_or([f64::from(distance), 0.0]);
                num += 1;
                assert!((f64::from(distance) - d).abs() < 1e-5, "beam {i}: {distance} {d}");
                // What lies on the border of what counts may or may not.
                let is_on_border = (distance.abs() - 1.0).abs() < 1e-5;
                assert!((f64::from(weight) - w).abs() < 1e-5 || is_on_border, "beam {i}: {weight} {w}");
            });
            let left_out = |[distance, weight]: &[f64; 2]| *weight > 1e-5 && distance.abs() < 1.0 - 1e-5;
            assert!(!plain.values().any(left_out), "beam {i}: {plain:?}");
        }
        assert!(num > 4_000, "{num}");
    }

    #[test]
    fn nothing_is_around_an_end_without_a_number() {
        let mut around = Around::NOTHING;
        for far in [2e9, f64::NAN, f64::INFINITY] {
            around.follow(&Point3::new(0.0, far, 0.0), &Vector3::y(), 40.0, 3.0);
            around.visit(|_, _, _| panic!("something at {far}"));
        }
    }
}

//! A depth image into one block of voxels: the loop that most of the time goes into.

use super::block::{ONE, SurfaceBlock, UNIT, VOXELS, from_color, round_i16, round_i32, round_u16, to_color};
use percept_geometry::by_processor;

/// An image, and how it is taken in. Lengths in metres.
pub(super) struct View<'a> {
    /// `H x W`.
    pub(super) depth: &'a [f32],
    /// `H x W`: the least depth of each pixel and those around it. Only what all of them look past was seen through: at the border of
    /// what stands before something, half a pixel decides what a voxel's pixel sees.
    pub(super) shortest: &'a [f32],
    /// `H x W x 3`, of the same camera.
    pub(super) color: Option<&'a [u8]>,
    pub(super) width: f32,
    pub(super) height: f32,
    pub(super) focal: [f32; 2],
    pub(super) center: [f32; 2],
    pub(super) near: f32,
    pub(super) far: f32,
    pub(super) truncation: f32,
    /// How far behind a voxel a beam has to end to have seen through it: at the camera, and more for each metre. Infinite if
    /// nothing is carved.
    pub(super) margin: [f32; 2],
    /// As stored.
    pub(super) max_weight: f32,
    /// As stored.
    pub(super) loss: f32,
}

/// A block in the camera's frame.
pub(super) struct Placed {
    /// Centre of its first voxel, metres.
    pub(super) first: [f32; 3],
    /// From a voxel to the next along each of the block's axes, metres.
    pub(super) steps: [[f32; 3]; 3],
}

/// Voxels that are worked on together: a layer of a block.
const LAYER: usize = 64;

by_processor! {
    [avx512]
    /// Folds what an image shows of a block into it. Source: Curless and Levoy, "A volumetric method for building complex
    /// models from range images", 1996; the projective distance along the optical axis of Newcombe et al., "KinectFusion",
    /// 2011, with a weight of 1 a look.
    pub(super) fn integrate_block(view: &View<'_>, placed: &Placed, block: &mut SurfaceBlock) {
        let columns = view.width as i32;
        for z in 0..VOXELS / LAYER {
            let (mut at, mut depths, mut sdfs) = ([u32::MAX; LAYER], [0.0f32; LAYER], [0.0f32; LAYER]);
            let from = |axis: usize| placed.first[axis] + placed.steps[2][axis] * z as f32;
            let (x0, y0, z0) = (from(0), from(1), from(2));
            let [[ax, ay, az], [bx, by, bz], _] = placed.steps;
            for i in 0..LAYER {
                let (a, b) = ((i % 8) as f32, (i / 8) as f32);
                let (x, y, z) = (x0 + ax * a + bx * b, y0 + ay * a + by * b, z0 + az * a + bz * b);
                let inverse = 1.0 / z;
                // Pixels have their centres at whole numbers.
                let u = x * inverse * view.focal[0] + view.center[0];
                let v = y * inverse * view.focal[1] + view.center[1];
                let is_in_depth = (z > 1e-3) & (z <= view.far);
                let is_in_image = (u > -0.5) & (u < view.width - 0.5) & (v > -0.5) & (v < view.height - 0.5);
                let index = round_i32(v).wrapping_mul(columns).wrapping_add(round_i32(u));
                at[i] = if is_in_depth & is_in_image { index as u32 } else { u32::MAX };
                sdfs[i] = z;
            }
            for (depth, at) in depths.iter_mut().zip(&at) {
                *depth = view.depth.get(*at as usize).copied().unwrap_or(0.0);
            }
            let distance: &mut [i16; LAYER] = match block.distance[z * LAYER..].first_chunk_mut() {
                Some(layer) => layer,
                None => return,
            };
            let weight: &mut [u16; LAYER] = match block.weight[z * LAYER..].first_chunk_mut() {
                Some(layer) => layer,
                None => return,
            };
            let mut may_be_through = 0u32;
            for i in 0..LAYER {
                let is_behind = (distance[i] < 0) & (depths[i] - sdfs[i] > view.margin[0] + view.margin[1] * sdfs[i]);
                may_be_through |= u32::from(is_behind);
            }
            let mut shortest = depths;
            if may_be_through != 0 {
                for (shortest, at) in shortest.iter_mut().zip(&at) {
                    *shortest = view.shortest.get(*at as usize).copied().unwrap_or(0.0);
                }
            }
            let per_truncation = 1.0 / view.truncation;
            let mut shares = [0.0f32; LAYER];
            let mut is_colored = 0u32;
            for i in 0..LAYER {
                let (depth, z) = (depths[i], sdfs[i]);
                let sdf = depth - z;
                let is_seen = (depth >= view.near) & (sdf >= -view.truncation);
                let seen = (sdf * per_truncation).min(1.0) * ONE;
                let (old, known) = (f32::from(distance[i]), f32::from(weight[i]));
                let sum = known + UNIT;
                let mean = (old * known + seen * UNIT) / sum;
                let is_through = (old < 0.0) & (shortest[i] - z > view.margin[0] + view.margin[1] * z);
                let left = known - view.loss;
                let (carved, left) = if left > 0.0 { (old, left) } else { (ONE, UNIT) };
                let (next, heavier) = if is_through { (carved, left) } else { (mean, sum.min(view.max_weight)) };
                distance[i] = if is_seen { round_i16(next) } else { distance[i] };
                weight[i] = if is_seen { round_u16(heavier) } else { weight[i] };
                let takes_color = is_seen & (sdf < view.truncation);
                shares[i] = if takes_color { UNIT / sum } else { 0.0 };
                is_colored |= u32::from(takes_color);
            }
            let Some(image) = view.color.filter(|_| is_colored != 0) else { continue };
            let colors = block.color.get_or_insert_with(|| Box::new([[0; VOXELS]; 3]));
            let mut packed = [0u32; LAYER];
            for (packed, at) in packed.iter_mut().zip(&at) {
                if let Some([r, g, b]) = (*at as usize).checked_mul(3).and_then(|k| image.get(k..k + 3)) {
                    *packed = u32::from_le_bytes([*r, *g, *b, 0]);
                }
            }
            for (shift, channel) in [0, 8, 16].into_iter().zip(colors.iter_mut()) {
                let Some(channel) = channel[z * LAYER..].first_chunk_mut::<LAYER>() else { return };
                for i in 0..LAYER {
                    let (old, seen) = (from_color(channel[i]), (packed[i] >> shift & 0xff) as i32 as f32);
                    let mean = if channel[i] == 0 { seen } else { old + (seen - old) * shares[i] };
                    channel[i] = if shares[i] > 0.0 { to_color(mean) } else { channel[i] };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::SurfaceParams;
    use super::super::block::loss;
    use super::*;

    /// As [`integrate_block`] has it, voxel by voxel.
    fn plainly(view: &View<'_>, placed: &Placed, block: &mut SurfaceBlock) {
        for slot in 0..VOXELS {
            let index = [slot % 8, slot / 8 % 8, slot / 64].map(|i| i as f64);
            let at = |axis: usize| {
                f64::from(placed.first[axis]) + (0..3).map(|k| f64::from(placed.steps[k][axis]) * index[k]).sum::<f64>()
            };
            let (x, y, z) = (at(0), at(1), at(2));
            let pixel = |p: f64, i: usize| (p / z * f64::from(view.focal[i]) + f64::from(view.center[i])).round();
            let (u, v) = (pixel(x, 0), pixel(y, 1));
            let is_in = u >= 0.0 && v >= 0.0 && u < f64::from(view.width) && v < f64::from(view.height);
            if z <= 1e-3 || z > f64::from(view.far) || !is_in {
                continue;
            }
            let pixel = v as usize * view.width as usize + u as usize;
            let (depth, truncation) = (f64::from(view.depth[pixel]), f64::from(view.truncation));
            let sdf = depth - z;
            if depth < f64::from(view.near) || sdf < -truncation {
                continue;
            }
            let shortest = f64::from(view.shortest[pixel]) - z;
            if block.distance[slot] < 0 && shortest > f64::from(view.margin[0]) + f64::from(view.margin[1]) * z {
                block.carve(slot, 1.0, view.max_weight / UNIT);
                continue;
            }
            let color = view.color.filter(|_| sdf < truncation).map(|c| [0, 1, 2].map(|k| f32::from(c[3 * pixel + k])));
            let distance = (sdf / truncation).min(1.0) as f32;
            let seen = super::super::block::Observation { distance, weight: 1.0, color };
            block.fold(slot, &seen, view.max_weight / UNIT);
        }
    }

    #[test]
    fn layers_at_once_are_voxels_one_by_one() {
        let (width, height) = (64usize, 48usize);
        let mut state = 7u32;
        let mut spread = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24)
        };
        let max_weight = SurfaceParams::default().max_weight;
        let (mut ours, mut plain) = (SurfaceBlock::unknown(), SurfaceBlock::unknown());
        let (mut differ, mut known) = (0, 0);
        for round in 0..60 {
            // Now and then far behind, so that what is there is carved.
            let wall = if round % 9 == 8 { 2.5 } else { 1.1 + 0.1 * spread() };
            let depth: Vec<f32> =
                (0..width * height).map(|i| if i % 29 == 0 { 0.0 } else { (wall + 0.05 * spread()) as f32 }).collect();
            let color: Vec<u8> = (0..3 * width * height).map(|_| (255.0 * spread()) as u8).collect();
            let shortest: Vec<f32> = depth.iter().enumerate().map(|(i, d)| if i % 3 == 0 { 0.0 } else { *d }).collect();
            let view = View {
                depth: &depth,
                shortest: &shortest,
                color: Some(&color),
                width: width as f32,
                height: height as f32,
                focal: [50.0, 52.0],
                center: [31.2, 24.1],
                near: 0.1,
                far: 3.0,
                truncation: 0.16,
                margin: [0.24, 0.05],
                max_weight: max_weight * UNIT,
                loss: loss(max_weight),
            };
            let first = [-0.4 + 0.5 * spread() as f32, -0.3 + 0.3 * spread() as f32, 0.9 + 0.2 * spread() as f32];
            let placed = Placed { first, steps: [[0.03, 0.02, 0.01], [-0.02, 0.03, 0.005], [-0.01, -0.01, 0.035]] };
            integrate_block(&view, &placed, &mut ours);
            plainly(&view, &placed, &mut plain);
            for slot in 0..VOXELS {
                let near = |a: u16, b: u16, by: u16| a.abs_diff(b) <= by;
                let channels = |b: &SurfaceBlock, k: usize| b.color.as_ref().map_or(0, |c| c[k][slot]);
                let same = ours.distance[slot].abs_diff(plain.distance[slot]) <= 20
                    && near(ours.weight[slot], plain.weight[slot], 1)
                    && (0..3).all(|k| near(channels(&ours, k), channels(&plain, k), 20));
                differ += usize::from(!same);
                known += usize::from(ours.weight[slot] > 0);
            }
            // Where a voxel's centre falls between pixels, they may take either.
            plain = ours.clone();
        }
        assert!(known > 15_000 && differ * 500 < known, "{differ} of {known}");
    }
}

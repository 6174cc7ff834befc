//! Thinning of sweeps that noise does not steer.
//!
//! A grid that keeps one point of each cell prefers those that err: noise carries some points of a wall into the cells
//! before and behind it, and each of these cells counts as much as one that lies full on the wall. That shifts walls by as
//! much as half their noise, differently with each pose, and odometry drifts with it (in simulated rooms by degrees a
//! minute). So here cells only tell how many points to keep of a block of cells, which is larger than the noise; which of
//! its points, their order tells.

use nalgebra::Point3;

/// Cells along the edge of a block: 64 cells, a bit each.
const EDGE: i32 = 4;

/// Cells that lie together.
#[derive(Debug, Clone, Copy)]
struct Block {
    key: u64,
    /// Those with points.
    cells: u64,
    points: u32,
    /// Share of its points that is kept, once all are counted.
    share: f32,
    /// What of a point is left over from those before, 0 to 1.
    carry: f32,
}

/// Blocks of one grid, and the block of each point. Open addressing in a table that is kept between calls.
#[derive(Debug, Default)]
struct Blocks {
    table: Vec<u32>,
    blocks: Vec<Block>,
    of_point: Vec<u32>,
}

impl Blocks {
    fn clear(&mut self, num_points: usize) {
        self.table.clear();
        self.table.resize((num_points * 2).next_power_of_two().max(1024), u32::MAX);
        self.blocks.clear();
        self.of_point.clear();
    }

    /// Counts a point in its cell.
    #[inline(always)]
    fn add(&mut self, cell: [i32; 3]) {
        // 21 bits an axis: coordinates wrap far beyond a lidar's range.
        let [x, y, z] = cell.map(|c| (c.div_euclid(EDGE) as u64) & 0x1f_ffff);
        let key = x << 42 | y << 21 | z;
        let [x, y, z] = cell.map(|c| c.rem_euclid(EDGE));
        let bit = 1u64 << ((x * EDGE + y) * EDGE + z);
        // Most points lie in the block of the one before.
        let number = match self.of_point.last() {
            Some(&last) if self.blocks[last as usize].key == key => last,
            _ => self.find(key),
        };
        let block = &mut self.blocks[number as usize];
        block.cells |= bit;
        block.points += 1;
        self.of_point.push(number);
    }

    #[inline(never)]
    fn find(&mut self, key: u64) -> u32 {
        let mask = self.table.len() - 1;
        let mut slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20) as usize & mask;
        loop {
            match self.table[slot] {
                u32::MAX => {
                    self.table[slot] = self.blocks.len() as u32;
                    self.blocks.push(Block { key, cells: 0, points: 0, share: 0.0, carry: 0.5 });
                    return self.table[slot];
                }
                number if self.blocks[number as usize].key == key => return number,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    /// All points are counted.
    fn settle(&mut self) {
        for block in &mut self.blocks {
            block.share = block.cells.count_ones() as f32 / block.points as f32;
        }
    }

    fn of(&mut self, k: usize) -> &mut Block {
        &mut self.blocks[self.of_point[k] as usize]
    }
}

/// The largest integer that is not above `x`; `f32::floor` is a call on plain x86-64.
#[inline]
fn floor(x: f32) -> i32 {
    let near = x as i32;
    near.saturating_sub(i32::from((near as f32) > x))
}

/// Thins clouds; holds its tables between calls.
#[derive(Debug, Default)]
pub(crate) struct Thinner {
    grids: [Blocks; 2],
}

impl Thinner {
    /// Indices of about as many points as there are cells of `size` metres with points, in input order: of each block of
    /// cells as many as it has such cells, evenly by their order. The points have to be finite.
    pub(crate) fn even(&mut self, points: &[Point3<f32>], indices: &[u32], size: f64) -> Vec<u32> {
        // Noise beyond the border of one grid's block lies in the middle of one of the other's.
        let [own, other] = &mut self.grids;
        own.clear(indices.len());
        other.clear(indices.len());
        let inverse = (1.0 / size) as f32;
        for &i in indices {
            let p = points[i as usize];
            let cell = [p.x, p.y, p.z].map(|x| floor(x * inverse));
            own.add(cell);
            other.add(cell.map(|c| c.wrapping_add(EDGE / 2)));
        }
        own.settle();
        other.settle();
        let mut out = Vec::with_capacity(indices.len() / 2);
        for (k, &i) in indices.iter().enumerate() {
            let beside = other.of(k).share;
            let block = own.of(k);
            block.carry += block.share.min(beside);
            if block.carry >= 1.0 {
                block.carry -= 1.0;
                out.push(i);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Points of a wall of 4 by 2 m at `x`, with noise of 2 cm (a sum of twelve even ones), in no order.
    fn wall(x: f32, num: u32) -> Vec<Point3<f32>> {
        let mut state = 7u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        let mut noise = || (0..12).map(|_| next()).sum::<f32>() - 6.0;
        (0..num)
            .map(|i| {
                let (u, v) = ((i as f32 * 0.618_034).fract(), (i as f32 * 0.754_878).fract());
                Point3::new(x + 0.02 * noise(), 4.0 * u, 2.0 * v)
            })
            .collect()
    }

    #[test]
    fn a_wall_stays_where_it_is_wherever_it_lies_in_the_grid() {
        let all: Vec<u32> = (0..20_000).collect();
        let (mut worst, mut worst_by_cells) = (0f32, 0f32);
        for k in 0..32 {
            let x = 3.0 + 0.01 * k as f32;
            let points = wall(x, 20_000);
            let off =
                |kept: &[u32]| (kept.iter().map(|&i| points[i as usize].x - x).sum::<f32>() / kept.len() as f32).abs();
            let kept = Thinner::default().even(&points, &all, 0.08);
            assert!((1000..3000).contains(&kept.len()), "{x}: {} points", kept.len());
            worst = worst.max(off(&kept));
            let mut cells = std::collections::HashSet::new();
            let cell = |i: &u32| points[*i as usize].coords.map(|c| (c / 0.08).floor() as i32);
            let first: Vec<u32> = all.iter().copied().filter(|i| cells.insert(cell(i))).collect();
            worst_by_cells = worst_by_cells.max(off(&first));
        }
        assert!(worst < 0.004 && worst_by_cells > 3.0 * worst, "{worst} {worst_by_cells}");
    }

    #[test]
    fn what_is_sparse_is_kept_whole() {
        let points: Vec<_> = (0..500).map(|i| Point3::new(i as f32, -0.5 * i as f32, 1.0)).collect();
        let all: Vec<u32> = (0..500).collect();
        assert_eq!(Thinner::default().even(&points, &all, 0.3), all);
    }

    proptest! {
        #[test]
        fn no_more_than_cells_and_in_order(
            points in prop::collection::vec((-1e3f32..1e3, -1e3f32..1e3, -2e9f32..2e9).prop_map(|(x, y, z)| Point3::new(x, y, z)), 1..200),
            size in 0.01..100.0f64,
        ) {
            let all: Vec<u32> = (0..points.len() as u32).collect();
            let kept = Thinner::default().even(&points, &all, size);
            let inverse = (1.0 / size) as f32;
            let cells: std::collections::HashSet<_> =
                points.iter().map(|p| p.coords.map(|c| (c * inverse).floor().to_bits())).collect();
            prop_assert!(!kept.is_empty() && kept.windows(2).all(|w| w[0] < w[1]) && kept.len() <= cells.len());
        }
    }
}

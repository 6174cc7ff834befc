//! Leaves near a leaf: looked for in the tree once for a block of leaves, then picked for each.

use super::super::kdtree::{Bounds, KdTree, LEAF, Leaf};
use super::super::near::MAX_LEAVES;

/// Leaves that are looked for together, and how many may be near them.
const BLOCK: usize = 8;
const MAX_NEARBY: usize = 256;
/// Leaves near a block are looked for up to a distance so many times larger (squared).
const BEYOND: f32 = 1.5;

/// Leaves near a leaf: boxes side by side.
pub(super) struct Around<const N: usize> {
    pub(super) len: usize,
    pub(super) leaves: [u32; N],
    pub(super) lo: [[f32; N]; 3],
    pub(super) hi: [[f32; N]; 3],
}

/// Leaves near a block of leaves, of which those near each of its leaves are picked.
pub(super) struct Nearby {
    /// None if it was not looked at, or has too many leaves near it.
    pub(super) block: Option<usize>,
    /// How near (squared distance of boxes) they are.
    pub(super) limit2: f32,
    pub(super) around: Around<MAX_NEARBY>,
}

impl Nearby {
    /// The leaves whose boxes are within the distance (squared) of a leaf's; false if they are too many.
    #[inline(always)]
    pub(super) fn gather(&mut self, tree: &KdTree, leaf: usize, limit2: f32, out: &mut Around<MAX_LEAVES>) -> bool {
        let block = leaf / BLOCK;
        if self.block != Some(block) || limit2 > self.limit2 {
            self.limit2 = limit2 * BEYOND;
            let leaves = block * BLOCK..((block + 1) * BLOCK).min(tree.num_leaves());
            let of = leaves.map(|leaf| tree.leaf_bounds(leaf)).reduce(|a, b| a.with(&b)).unwrap_or_default();
            self.block = tree.gather(&of, self.limit2, &mut self.around).then_some(block);
        }
        self.gather_about(tree, leaf, &tree.leaf_bounds(leaf), limit2, out)
    }

    /// The same about a box inside of a leaf's, without looking at the block anew.
    #[inline(always)]
    pub(super) fn gather_about(
        &self,
        tree: &KdTree,
        leaf: usize,
        of: &Bounds,
        limit2: f32,
        out: &mut Around<MAX_LEAVES>,
    ) -> bool {
        if self.block != Some(leaf / BLOCK) || limit2 > self.limit2 {
            return tree.gather(of, limit2, out);
        }
        out.len = 0;
        for from in (0..self.around.len).step_by(LEAF) {
            let mut near = self.around.near_of(from, of, limit2);
            while near != 0 {
                let j = from + (near.trailing_zeros() / 8) as usize % LEAF;
                near &= near - 1;
                if j >= self.around.len {
                    break;
                }
                if !out.push(self.around.leaves[j], &self.around.bounds(j)) {
                    return false;
                }
            }
        }
        true
    }
}

impl<const N: usize> Around<N> {
    pub(super) const NONE: Self = Self { len: 0, leaves: [0; N], lo: [[0.0; N]; 3], hi: [[0.0; N]; 3] };

    /// Takes a leaf; false if there is no room.
    #[inline(always)]
    pub(super) fn push(&mut self, leaf: u32, b: &Bounds) -> bool {
        if self.len == N {
            return false;
        }
        self.leaves[self.len] = leaf;
        for a in 0..3 {
            self.lo[a][self.len] = b.lo[a];
            self.hi[a][self.len] = b.hi[a];
        }
        self.len += 1;
        true
    }

    pub(super) fn bounds(&self, j: usize) -> Bounds {
        Bounds { lo: [0, 1, 2].map(|a| self.lo[a][j]), hi: [0, 1, 2].map(|a| self.hi[a][j]) }
    }

    /// Of the sixteen leaves from a place on a byte each, 1 if its box is within the distance (squared) of a box.
    #[inline(always)]
    fn near_of(&self, from: usize, of: &Bounds, limit2: f32) -> u128 {
        let mut sums = [0.0f32; LEAF];
        for a in 0..3 {
            let (lo, hi) = (&self.lo[a][from..from + LEAF], &self.hi[a][from..from + LEAF]);
            for i in 0..LEAF {
                let (below, above) = (lo[i] - of.hi[a], of.lo[a] - hi[i]);
                let side = if below > above { below } else { above };
                let side = if side > 0.0 { side } else { 0.0 };
                sums[i] += side * side;
            }
        }
        u128::from_le_bytes(sums.map(|s| u8::from(s <= limit2)))
    }

    /// For each point of a leaf the set of leaves whose box is within the distance (squared).
    #[inline(always)]
    pub(super) fn reached(&self, own: &Leaf, limit2: f32) -> [u64; LEAF] {
        debug_assert!(N <= 64);
        let mut out = [0u64; LEAF];
        for j in 0..self.len {
            let (lo, hi) = ([0, 1, 2].map(|a| self.lo[a][j]), [0, 1, 2].map(|a| self.hi[a][j]));
            for (i, out) in out.iter_mut().enumerate() {
                let side = |v: f32, a: usize| {
                    let (below, above) = (lo[a] - v, v - hi[a]);
                    let side = if below > above { below } else { above };
                    if side > 0.0 { side } else { 0.0 }
                };
                let (x, y, z) = (side(own.xs[i], 0), side(own.ys[i], 1), side(own.zs[i], 2));
                *out |= u64::from(x * x + y * y + z * z <= limit2) << j;
            }
        }
        out
    }
}

impl KdTree {
    /// The leaves whose boxes are within the distance (squared) of a box; false if they are too many.
    ///
    /// Gaps are rounded monotonically, like the distances of points: no leaf with a point within is missed.
    #[inline(always)]
    pub(super) fn gather<const N: usize>(&self, of: &Bounds, limit2: f32, around: &mut Around<N>) -> bool {
        let mut stack = [(0u32, 0u32, 0u32); 48];
        stack[0] = (0, 0, self.leaves.len() as u32);
        let mut depth = 1;
        around.len = 0;
        while depth > 0 {
            depth -= 1;
            let (node, leaf, leaves) = stack[depth];
            let b = &self.bounds[node as usize];
            let gap = |a: usize| (b.lo[a] - of.hi[a]).max(of.lo[a] - b.hi[a]).max(0.0);
            let (x, y, z) = (gap(0), gap(1), gap(2));
            if x * x + y * y + z * z > limit2 {
                continue;
            }
            if leaves > 1 {
                let left = leaves / 2;
                stack[depth] = (node + 2 * left, leaf + left, leaves - left);
                stack[depth + 1] = (node + 1, leaf, left);
                depth += 2;
                continue;
            }
            if !around.push(leaf, b) {
                return false;
            }
        }
        true
    }

    /// The box of a leaf: tight, as it is made of so few points.
    #[inline(always)]
    pub(super) fn leaf_bounds(&self, leaf: usize) -> Bounds {
        let l = &self.leaves[leaf];
        let n = self.num_points_of(leaf);
        let least = |v: &[f32; LEAF]| v[..n].iter().fold(f32::INFINITY, |m, &v| if v < m { v } else { m });
        let most = |v: &[f32; LEAF]| v[..n].iter().fold(f32::NEG_INFINITY, |m, &v| if v > m { v } else { m });
        Bounds { lo: [least(&l.xs), least(&l.ys), least(&l.zs)], hi: [most(&l.xs), most(&l.ys), most(&l.zs)] }
    }
}

impl Bounds {
    /// Squared distance of the two points of the boxes that are farthest apart, rounded like that of points.
    pub(super) fn farthest2(&self, other: &Self) -> f32 {
        let far = |a: usize| (self.hi[a] - other.lo[a]).max(other.hi[a] - self.lo[a]);
        let (x, y, z) = (far(0), far(1), far(2));
        x * x + y * y + z * z
    }

    pub(super) fn with(&self, other: &Self) -> Self {
        let each = |f: fn(f32, f32) -> f32, a: &[f32; 3], b: &[f32; 3]| [0, 1, 2].map(|i| f(a[i], b[i]));
        Self { lo: each(f32::min, &self.lo, &other.lo), hi: each(f32::max, &self.hi, &other.hi) }
    }
}

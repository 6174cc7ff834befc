//! The neighbours of every point of a cloud, a leaf of the tree at a time.
//!
//! The points of a leaf share their candidates: leaves whose boxes are near the leaf's own, found once. For each point
//! the k-th smallest distance is found by counting (regula falsi on the number of candidates within a distance, which on
//! a surface grows with its square), which needs no data-dependent branches, and only then are neighbours gathered.
//!
//! The radius that candidates are gathered within is a guess from points before. An answer is taken only if it proves
//! itself: k candidates within the guess, and all leaves that reach into it were looked at. Otherwise the tree is
//! searched for that point alone. So answers are exact, whatever was guessed.

use super::kdtree::{Bounds, KdTree, LEAF, Leaf, Neighbor, key};
use nalgebra::Point3;
use percept_geometry::by_processor;

/// Leaves that the candidates of a leaf's points may lie in; more are not worth sharing.
const MAX_LEAVES: usize = 64;
/// Up to this many neighbours candidates are shared.
const MAX_SHARED: usize = 64;
/// How far beyond the usual distance of the k-th neighbour candidates are gathered.
const MARGIN: f32 = 1.3;
/// Steps of the search for the k-th distance.
const STEPS: usize = 8;

/// Which neighbours are wanted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    /// At most so many nearest ones, the point itself among them; at least 1.
    pub(crate) k: usize,
    /// At most so far away, metres; infinite for any.
    pub(crate) radius_m: f32,
    /// Whether they come nearest first.
    pub(crate) sorted: bool,
}

/// The neighbours of the points of a leaf, and memory for finding those of the next.
pub(crate) struct Group {
    /// `LEAF x k`: keys of neighbours by point.
    rows: Vec<u64>,
    counts: [usize; LEAF],
    done: [bool; LEAF],
    /// Usual distance of the k-th neighbour, metres; 0 if not known.
    usual: f32,
    around: Around,
    distances: Vec<f32>,
    gathered: Vec<u64>,
    found: Vec<Neighbor>,
}

/// Leaves near a leaf: boxes side by side.
struct Around {
    len: usize,
    leaves: [u32; MAX_LEAVES],
    lo: [[f32; MAX_LEAVES]; 3],
    hi: [[f32; MAX_LEAVES]; 3],
}

impl Group {
    pub(crate) fn new() -> Self {
        let around = Around { len: 0, leaves: [0; MAX_LEAVES], lo: [[0.0; MAX_LEAVES]; 3], hi: [[0.0; MAX_LEAVES]; 3] };
        Self {
            rows: Vec::new(),
            counts: [0; LEAF],
            done: [false; LEAF],
            usual: 0.0,
            around,
            distances: vec![0.0; MAX_LEAVES * LEAF],
            gathered: vec![0; MAX_LEAVES * LEAF],
            found: Vec::new(),
        }
    }

    /// Forgets what was learnt from leaves before; memory is kept.
    pub(crate) fn forget(&mut self) {
        self.usual = 0.0;
    }

    /// Finds the neighbours of the points of a leaf. `wanted.k` is not more than the points of the tree.
    pub(crate) fn find(&mut self, tree: &KdTree, leaf: usize, wanted: &Wanted) {
        self.rows.resize(LEAF * wanted.k, 0);
        self.done = [false; LEAF];
        let num_points = tree.num_points_of(leaf);
        if wanted.k <= MAX_SHARED {
            if self.usual == 0.0 {
                self.find_alone(tree, leaf, 0, wanted);
                self.usual = self.worst(0, wanted);
            }
            find_shared(self, tree, leaf, wanted);
        }
        for i in 0..num_points {
            if !self.done[i] {
                self.find_alone(tree, leaf, i, wanted);
            }
        }
        let mut reach: [f32; LEAF] = std::array::from_fn(|i| if i < num_points { self.worst(i, wanted) } else { 0.0 });
        let (_, median, _) = reach[..num_points].select_nth_unstable_by(num_points / 2, f32::total_cmp);
        self.usual = *median;
    }

    /// Keys (squared distance above, index below) of the neighbours of the `i`-th point of the leaf.
    pub(crate) fn row(&self, i: usize, wanted: &Wanted) -> &[u64] {
        &self.rows[i * wanted.k..][..self.counts[i]]
    }

    /// Whether each point of a leaf has at least `wanted` points within the radius, itself among them.
    ///
    /// Leaves of which every point is in reach of every point here count as a whole. First only leaves next in the
    /// order of the tree are asked, which are near most of the time.
    pub(crate) fn at_least(&mut self, tree: &KdTree, leaf: usize, radius_m: f32, wanted: usize) -> [bool; LEAF] {
        let radius2 = radius_m * radius_m;
        let own = tree.leaf_bounds(leaf);
        let beside = leaf.saturating_sub(1)..(leaf + 2).min(tree.leaves.len());
        let whole = |other: usize| tree.leaf_bounds(other).farthest2(&own) <= radius2;
        let sure: usize = beside.clone().filter(|&other| whole(other)).map(|other| tree.num_points_of(other)).sum();
        if sure >= wanted {
            return [true; LEAF];
        }
        let mut counts = [0; LEAF];
        let num_points = tree.num_points_of(leaf);
        let mut near = [0u32; 3];
        let num_near = near.iter_mut().zip(beside).map(|(near, other)| *near = other as u32).count();
        count_leaves(tree, leaf, &near[..num_near], radius2, &mut counts);
        if counts[..num_points].iter().all(|&c| c as usize >= wanted) {
            return [true; LEAF];
        }
        if tree.gather(&own, radius2, &mut self.around) {
            let sure: usize = (0..self.around.len)
                .filter(|&j| self.around.bounds(j).farthest2(&own) <= radius2)
                .map(|j| tree.num_points_of(self.around.leaves[j] as usize))
                .sum();
            if sure >= wanted {
                return [true; LEAF];
            }
            counts = [0; LEAF];
            count_leaves(tree, leaf, &self.around.leaves[..self.around.len], radius2, &mut counts);
            return counts.map(|c| c as usize >= wanted);
        }
        std::array::from_fn(|i| {
            counts[i] as usize >= wanted || {
                let found = &mut self.found;
                i < num_points && {
                    tree.hybrid_into(&tree.leaves[leaf].point(i), radius_m, wanted, found);
                    found.len() == wanted
                }
            }
        })
    }

    fn find_alone(&mut self, tree: &KdTree, leaf: usize, i: usize, wanted: &Wanted) {
        tree.hybrid_into(&tree.leaves[leaf].point(i), wanted.radius_m, wanted.k, &mut self.found);
        self.counts[i] = self.found.len();
        self.rows[i * wanted.k..].iter_mut().zip(&self.found).for_each(|(row, n)| *row = n.key());
        self.done[i] = true;
    }

    fn worst(&self, i: usize, wanted: &Wanted) -> f32 {
        let worst = self.row(i, wanted).iter().max().copied().unwrap_or(0);
        Neighbor::of_key(worst).distance2.sqrt()
    }
}

impl Leaf {
    #[inline(always)]
    pub(super) fn point(&self, i: usize) -> Point3<f32> {
        Point3::new(self.xs[i], self.ys[i], self.zs[i])
    }
}

impl KdTree {
    /// Number of leaves; they hold the points in the order of the tree.
    pub(crate) fn num_leaves(&self) -> usize {
        self.leaves.len()
    }

    /// Number of points of a leaf.
    pub(crate) fn num_points_of(&self, leaf: usize) -> usize {
        (self.len() - leaf * LEAF).min(LEAF)
    }

    /// Indices of a leaf's points.
    pub(crate) fn indices_of(&self, leaf: usize) -> &[u32] {
        &self.leaves[leaf].indices[..self.num_points_of(leaf)]
    }

    /// The leaves whose boxes are within the distance (squared) of a box; false if they are too many.
    ///
    /// Gaps are rounded monotonically, like the distances of points: no leaf with a point within is missed.
    #[inline(always)]
    fn gather(&self, of: &Bounds, limit2: f32, around: &mut Around) -> bool {
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
            if around.len == MAX_LEAVES {
                return false;
            }
            around.leaves[around.len] = leaf;
            for a in 0..3 {
                around.lo[a][around.len] = b.lo[a];
                around.hi[a][around.len] = b.hi[a];
            }
            around.len += 1;
        }
        true
    }

    /// The box of a leaf: tight, as it is made of so few points.
    #[inline(always)]
    fn leaf_bounds(&self, leaf: usize) -> Bounds {
        let l = &self.leaves[leaf];
        let n = self.num_points_of(leaf);
        let least = |v: &[f32; LEAF]| v[..n].iter().fold(f32::INFINITY, |m, &v| if v < m { v } else { m });
        let most = |v: &[f32; LEAF]| v[..n].iter().fold(f32::NEG_INFINITY, |m, &v| if v > m { v } else { m });
        Bounds { lo: [least(&l.xs), least(&l.ys), least(&l.zs)], hi: [most(&l.xs), most(&l.ys), most(&l.zs)] }
    }
}

impl Bounds {
    /// Squared distance of the two points of the boxes that are farthest apart, rounded like that of points.
    fn farthest2(&self, other: &Self) -> f32 {
        let far = |a: usize| (self.hi[a] - other.lo[a]).max(other.hi[a] - self.lo[a]);
        let (x, y, z) = (far(0), far(1), far(2));
        x * x + y * y + z * z
    }
}

by_processor! {
    /// Adds to each point of a leaf how many points of other leaves are within the radius.
    fn count_leaves(tree: &KdTree, leaf: usize, others: &[u32], radius2: f32, counts: &mut [u32; LEAF]) {
        let own = &tree.leaves[leaf];
        for &other in others {
            let leaf = &tree.leaves[other as usize];
            // Lanes that are filled up must not count where the radius is infinite.
            let num_points = tree.num_points_of(other as usize);
            for j in 0..num_points {
                let (x, y, z) = (leaf.xs[j], leaf.ys[j], leaf.zs[j]);
                for (i, count) in counts.iter_mut().enumerate() {
                    let (dx, dy, dz) = (own.xs[i] - x, own.ys[i] - y, own.zs[i] - z);
                    *count += u32::from(dx * dx + dy * dy + dz * dz <= radius2);
                }
            }
        }
    }
}

by_processor! {
    /// Finds what it can for the points of a leaf from shared candidates, and marks it as done.
    fn find_shared(group: &mut Group, tree: &KdTree, leaf: usize, wanted: &Wanted) {
        let Group { rows, counts, done, usual, around, distances, gathered, .. } = group;
        let radius2 = wanted.radius_m * wanted.radius_m;
        let mut limit2 = (*usual * MARGIN) * (*usual * MARGIN);
        limit2 = limit2.min(radius2);
        if !limit2.is_finite() || !tree.gather(&tree.leaf_bounds(leaf), limit2, around) {
            return;
        }
        let own = &tree.leaves[leaf];
        // Distance of the k-th neighbour of points already done; the triangle inequality bounds that of the next.
        let mut reaches = [f32::INFINITY; LEAF];
        for i in 0..tree.num_points_of(leaf) {
            let q = [own.xs[i], own.ys[i], own.zs[i]];
            let bound2 = carried_bound(own, &q, &reaches).min(limit2);
            let mut chosen = [0u8; MAX_LEAVES];
            let num_chosen = around.reached(&q, bound2, &mut chosen);
            let n = num_chosen * LEAF;
            for (out, &j) in distances[..n].as_chunks_mut::<LEAF>().0.iter_mut().zip(&chosen[..num_chosen]) {
                measure(&tree.leaves[around.leaves[j as usize] as usize], &q, out);
            }
            let within = count(&distances[..n], bound2);
            if within < wanted.k && bound2 < radius2 {
                continue;
            }
            let limit = if within <= wanted.k { bound2 } else { kth(&distances[..n], bound2, within, wanted.k) };
            let mut len = 0;
            for (d, &j) in distances[..n].as_chunks::<LEAF>().0.iter().zip(&chosen[..num_chosen]) {
                let indices = &tree.leaves[around.leaves[j as usize] as usize].indices;
                gather_within(d, indices, limit, gathered, &mut len);
            }
            if len > wanted.k {
                gathered[..len].select_nth_unstable(wanted.k - 1);
                len = wanted.k;
            }
            let row = &mut rows[i * wanted.k..][..len];
            if wanted.sorted {
                sort_by_rank(&gathered[..len], row);
            } else {
                row.copy_from_slice(&gathered[..len]);
            }
            counts[i] = len;
            done[i] = true;
            if len == wanted.k {
                reaches[i] = limit.sqrt();
            }
        }
    }
}

impl Around {
    fn bounds(&self, j: usize) -> Bounds {
        Bounds { lo: [0, 1, 2].map(|a| self.lo[a][j]), hi: [0, 1, 2].map(|a| self.hi[a][j]) }
    }

    /// Numbers of the leaves whose box is within the distance (squared) of a point.
    #[inline(always)]
    fn reached(&self, q: &[f32; 3], bound2: f32, chosen: &mut [u8; MAX_LEAVES]) -> usize {
        let mut gaps = [0.0f32; MAX_LEAVES];
        let padded = self.len.next_multiple_of(8);
        for (j, gap) in gaps[..padded].iter_mut().enumerate() {
            let side = |a: usize| {
                let (below, above) = (self.lo[a][j] - q[a], q[a] - self.hi[a][j]);
                let side = if below > above { below } else { above };
                if side > 0.0 { side } else { 0.0 }
            };
            let (x, y, z) = (side(0), side(1), side(2));
            *gap = x * x + y * y + z * z;
        }
        let mut n = 0;
        for (j, &gap) in gaps[..self.len].iter().enumerate() {
            chosen[n] = j as u8;
            n += usize::from(gap <= bound2);
        }
        n.min(MAX_LEAVES)
    }
}

/// The least of reach + distance over the points done, squared, with room for rounding.
#[inline(always)]
fn carried_bound(own: &Leaf, q: &[f32; 3], reaches: &[f32; LEAF]) -> f32 {
    let mut distances = [0.0f32; LEAF];
    measure(own, q, &mut distances);
    let mut least = [f32::INFINITY; LEAF];
    for j in 0..LEAF {
        least[j] = reaches[j] + distances[j].sqrt();
    }
    let least = least.iter().fold(f32::INFINITY, |m, &v| if v < m { v } else { m }) * (1.0 + 1e-5);
    least * least
}

#[inline(always)]
fn measure(leaf: &Leaf, q: &[f32; 3], out: &mut [f32; LEAF]) {
    for (j, distance2) in out.iter_mut().enumerate() {
        let (dx, dy, dz) = (q[0] - leaf.xs[j], q[1] - leaf.ys[j], q[2] - leaf.zs[j]);
        *distance2 = dx * dx + dy * dy + dz * dz;
    }
}

/// How many distances are within the limit.
#[inline(always)]
fn count(distances: &[f32], limit: f32) -> usize {
    let mut counts = [0u32; LEAF];
    for chunk in distances.as_chunks::<LEAF>().0 {
        for j in 0..LEAF {
            counts[j] += u32::from(chunk[j] <= limit);
        }
    }
    counts.iter().sum::<u32>() as usize
}

/// A limit within which at least k distances lie, exactly k if that is found soon.
#[inline(always)]
fn kth(distances: &[f32], bound2: f32, within: usize, k: usize) -> f32 {
    let (mut lo, mut hi, mut num_lo, mut num_hi) = (0.0f32, bound2, 0usize, within);
    for _ in 0..STEPS {
        let share = (k as f32 + 0.5 - num_lo as f32) / (num_hi as f32 + 0.5 - num_lo as f32);
        let t = lo + (hi - lo) * share.clamp(0.05, 0.95);
        if !(t > lo && t < hi) {
            break;
        }
        let n = count(distances, t);
        if n >= k {
            (hi, num_hi) = (t, n);
        } else {
            (lo, num_lo) = (t, n);
        }
        if n == k {
            break;
        }
    }
    hi
}

/// Appends the keys of the points within the limit.
#[inline(always)]
fn gather_within(distances: &[f32; LEAF], indices: &[u32; LEAF], limit: f32, out: &mut [u64], len: &mut usize) {
    let mut flags = [0u8; LEAF];
    for j in 0..LEAF {
        flags[j] = u8::from(distances[j] <= limit);
    }
    let mut bits = u128::from_le_bytes(flags);
    while bits != 0 {
        let j = (bits.trailing_zeros() / 8) as usize % LEAF;
        out[*len] = key(distances[j], indices[j]);
        *len += 1;
        bits &= bits - 1;
    }
}

/// Sorts by counting for each how many are smaller: no branches that depend on the data. Keys are all different.
#[inline(always)]
fn sort_by_rank(keys: &[u64], out: &mut [u64]) {
    for &key in keys {
        let rank: u64 = keys.iter().map(|&other| u64::from((other as i64) < key as i64)).sum();
        out[rank as usize] = key;
    }
}

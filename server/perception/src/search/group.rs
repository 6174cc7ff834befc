//! The neighbours of every point of a cloud, a leaf of the tree at a time.
//!
//! The points of a leaf share their candidates: leaves whose boxes are near the leaf's own, found once. Of each point
//! those within a guessed radius are packed side by side and ranked by comparing each with each, which needs no
//! branches that depend on the data.
//!
//! The radius is a guess from points before. An answer is taken only if it proves itself: k candidates within the
//! guess, and all leaves that reach into it were looked at. Otherwise a bound that is sure is taken: the reach of a
//! neighbour already done and the distance to it. So answers are exact, whatever was guessed.

mod around;

use super::kdtree::{Bounds, KdTree, LEAF, Leaf, Neighbor};
use super::near::{self, MAX_LEAVES, Near, Packing, Query};
use around::{Around, Nearby};
use nalgebra::Point3;
use percept_geometry::by_processor;

/// Up to this many neighbours candidates are shared.
const MAX_SHARED: usize = 64;
/// How far beyond the usual distance of the k-th neighbour candidates are gathered.
const MARGIN: f32 = 1.2;

/// A guess that was too small is taken so many times larger (squared), so many times.
const WIDEN: f32 = 2.0;
const RAISE: f32 = 1.1;
const RETRIES: usize = 4;

/// Which neighbours are wanted, and what of them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted<'a> {
    /// At most so many nearest ones, the point itself among them; at least 1.
    pub(crate) k: usize,
    /// At most so far away, metres; infinite for any.
    pub(crate) radius_m: f32,
    pub(crate) what: What<'a>,
}

/// What is wanted of neighbours.
#[derive(Debug, Clone, Copy)]
pub(crate) enum What<'a> {
    /// Which they are, nearest first.
    Rows,
    /// Their moments about the point; with the points that the tree was built from.
    Moments(&'a [Point3<f32>]),
    /// The sum of their distances.
    Distances,
}

/// The neighbours of the points of a leaf, and memory for finding those of the next.
pub(crate) struct Group {
    /// `LEAF x k`: keys of neighbours by point.
    rows: Vec<u64>,
    counts: [usize; LEAF],
    /// Number, sum and products (xx, xy, xz, yy, yz, zz) of the neighbours about each point.
    moments: [[f64; LEAF]; 10],
    distances: [f64; LEAF],
    /// Distance of the k-th neighbour of points already done; infinite if there are not so many.
    reaches: [f32; LEAF],
    /// Usual distance of the k-th neighbour, metres; 0 if not known.
    usual: f32,
    nearby: Nearby,
    around: Around<MAX_LEAVES>,
    wider: Around<MAX_LEAVES>,
    near: Near,
    ranked: Vec<u64>,
    found: Vec<Neighbor>,
}

impl Group {
    pub(crate) fn new() -> Self {
        Self {
            rows: Vec::new(),
            counts: [0; LEAF],
            moments: [[0.0; LEAF]; 10],
            distances: [0.0; LEAF],
            reaches: [f32::INFINITY; LEAF],
            usual: 0.0,
            nearby: Nearby { block: None, limit2: 0.0, around: Around::NONE },
            around: Around::NONE,
            wider: Around::NONE,
            near: Near::new(),
            ranked: Vec::new(),
            found: Vec::new(),
        }
    }

    /// Forgets what was learnt from leaves before; memory is kept.
    pub(crate) fn forget(&mut self) {
        self.usual = 0.0;
        self.nearby.block = None;
    }

    /// Finds the neighbours of the points of a leaf. `wanted.k` is not more than the points of the tree.
    pub(crate) fn find(&mut self, tree: &KdTree, leaf: usize, wanted: &Wanted) {
        if matches!(wanted.what, What::Rows) {
            self.rows.resize(LEAF * wanted.k, 0);
        }
        self.reaches = [f32::INFINITY; LEAF];
        let num_points = tree.num_points_of(leaf);
        let mut worst = [0.0; LEAF];
        find_by_processor(self, tree, leaf, wanted, &mut worst);
        let (_, median, _) = worst[..num_points].select_nth_unstable_by(num_points / 2, f32::total_cmp);
        self.usual = *median;
    }

    /// Keys (squared distance above, index below) of the neighbours of the `i`-th point of the leaf, nearest first.
    pub(crate) fn row(&self, i: usize, wanted: &Wanted) -> &[u64] {
        &self.rows[i * wanted.k..][..self.counts[i]]
    }

    /// Number of neighbours of the `i`-th point of the leaf.
    pub(crate) fn count(&self, i: usize) -> usize {
        self.counts[i]
    }

    /// Number, sum and products of the neighbours about each point of the leaf.
    pub(crate) fn moments(&self) -> &[[f64; LEAF]; 10] {
        &self.moments
    }

    /// Sum of the distances of the neighbours of the `i`-th point of the leaf.
    pub(crate) fn sum_of_distances(&self, i: usize) -> f64 {
        self.distances[i]
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

    /// Finds the neighbours of all points of a leaf; `worst` is how far the farthest are.
    #[inline(always)]
    fn find_with<P: Packing>(
        &mut self,
        packing: P,
        tree: &KdTree,
        leaf: usize,
        wanted: &Wanted,
        worst: &mut [f32; LEAF],
    ) {
        let own = &tree.leaves[leaf];
        let radius2 = wanted.radius_m * wanted.radius_m;
        let with_offsets = matches!(wanted.what, What::Moments(_));
        let mut start = 0;
        if self.usual == 0.0 {
            self.find_alone(tree, &own.point(0), wanted);
            worst[0] = self.finish(packing, 0, wanted);
            (self.usual, start) = (worst[0], 1);
        }
        let mut guess2 = ((self.usual * MARGIN) * (self.usual * MARGIN)).min(radius2);
        let (mut shared, mut reached) = self.share(tree, leaf, guess2, wanted);
        for i in start..tree.num_points_of(leaf) {
            let q = [own.xs[i], own.ys[i], own.zs[i]];
            self.near.len = 0;
            let mut leaves = reached[i];
            while leaves != 0 {
                let other = self.around.leaves[leaves.trailing_zeros() as usize % MAX_LEAVES];
                let query = Query { q, limit2: guess2, with_offsets };
                packing.append(&tree.leaves[other as usize], &query, &mut self.near);
                leaves &= leaves - 1;
            }
            let proven = shared && (self.near.len >= wanted.k || guess2 == radius2);
            if !proven {
                self.find_again(packing, tree, leaf, i, guess2, wanted);
            }
            worst[i] = self.finish(packing, i, wanted);
            if !proven && worst[i] * worst[i] > guess2 {
                // Points are farther apart than in the leaf before.
                guess2 = ((worst[i] * RAISE) * (worst[i] * RAISE)).min(radius2);
                (shared, reached) = self.share(tree, leaf, guess2, wanted);
            }
        }
    }

    /// Looks for the leaves that all points of a leaf share: whether there are not too many, and which of them each
    /// point reaches.
    #[inline(always)]
    fn share(&mut self, tree: &KdTree, leaf: usize, guess2: f32, wanted: &Wanted) -> (bool, [u64; LEAF]) {
        let shared =
            wanted.k <= MAX_SHARED && guess2.is_finite() && self.nearby.gather(tree, leaf, guess2, &mut self.around);
        (shared, if shared { self.around.reached(&tree.leaves[leaf], guess2) } else { [0; LEAF] })
    }

    /// Finds candidates for a point where the guess was too small: with larger ones, up to what is sure.
    #[inline(always)]
    fn find_again<P: Packing>(
        &mut self,
        packing: P,
        tree: &KdTree,
        leaf: usize,
        i: usize,
        guess2: f32,
        wanted: &Wanted,
    ) {
        let own = &tree.leaves[leaf];
        let q = [own.xs[i], own.ys[i], own.zs[i]];
        let sure2 = carried_bound(own, &q, &self.reaches).min(wanted.radius_m * wanted.radius_m);
        let mut limit2 = guess2;
        for _ in 0..RETRIES {
            limit2 = (limit2 * WIDEN).min(sure2);
            let usable = wanted.k <= MAX_SHARED && limit2.is_finite();
            if !usable || !self.nearby.gather_about(tree, leaf, &Bounds { lo: q, hi: q }, limit2, &mut self.wider) {
                break;
            }
            self.near.len = 0;
            let query = Query { q, limit2, with_offsets: matches!(wanted.what, What::Moments(_)) };
            for &other in &self.wider.leaves[..self.wider.len] {
                packing.append(&tree.leaves[other as usize], &query, &mut self.near);
            }
            if self.near.len >= wanted.k || limit2 == sure2 {
                return;
            }
        }
        self.find_alone(tree, &own.point(i), wanted);
    }

    /// Finds the neighbours of a point by searching the tree for it alone.
    fn find_alone(&mut self, tree: &KdTree, q: &Point3<f32>, wanted: &Wanted) {
        tree.hybrid_into(q, wanted.radius_m, wanted.k, &mut self.found);
        self.near.clear_for(self.found.len());
        for n in &self.found {
            let offset = if let What::Moments(points) = wanted.what { points[n.index] - q } else { Default::default() };
            self.near.push(n.distance2, n.index as u32, offset.into());
        }
    }

    /// Takes of the candidates of the `i`-th point what is wanted; how far away the farthest of its neighbours is.
    #[inline(always)]
    fn finish<P: Packing>(&mut self, packing: P, i: usize, wanted: &Wanted) -> f32 {
        self.near.rank(packing, wanted.k);
        let count = self.near.len.min(wanted.k);
        self.counts[i] = count;
        match wanted.what {
            What::Rows => self.near.sort_into(&mut self.ranked, &mut self.rows[i * wanted.k..][..count]),
            What::Moments(_) => {
                self.near.settle_border(count);
                let sums = self.near.moments(count);
                self.moments.iter_mut().zip(sums).for_each(|(m, s)| m[i] = s);
            }
            What::Distances => self.distances[i] = self.near.sum_of_distances(count),
        }
        let worst = self.near.worst2(count).sqrt();
        self.reaches[i] = if count == wanted.k { worst } else { f32::INFINITY };
        worst
    }
}

fn find_by_processor(group: &mut Group, tree: &KdTree, leaf: usize, wanted: &Wanted, worst: &mut [f32; LEAF]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        fn wide(group: &mut Group, tree: &KdTree, leaf: usize, wanted: &Wanted, worst: &mut [f32; LEAF]) {
            // SAFETY: there is AVX2 here.
            #[allow(unsafe_code)]
            let packing = unsafe { near::Avx2::known() };
            group.find_with(packing, tree, leaf, wanted, worst);
        }
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        fn wider(group: &mut Group, tree: &KdTree, leaf: usize, wanted: &Wanted, worst: &mut [f32; LEAF]) {
            // SAFETY: there is AVX-512 F here.
            #[allow(unsafe_code)]
            let packing = unsafe { near::Avx512::known() };
            group.find_with(packing, tree, leaf, wanted, worst);
        }
        if near::has_avx2() {
            if near::has_avx512() {
                // SAFETY: this processor has every feature that `wider` is compiled for.
                #[allow(unsafe_code)]
                return unsafe { wider(group, tree, leaf, wanted, worst) };
            }
            // SAFETY: this processor has every feature that `wide` is compiled for.
            #[allow(unsafe_code)]
            return unsafe { wide(group, tree, leaf, wanted, worst) };
        }
    }
    group.find_with(near::Plain, tree, leaf, wanted, worst);
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

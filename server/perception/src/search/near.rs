//! Points near a point, coordinates side by side: found by comparing, packed by the processor's own instructions.

use super::kdtree::{LEAF, Leaf, key};

/// Room for the points of so many leaves.
pub(super) const MAX_LEAVES: usize = 64;
/// More candidates are thinned before each is compared with each.
const RANKED: usize = 96;
/// Sums in f64 side by side.
const LANES: usize = 4;
/// Steps of the search for the k-th distance.
const STEPS: usize = 8;

/// Candidates for the neighbours of a point.
pub(super) struct Near {
    pub(super) len: usize,
    /// Squared distances, square metres; infinite at `len` and the fifteen after it once ranked.
    pub(super) distances2: Vec<f32>,
    pub(super) indices: Vec<u32>,
    /// x, y, z from the point to the candidate, metres; only if asked for.
    pub(super) offsets: [Vec<f32>; 3],
    /// How many come before, nearest first.
    pub(super) ranks: Vec<i32>,
    ties: Vec<(u32, u32)>,
}

/// What is looked for about a point.
#[derive(Clone, Copy)]
pub(super) struct Query {
    pub(super) q: [f32; 3],
    pub(super) limit2: f32,
    pub(super) with_offsets: bool,
}

/// What compilers do not find by themselves, by a set of instructions that is known to be there.
pub(super) trait Packing: Copy {
    /// Appends the points of a leaf within the (finite) limit, in order.
    fn append(self, leaf: &Leaf, query: &Query, near: &mut Near);

    /// Counts for each value how many come before it: smaller ones, and equal ones on its left. No branches depend on
    /// the values. `ranks` has at least the length of `values`.
    fn rank(self, values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]);
}

impl Near {
    pub(super) fn new() -> Self {
        let room = (MAX_LEAVES + 1) * LEAF;
        Self {
            len: 0,
            distances2: vec![0.0; room],
            indices: vec![0; room],
            offsets: [vec![0.0; room], vec![0.0; room], vec![0.0; room]],
            ranks: vec![0; room],
            ties: Vec::new(),
        }
    }

    /// No candidates, and room for so many.
    pub(super) fn clear_for(&mut self, num: usize) {
        let room = num + LEAF;
        if self.indices.len() < room {
            self.distances2.resize(room, 0.0);
            self.indices.resize(room, 0);
            self.offsets.iter_mut().for_each(|o| o.resize(room, 0.0));
            self.ranks.resize(room, 0);
        }
        self.len = 0;
    }

    /// Takes a candidate from elsewhere.
    pub(super) fn push(&mut self, distance2: f32, index: u32, offset: [f32; 3]) {
        self.distances2[self.len] = distance2;
        self.indices[self.len] = index;
        (0..3).for_each(|a| self.offsets[a][self.len] = offset[a]);
        self.len += 1;
    }

    /// Ranks the candidates by distance, equal ones in any order; only the first `k` matter.
    #[inline(always)]
    pub(super) fn rank<P: Packing>(&mut self, packing: P, k: usize) {
        if self.len > RANKED {
            self.thin(k);
        }
        let n = self.len;
        self.distances2[n..n + LEAF].fill(f32::INFINITY);
        if n > RANKED {
            return self.rank_by_sorting();
        }
        packing.rank(self.distances2[..n.next_multiple_of(LEAF)].as_chunks().0, self.ranks.as_chunks_mut().0);
    }

    /// Makes those of smaller index the first of candidates as far away as the last of the first `count`.
    #[inline(always)]
    pub(super) fn settle_border(&mut self, count: usize) {
        let worst2 = self.worst2(count);
        let mut within = [0i32; LEAF];
        for d in self.distances2[..self.len.next_multiple_of(LEAF)].as_chunks::<LEAF>().0 {
            for i in 0..LEAF {
                within[i] += i32::from(d[i] <= worst2);
            }
        }
        if within.iter().sum::<i32>() as usize != count {
            self.settle_ties(worst2);
        }
    }

    #[inline(never)]
    fn settle_ties(&mut self, distance2: f32) {
        self.ties.clear();
        let tied = (0..self.len).filter(|&i| self.distances2[i] == distance2);
        self.ties.extend(tied.map(|i| (self.indices[i], i as u32)));
        let first = self.ties.iter().map(|&(_, i)| self.ranks[i as usize]).min().unwrap_or(0);
        self.ties.sort_unstable();
        self.ties.iter().zip(first..).for_each(|(&(_, i), rank)| self.ranks[i as usize] = rank);
    }

    #[cold]
    #[inline(never)]
    fn rank_by_sorting(&mut self) {
        let n = self.len;
        self.ranks[n..n + LEAF].fill(n as i32);
        self.ties.clear();
        self.ties.extend((0..n).map(|i| (self.distances2[i].to_bits(), i as u32)));
        self.ties.sort_unstable();
        self.ties.iter().zip(0..).for_each(|(&(_, i), rank)| self.ranks[i as usize] = rank);
    }

    /// Leaves out candidates that cannot be among the first `k`: regula falsi on the number within a distance, which
    /// on a surface grows with its square.
    #[cold]
    #[inline(never)]
    fn thin(&mut self, k: usize) {
        let all = &self.distances2[..self.len];
        let most = all.iter().fold(0.0f32, |m, &d| m.max(d));
        let (mut lo, mut hi, mut num_lo, mut num_hi) = (0.0f32, most, 0usize, self.len);
        for _ in 0..STEPS {
            let share = (k as f32 + 0.5 - num_lo as f32) / (num_hi as f32 + 0.5 - num_lo as f32);
            let t = lo + (hi - lo) * share.clamp(0.05, 0.95);
            if !(t > lo && t < hi) || num_hi < k + k / 4 {
                break;
            }
            let n = all.iter().map(|&d| u32::from(d <= t)).sum::<u32>() as usize;
            (if n >= k { (&mut hi, &mut num_hi) } else { (&mut lo, &mut num_lo) }).put(t, n);
        }
        let mut kept = 0;
        for i in 0..self.len {
            let keep = self.distances2[i] <= hi;
            self.distances2[kept] = self.distances2[i];
            self.indices[kept] = self.indices[i];
            self.offsets.iter_mut().for_each(|o| o[kept] = o[i]);
            kept += usize::from(keep);
        }
        self.len = kept;
    }

    /// Squared distance of the farthest of the first `count`; 0 if there is none.
    #[inline(always)]
    pub(super) fn worst2(&self, count: usize) -> f32 {
        let mut worst = [0.0f32; LEAF];
        let (distances2, ranks) = (self.distances2.as_chunks::<LEAF>().0, self.ranks.as_chunks::<LEAF>().0);
        for (d, ranks) in distances2.iter().zip(ranks).take(self.len.div_ceil(LEAF)) {
            for i in 0..LEAF {
                let d = where_first(ranks[i], count, d[i]);
                worst[i] = if d > worst[i] { d } else { worst[i] };
            }
        }
        worst.iter().fold(0.0, |m, &d| if d > m { d } else { m })
    }

    /// Writes the keys of the first ones, nearest first; `room` is memory.
    #[inline(always)]
    pub(super) fn sort_into(&self, room: &mut Vec<u64>, row: &mut [u64]) {
        let n = self.len;
        if room.len() < n {
            room.resize(n, 0);
        }
        let ranked = &mut room[..n];
        for ((&d, &index), &rank) in self.distances2[..n].iter().zip(&self.indices[..n]).zip(&self.ranks[..n]) {
            if let Some(place) = ranked.get_mut(rank as usize) {
                *place = key(d, index);
            }
        }
        // Ties came in any order.
        if ranked.windows(2).map(|w| u32::from(w[0] > w[1])).sum::<u32>() > 0 {
            sort_nearly(ranked);
        }
        row.copy_from_slice(&ranked[..row.len()]);
    }

    /// Sum of the distances of the first `count`.
    #[inline(always)]
    pub(super) fn sum_of_distances(&self, count: usize) -> f64 {
        let mut sums = [0.0f64; LEAF];
        let (distances2, ranks) = (self.distances2.as_chunks::<LEAF>().0, self.ranks.as_chunks::<LEAF>().0);
        for (d, ranks) in distances2.iter().zip(ranks).take(self.len.div_ceil(LEAF)) {
            for i in 0..LEAF {
                sums[i] += f64::from(where_first(ranks[i], count, d[i]).sqrt());
            }
        }
        sums.iter().sum()
    }

    /// Number, sum and products (xx, xy, xz, yy, yz, zz) of the offsets of the first `count`.
    #[inline(always)]
    pub(super) fn moments(&self, count: usize) -> [f64; 10] {
        let mut sums = [[0.0f64; LANES]; 9];
        let [xs, ys, zs] = self.offsets.each_ref().map(|o| o.as_chunks::<LANES>().0);
        let ranks = self.ranks.as_chunks::<LANES>().0;
        for (((x, y), z), ranks) in xs.iter().zip(ys).zip(zs).zip(ranks).take(self.len.div_ceil(LANES)) {
            for l in 0..LANES {
                let pick = |v: f32| f64::from(where_first(ranks[l], count, v));
                let (x, y, z) = (pick(x[l]), pick(y[l]), pick(z[l]));
                for (sum, term) in sums.iter_mut().zip([x, y, z, x * x, x * y, x * z, y * y, y * z, z * z]) {
                    sum[l] += term;
                }
            }
        }
        let mut out = [count as f64; 10];
        out[1..].iter_mut().zip(sums).for_each(|(out, [a, b, c, d])| *out = (a + b) + (c + d));
        out
    }
}

/// The value if the rank is below the count, otherwise 0, without a branch.
#[inline(always)]
fn where_first(rank: i32, count: usize, value: f32) -> f32 {
    f32::from_bits(value.to_bits() & u32::from(rank < count as i32).wrapping_neg())
}

/// Sorts by insertion what is sorted but for ties.
#[inline(never)]
fn sort_nearly(keys: &mut [u64]) {
    if keys.len() > RANKED {
        return keys.sort_unstable();
    }
    for i in 1..keys.len() {
        let mut j = i;
        while j > 0 && keys[j - 1] > keys[j] {
            keys.swap(j - 1, j);
            j -= 1;
        }
    }
}

trait Put {
    fn put(self, t: f32, n: usize);
}

impl Put for (&mut f32, &mut usize) {
    fn put(self, t: f32, n: usize) {
        (*self.0, *self.1) = (t, n);
    }
}

/// Packs on any processor.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Packing for Plain {
    #[inline(always)]
    fn append(self, leaf: &Leaf, query: &Query, near: &mut Near) {
        let q = query.q;
        for i in 0..LEAF {
            let (x, y, z) = (leaf.xs[i] - q[0], leaf.ys[i] - q[1], leaf.zs[i] - q[2]);
            let distance2 = x * x + y * y + z * z;
            // Written always, kept if near: no branch to guess.
            near.distances2[near.len] = distance2;
            near.indices[near.len] = leaf.indices[i];
            near.offsets.iter_mut().zip([x, y, z]).for_each(|(o, v)| o[near.len] = v);
            near.len += usize::from(distance2 <= query.limit2);
        }
    }

    #[inline(always)]
    fn rank(self, values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]) {
        let all = values.as_flattened();
        for (i, (own, rank)) in all.iter().zip(ranks.as_flattened_mut()).enumerate() {
            let left = all[..i].iter().map(|v| i32::from(v <= own)).sum::<i32>();
            *rank = left + all[i + 1..].iter().map(|v| i32::from(v < own)).sum::<i32>();
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86;
#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2, Avx512, has_avx2, has_avx512};

#[cfg(test)]
mod tests;

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
pub(super) use x86::{Avx2, Avx512, has_avx2, has_avx512};

/// Packing by single instructions, or by a table of permutations.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::kdtree::{LEAF, Leaf};
    use super::{Near, Packing, Query};
    use std::arch::x86_64::*;

    /// For each set of eight the places of its members.
    static PLACES: [[u8; 8]; 256] = {
        let mut out = [[0; 8]; 256];
        let mut set = 0;
        while set < 256 {
            let (mut i, mut n) = (0, 0);
            while i < 8 {
                if set >> i & 1 == 1 {
                    out[set][n] = i;
                    n += 1;
                }
                i += 1;
            }
            set += 1;
        }
        out
    };

    /// Proof that there is AVX2.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(());

    /// Proof that there is AVX-512 F.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx512(());

    impl Avx2 {
        /// # Safety
        /// The processor has AVX2.
        #[allow(unsafe_code)]
        pub(in super::super) unsafe fn known() -> Self {
            Self(())
        }
    }

    impl Avx512 {
        /// # Safety
        /// The processor has AVX-512 F.
        #[allow(unsafe_code)]
        pub(in super::super) unsafe fn known() -> Self {
            Self(())
        }
    }

    impl Packing for Avx2 {
        #[inline(always)]
        fn append(self, leaf: &Leaf, query: &Query, near: &mut Near) {
            // SAFETY: there is a proof of AVX2.
            #[allow(unsafe_code)]
            unsafe {
                append8(leaf, query, near);
            }
        }

        #[inline(always)]
        fn rank(self, values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]) {
            // SAFETY: there is a proof of AVX2.
            #[allow(unsafe_code)]
            unsafe {
                rank8(values, ranks);
            }
        }
    }

    impl Packing for Avx512 {
        #[inline(always)]
        fn append(self, leaf: &Leaf, query: &Query, near: &mut Near) {
            // SAFETY: there is a proof of AVX-512.
            #[allow(unsafe_code)]
            unsafe {
                append16(leaf, query, near);
            }
        }

        #[inline(always)]
        fn rank(self, values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]) {
            // SAFETY: there is a proof of AVX-512.
            #[allow(unsafe_code)]
            unsafe {
                rank16(values, ranks);
            }
        }
    }

    /// Whether the processor has what code for AVX2 is compiled for.
    pub(in super::super) fn has_avx2() -> bool {
        is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt")
    }

    /// Whether there is also what code for AVX-512 is compiled for.
    pub(in super::super) fn has_avx512() -> bool {
        is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw")
    }

    fn room<T, const N: usize>(values: &mut [T], at: usize) -> *mut T {
        values[at..][..N].as_mut_ptr()
    }

    #[inline]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn append8(leaf: &Leaf, query: &Query, near: &mut Near) {
        let [x, y, z] = query.q.map(|v| _mm256_set1_ps(v));
        for half in 0..LEAF / 8 {
            let load = |v: &[f32; LEAF]| {
                let v = &v.as_chunks::<8>().0[half];
                // SAFETY: eight values.
                #[allow(unsafe_code)]
                unsafe {
                    _mm256_loadu_ps(v.as_ptr())
                }
            };
            let (x, y, z) =
                (_mm256_sub_ps(load(&leaf.xs), x), _mm256_sub_ps(load(&leaf.ys), y), _mm256_sub_ps(load(&leaf.zs), z));
            let xy = _mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y));
            let distance2 = _mm256_add_ps(xy, _mm256_mul_ps(z, z));
            let within = _mm256_cmp_ps::<_CMP_LE_OQ>(distance2, _mm256_set1_ps(query.limit2));
            let set = _mm256_movemask_ps(within) as usize & 255;
            let places = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(PLACES[set])));
            let pack = |out: &mut [f32], v: __m256| {
                let out = room::<_, 8>(out, near.len);
                // SAFETY: there is room for eight.
                #[allow(unsafe_code)]
                unsafe {
                    _mm256_storeu_ps(out, _mm256_permutevar8x32_ps(v, places));
                }
            };
            pack(&mut near.distances2, distance2);
            if query.with_offsets {
                let [ox, oy, oz] = &mut near.offsets;
                pack(ox, x);
                pack(oy, y);
                pack(oz, z);
            }
            let indices = &leaf.indices.as_chunks::<8>().0[half];
            let out = room::<_, 8>(&mut near.indices, near.len);
            // SAFETY: eight values, and room for eight.
            #[allow(unsafe_code)]
            unsafe {
                let indices = _mm256_loadu_si256(indices.as_ptr().cast());
                _mm256_storeu_si256(out.cast(), _mm256_permutevar8x32_epi32(indices, places));
            }
            near.len += set.count_ones() as usize;
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn append16(leaf: &Leaf, query: &Query, near: &mut Near) {
        let load = |v: &[f32; LEAF]| {
            // SAFETY: sixteen values.
            #[allow(unsafe_code)]
            unsafe {
                _mm512_loadu_ps(v.as_ptr())
            }
        };
        let [x, y, z] = query.q.map(|v| _mm512_set1_ps(v));
        let (x, y, z) =
            (_mm512_sub_ps(load(&leaf.xs), x), _mm512_sub_ps(load(&leaf.ys), y), _mm512_sub_ps(load(&leaf.zs), z));
        let xy = _mm512_add_ps(_mm512_mul_ps(x, x), _mm512_mul_ps(y, y));
        let distance2 = _mm512_add_ps(xy, _mm512_mul_ps(z, z));
        let set = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(distance2, _mm512_set1_ps(query.limit2));
        let pack = |out: &mut [f32], v: __m512| {
            let out = room::<_, LEAF>(out, near.len);
            // SAFETY: there is room for sixteen.
            #[allow(unsafe_code)]
            unsafe {
                _mm512_storeu_ps(out, _mm512_maskz_compress_ps(set, v));
            }
        };
        pack(&mut near.distances2, distance2);
        if query.with_offsets {
            let [ox, oy, oz] = &mut near.offsets;
            pack(ox, x);
            pack(oy, y);
            pack(oz, z);
        }
        let out = room::<_, LEAF>(&mut near.indices, near.len);
        // SAFETY: sixteen values, and room for sixteen.
        #[allow(unsafe_code)]
        unsafe {
            let indices = _mm512_loadu_si512(leaf.indices.as_ptr().cast());
            _mm512_storeu_si512(out.cast(), _mm512_maskz_compress_epi32(set, indices));
        }
        near.len += set.count_ones() as usize;
    }

    #[inline]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn rank8(values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]) {
        let (own, ranks) = (values.as_flattened().as_chunks::<8>().0, ranks.as_flattened_mut().as_chunks_mut::<8>().0);
        let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        let one = _mm256_set1_epi32(1);
        for (c, (chunk, rank)) in own.iter().zip(ranks).enumerate() {
            // SAFETY: eight values.
            #[allow(unsafe_code)]
            let mine = unsafe { _mm256_loadu_ps(chunk.as_ptr()) };
            // Minus one where it holds.
            let mut before = _mm256_setzero_si256();
            for &v in own[..c].as_flattened() {
                let holds = _mm256_cmp_ps::<_CMP_LE_OQ>(_mm256_set1_ps(v), mine);
                before = _mm256_add_epi32(before, _mm256_castps_si256(holds));
            }
            let mut j = _mm256_setzero_si256();
            for &v in chunk {
                let v = _mm256_set1_ps(v);
                let (less, equal) = (_mm256_cmp_ps::<_CMP_LT_OQ>(v, mine), _mm256_cmp_ps::<_CMP_EQ_OQ>(v, mine));
                let later = _mm256_castsi256_ps(_mm256_cmpgt_epi32(lanes, j));
                let holds = _mm256_or_ps(less, _mm256_and_ps(equal, later));
                before = _mm256_add_epi32(before, _mm256_castps_si256(holds));
                j = _mm256_add_epi32(j, one);
            }
            for &v in own[c + 1..].as_flattened() {
                let holds = _mm256_cmp_ps::<_CMP_LT_OQ>(_mm256_set1_ps(v), mine);
                before = _mm256_add_epi32(before, _mm256_castps_si256(holds));
            }
            // SAFETY: room for eight.
            #[allow(unsafe_code)]
            unsafe {
                _mm256_storeu_si256(rank.as_mut_ptr().cast(), _mm256_sub_epi32(_mm256_setzero_si256(), before));
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn rank16(values: &[[f32; LEAF]], ranks: &mut [[i32; LEAF]]) {
        let one = _mm512_set1_epi32(1);
        for (c, (chunk, rank)) in values.iter().zip(ranks).enumerate() {
            // SAFETY: sixteen values.
            #[allow(unsafe_code)]
            let mine = unsafe { _mm512_loadu_ps(chunk.as_ptr()) };
            let mut before = _mm512_setzero_si512();
            for &v in values[..c].as_flattened() {
                let holds = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(_mm512_set1_ps(v), mine);
                before = _mm512_mask_add_epi32(before, holds, before, one);
            }
            let mut later = !1u16;
            for &v in chunk {
                let v = _mm512_set1_ps(v);
                let less = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(v, mine);
                let equal = _mm512_mask_cmp_ps_mask::<_CMP_EQ_OQ>(later, v, mine);
                before = _mm512_mask_add_epi32(before, less | equal, before, one);
                later <<= 1;
            }
            for &v in values[c + 1..].as_flattened() {
                let holds = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(_mm512_set1_ps(v), mine);
                before = _mm512_mask_add_epi32(before, holds, before, one);
            }
            // SAFETY: room for sixteen.
            #[allow(unsafe_code)]
            unsafe {
                _mm512_storeu_si512(rank.as_mut_ptr().cast(), before);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coarse now and then, so that ties occur.
    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![-1.0..1.0f32, (-2i8..2).prop_map(f32::from), Just(f32::INFINITY)]
    }

    fn leaf() -> impl Strategy<Value = Leaf> {
        let sixteen = || prop::array::uniform16(coordinate());
        (sixteen(), sixteen(), sixteen(), prop::array::uniform16(any::<u32>())).prop_map(|(xs, ys, zs, indices)| Leaf {
            xs,
            ys,
            zs,
            indices,
        })
    }

    /// Distances, indices, offsets and ranks of what is found in leaves.
    fn found<P: Packing>(packing: P, leaves: &[Leaf], query: &Query) -> (Vec<u32>, Vec<u32>, [Vec<f32>; 3], Vec<i32>) {
        let mut near = Near::new();
        leaves.iter().for_each(|leaf| packing.append(leaf, query, &mut near));
        near.rank(packing, 8);
        let n = near.len;
        let distances2 = near.distances2[..n].iter().map(|d| d.to_bits()).collect();
        (
            distances2,
            near.indices[..n].to_vec(),
            near.offsets.each_ref().map(|o| o[..n].to_vec()),
            near.ranks[..n].to_vec(),
        )
    }

    proptest! {
        #[test]
        fn every_processor_finds_the_same(
            leaves in prop::collection::vec(leaf(), 0..12), q in prop::array::uniform3(-1.0..1.0f32), limit2 in 0.0..6.0f32,
        ) {
            let query = Query { q, limit2, with_offsets: true };
            let plain = found(Plain, &leaves, &query);
            let mut order: Vec<usize> = (0..plain.0.len()).collect();
            if order.len() <= RANKED {
                order.sort_by_key(|&i| plain.0[i]);
                prop_assert!(order.iter().enumerate().all(|(rank, &i)| plain.3[i] == rank as i32));
            }
            #[cfg(target_arch = "x86_64")]
            {
                if has_avx2() {
                    // SAFETY: it has.
                    #[allow(unsafe_code)]
                    let packing = unsafe { Avx2::known() };
                    prop_assert_eq!(&found(packing, &leaves, &query), &plain);
                }
                if has_avx2() && has_avx512() {
                    // SAFETY: it has.
                    #[allow(unsafe_code)]
                    let packing = unsafe { Avx512::known() };
                    prop_assert_eq!(&found(packing, &leaves, &query), &plain);
                }
            }
        }
    }
}

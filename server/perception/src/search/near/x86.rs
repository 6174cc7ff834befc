//! Packing by single instructions, or by a table of permutations.

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

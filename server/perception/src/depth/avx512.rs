//! What the compiler does not find by itself with vectors of 512 bits: points packed without their holes, and
//! coordinates laid out as points. Each has a plain version beside its caller, which it is tested against.

use super::room::Room;
use nalgebra::Point3;
use std::arch::x86_64::{
    __m512, _CMP_GE_OQ, _CMP_LE_OQ, _CMP_ORD_Q, _mm512_add_ps, _mm512_cmp_ps_mask, _mm512_loadu_epi32,
    _mm512_mask_permutexvar_ps, _mm512_maskz_compress_ps, _mm512_mul_ps, _mm512_permutex2var_ps, _mm512_set1_ps,
    _mm512_setzero_ps,
};

/// Numbers in a vector.
pub(super) const LANES: usize = 16;

/// Entry by entry of 16 points in three vectors: which of x (0 to 15) or y (16 to 31) it is, and which of z.
const TABLES: [([i32; LANES], [i32; LANES], u16); 3] = {
    let mut out = [([0; LANES], [0; LANES], 0u16); 3];
    let mut at = 0;
    while at < 3 * LANES {
        let (k, lane, point) = (at / LANES, at % LANES, at as i32 / 3);
        match at % 3 {
            0 => out[k].0[lane] = point,
            1 => out[k].0[lane] = point + LANES as i32,
            _ => {
                out[k].1[lane] = point;
                out[k].2 |= 1 << lane;
            }
        }
        at += 1;
    }
    out
};

#[inline]
#[target_feature(enable = "avx512f")]
fn load(v: &[f32; LANES]) -> __m512 {
    // SAFETY: both are 16 numbers of 32 bits, and any bits are a number.
    #[allow(unsafe_code)]
    unsafe {
        std::mem::transmute::<[f32; LANES], __m512>(*v)
    }
}

/// The points with these coordinates.
#[inline]
#[target_feature(enable = "avx512f")]
fn points(x: __m512, y: __m512, z: __m512) -> [Point3<f32>; LANES] {
    let three = TABLES.each_ref().map(|(xy, of_z, z_lanes)| {
        // SAFETY: sixteen indices are read where sixteen stand.
        #[allow(unsafe_code)]
        let (xy, of_z) = unsafe { (_mm512_loadu_epi32(xy.as_ptr()), _mm512_loadu_epi32(of_z.as_ptr())) };
        _mm512_mask_permutexvar_ps(_mm512_permutex2var_ps(x, xy, y), *z_lanes, of_z, z)
    });
    // SAFETY: a point is three numbers of 32 bits, in this order and nothing between (`repr(C)`).
    #[allow(unsafe_code)]
    unsafe {
        std::mem::transmute::<[__m512; 3], [Point3<f32>; LANES]>(three)
    }
}

/// Appends the points of whole blocks of pixels.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,popcnt")]
pub(super) fn points_of_blocks(
    depths: &[[f32; LANES]],
    xs: &[[f32; LANES]],
    ys: &[[f32; LANES]],
    (min, max): (f32, f32),
    out: &mut Room<'_, Point3<f32>>,
) {
    let (min, max) = (_mm512_set1_ps(min), _mm512_set1_ps(max));
    for ((d, x), y) in depths.iter().zip(xs).zip(ys) {
        let (d, x, y) = (load(d), load(x), load(y));
        // A ray that is not finite makes the sum so; times zero it is NaN.
        let sum = _mm512_mul_ps(_mm512_add_ps(x, y), _mm512_setzero_ps());
        let good = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(d, min)
            & _mm512_cmp_ps_mask::<_CMP_LE_OQ>(d, max)
            & _mm512_cmp_ps_mask::<_CMP_ORD_Q>(sum, sum);
        let pack = |v| _mm512_maskz_compress_ps(good, v);
        out.push(&points(pack(_mm512_mul_ps(x, d)), pack(_mm512_mul_ps(y, d)), pack(d)), good.count_ones() as usize);
    }
}

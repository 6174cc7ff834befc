//! Fast paths chosen when the program runs, so that one binary serves every processor of its kind.

/// Defines a function whose body is compiled twice: for any processor, and for those with AVX2, where the compiler may
/// use wider vectors. Which one runs is found out at run time.
///
/// Both do the same operations in the same order (the compiler never fuses a multiplication with an addition by
/// itself), so that results are equal to the last bit. Loops in the body should be simple enough for the compiler to
/// vectorise; what they call has to be `#[inline]`. Arguments are plain names; no generics.
///
/// ```
/// percept_geometry::by_processor! {
///     /// Sum of squares.
///     fn energy(values: &[f32]) -> f32 {
///         let mut sums = [0.0f32; 8];
///         for chunk in values.chunks(8) {
///             sums.iter_mut().zip(chunk).for_each(|(s, v)| *s += v * v);
///         }
///         sums.iter().sum()
///     }
/// }
/// assert_eq!(energy(&[1.0, 2.0]), 5.0);
/// ```
///
/// `by_processor! { [avx512] fn ... }` compiles the body a third time, for vectors of 512 bits: for loops over whole
/// images, where twice the width is worth it. Taken on processors with AVX-512 VBMI2 only, which do not slow down their
/// clock for it as the first ones with AVX-512 did.
#[macro_export]
macro_rules! by_processor {
    ([avx512] $(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            fn plain($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi2")]
                fn widest($($arg: $ty),*) $(-> $ret)? {
                    plain($($arg),*)
                }
                if $crate::simd::has_avx512() {
                    // SAFETY: this processor has every feature that `widest` is compiled for.
                    #[allow(unsafe_code)]
                    return unsafe { widest($($arg),*) };
                }
            }
            $crate::by_processor! { fn narrower($($arg: $ty),*) $(-> $ret)? { plain($($arg),*) } }
            narrower($($arg),*)
        }
    };
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            fn any($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
                fn wide($($arg: $ty),*) $(-> $ret)? {
                    any($($arg),*)
                }
                if is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
                    && is_x86_feature_detected!("lzcnt")
                    && is_x86_feature_detected!("popcnt")
                {
                    // SAFETY: this processor has every feature that `wide` is compiled for.
                    #[allow(unsafe_code)]
                    return unsafe { wide($($arg),*) };
                }
            }
            any($($arg),*)
        }
    };
}

/// Whether the processor has what `by_processor! { [avx512] ... }` compiles for.
#[cfg(target_arch = "x86_64")]
#[inline]
pub fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512vbmi2")
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
}

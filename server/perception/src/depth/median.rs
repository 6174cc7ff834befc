//! Medians over 3 x 3 and 5 x 5 pixels.
//!
//! Bound: a 5 x 5 window costs 116 minima and maxima, 18 of them shared along the row's columns, in vectors of as many
//! pixels as the processor's registers hold; memory is read from the first-level cache.

use super::size;
use percept_geometry::{DepthImage, GeometryError, by_processor};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What pixels without return (0) do in a median.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MedianHoles {
    /// Zero counts as a depth of zero, as in OpenCV's `medianBlur`: lone holes close, lone returns vanish.
    #[default]
    AsZero,
    /// Holes stay holes and do not count: the lower median of the window's returns.
    Ignored,
}

/// How [`median`] filters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MedianParams {
    /// Side of the window, pixels: 3 or 5.
    pub size_px: usize,
    /// What pixels without return do.
    pub holes: MedianHoles,
}

impl Default for MedianParams {
    fn default() -> Self {
        Self { size_px: 5, holes: MedianHoles::AsZero }
    }
}

impl MedianParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        if matches!(self.size_px, 3 | 5) {
            return Ok(());
        }
        Err(GeometryError::OutOfRange { field: "size_px", value: self.size_px as f64, requirement: "3 or 5" })
    }
}

/// The median of every pixel's window, metres in and out. Beyond the border the border pixel repeats.
///
/// Source: columns sorted once for all windows that share them, then rows, then the anti-diagonals that can hold the
/// median; after Paeth, "Median finding on a 3x3 grid", Graphics Gems, 1990, taken to 5 x 5.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn median(depth: &DepthImage, params: &MedianParams) -> Result<DepthImage, GeometryError> {
    params.validate()?;
    let (w, h) = size(depth);
    DepthImage::new(w, h, filter(depth.data(), w, params, band_f32))
}

/// As [`median`], on 16-bit units, `H x W` row-major; 0 is no return.
///
/// # Errors
/// `OutOfRange` naming the parameter; `ShapeMismatch` if `units` is not `width * height` long.
pub fn median_units(
    units: &[u16],
    width: usize,
    height: usize,
    params: &MedianParams,
) -> Result<Vec<u16>, GeometryError> {
    params.validate()?;
    let expected = width.saturating_mul(height);
    if units.len() != expected {
        return Err(GeometryError::ShapeMismatch { field: "depth", expected, actual: units.len() });
    }
    Ok(filter(units, width, params, band_u16))
}

/// Rows of one unit of work; fixed, so that results do not depend on threads.
const BAND: usize = 60;
/// Pixels that are worked on together.
const BLOCK: usize = 64;

type Band<T> = fn(&[T], usize, usize, bool, &mut [T]);

fn filter<T>(data: &[T], w: usize, params: &MedianParams, band: Band<T>) -> Vec<T>
where
    T: Copy + Default + PartialEq + PartialOrd + Send + Sync,
{
    let mut out = vec![T::default(); data.len()];
    if data.is_empty() {
        return out;
    }
    out.par_chunks_mut(w * BAND).enumerate().for_each(|(i, rows)| {
        band(data, w, i * BAND, params.size_px == 5, rows);
        if params.holes == MedianHoles::Ignored {
            without_holes(data, w, i * BAND, params.size_px / 2, rows);
        }
    });
    out
}

/// Replaces the medians of windows that hold a hole.
fn without_holes<T: Copy + Default + PartialEq + PartialOrd>(data: &[T], w: usize, v0: usize, r: usize, out: &mut [T]) {
    let (h, zero) = (data.len() / w, T::default());
    let mut window = Vec::with_capacity(25);
    for (i, pixel) in out.iter_mut().enumerate() {
        let (u, v) = (i % w, v0 + i / w);
        if data[v * w + u] == zero {
            *pixel = zero;
            continue;
        }
        window.clear();
        for y in 0..=2 * r {
            let row = (v + y).saturating_sub(r).min(h - 1) * w;
            for x in 0..=2 * r {
                window.push(data[row + (u + x).saturating_sub(r).min(w - 1)]);
            }
        }
        if window.contains(&zero) {
            window.retain(|d| *d != zero);
            let middle = (window.len() - 1) / 2;
            // No depth is NaN.
            let order = |a: &T, b: &T| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal);
            *pixel = *window.select_nth_unstable_by(middle, order).1;
        }
    }
}

#[inline(always)]
fn low<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

#[inline(always)]
fn high<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

#[inline(always)]
fn sort2<T: PartialOrd + Copy>(a: T, b: T) -> (T, T) {
    (low(a, b), high(a, b))
}

#[inline(always)]
fn sort3<T: PartialOrd + Copy>(a: T, b: T, c: T) -> [T; 3] {
    let (a, b) = sort2(a, b);
    let (b, c) = sort2(b, c);
    let (a, b) = sort2(a, b);
    [a, b, c]
}

#[inline(always)]
fn sort5<T: PartialOrd + Copy>(v: [T; 5]) -> [T; 5] {
    let ([a1, a2, a3], (b1, b2)) = (sort3(v[0], v[1], v[2]), sort2(v[3], v[4]));
    // The k-th least of two sorted lists is the least, over i + j = k, of the larger of their i-th and j-th.
    [
        low(a1, b1),
        low(low(a2, b2), high(a1, b1)),
        low(a3, low(high(a1, b2), high(a2, b1))),
        low(high(a2, b2), high(a3, b1)),
        high(a3, b2),
    ]
}

#[inline(always)]
fn median3<T: PartialOrd + Copy>(a: T, b: T, c: T) -> T {
    let (a, b) = sort2(a, b);
    high(a, low(b, c))
}

/// Of 9 values with sorted columns; `rows[k][i]` is the k-th of column i.
#[inline(always)]
fn median_of_3_columns<T: PartialOrd + Copy>(r: [[T; 3]; 3]) -> T {
    let least = high(high(r[0][0], r[0][1]), r[0][2]);
    let most = low(low(r[2][0], r[2][1]), r[2][2]);
    median3(least, median3(r[1][0], r[1][1], r[1][2]), most)
}

/// Of 25 values with sorted columns; `rows[k][i]` is the k-th of column i.
///
/// With rows sorted, too, the entry in row i, column j has at least (i + 1)(j + 1) - 1 others below it and
/// (5 - i)(5 - j) - 1 above, which leaves the three middle anti-diagonals: of the first only the largest can be the
/// median, of the last only the least (any other has too many on one side).
#[inline(always)]
fn median_of_5_columns<T: PartialOrd + Copy>(rows: [[T; 5]; 5]) -> T {
    let [a, b, c, d, e] = [sort5(rows[0]), sort5(rows[1]), sort5(rows[2]), sort5(rows[3]), sort5(rows[4])];
    let least = high(high(a[3], b[2]), high(c[1], d[0]));
    let most = low(low(b[4], c[3]), low(d[2], e[1]));
    median7([a[4], b[3], c[2], d[1], e[0]], least, most)
}

/// Drops the least and the largest of five, takes in one more, drops again.
#[inline(always)]
fn median7<T: PartialOrd + Copy>(five: [T; 5], f: T, g: T) -> T {
    let ((a, b), (c, d)) = (sort2(five[0], five[1]), sort2(five[2], five[3]));
    let ((a, c), (b, d)) = (sort2(a, c), sort2(b, d));
    let e = high(a, low(five[4], d));
    let ((b, c), (e, f)) = (sort2(b, c), sort2(e, f));
    median3(high(b, e), low(c, f), g)
}

macro_rules! bands {
    ($name:ident, $type:ty) => {
        by_processor! {
            [avx512]
            /// Medians of the rows from `v0` on, as many as `out` holds; 5 x 5 or 3 x 3.
            fn $name(data: &[$type], w: usize, v0: usize, five: bool, out: &mut [$type]) {
                let (h, room) = (data.len() / w, w.next_multiple_of(BLOCK));
                // Sorted columns, with two more on either side of the row.
                let mut sorted = [0, 1, 2, 3, 4].map(|_| vec![<$type>::default(); room + 4]);
                let mut source = [0, 1, 2, 3, 4].map(|_| vec![<$type>::default(); room]);
                for (i, out) in out.chunks_mut(w).enumerate() {
                    for (k, row) in source.iter_mut().enumerate() {
                        let v = (v0 + i + k).saturating_sub(2).min(h - 1);
                        row[..w].copy_from_slice(&data[v * w..(v + 1) * w]);
                    }
                    for x in (0..room).step_by(BLOCK) {
                        let mut block = [[<$type>::default(); BLOCK]; 5];
                        let chunk = |k: usize| source[k][x..].first_chunk::<BLOCK>().unwrap_or(&[0 as $type; BLOCK]);
                        let s = [chunk(0), chunk(1), chunk(2), chunk(3), chunk(4)];
                        let [b0, b1, b2, b3, b4] = &mut block;
                        if five {
                            for j in 0..BLOCK {
                                let c = sort5([s[0][j], s[1][j], s[2][j], s[3][j], s[4][j]]);
                                (b0[j], b1[j], b2[j], b3[j], b4[j]) = (c[0], c[1], c[2], c[3], c[4]);
                            }
                        } else {
                            for j in 0..BLOCK {
                                let c = sort3(s[1][j], s[2][j], s[3][j]);
                                (b0[j], b1[j], b2[j]) = (c[0], c[1], c[2]);
                            }
                        }
                        for (row, block) in sorted.iter_mut().zip(&block) {
                            row[x + 2..x + 2 + BLOCK].copy_from_slice(block);
                        }
                    }
                    for row in &mut sorted {
                        let (first, last) = (row[2], row[w + 1]);
                        row[..2].fill(first);
                        row[w + 2..w + 4].fill(last);
                    }
                    for x in (0..w).step_by(BLOCK) {
                        let mut block = [<$type>::default(); BLOCK];
                        const WIDE: usize = BLOCK + 4;
                        let chunk = |k: usize| sorted[k][x..].first_chunk::<WIDE>().unwrap_or(&[0 as $type; WIDE]);
                        let s = [chunk(0), chunk(1), chunk(2), chunk(3), chunk(4)];
                        if five {
                            for j in 0..BLOCK {
                                let at = |k: usize| [s[k][j], s[k][j + 1], s[k][j + 2], s[k][j + 3], s[k][j + 4]];
                                block[j] = median_of_5_columns([at(0), at(1), at(2), at(3), at(4)]);
                            }
                        } else {
                            for j in 0..BLOCK {
                                let at = |k: usize| [s[k][j + 1], s[k][j + 2], s[k][j + 3]];
                                block[j] = median_of_3_columns([at(0), at(1), at(2)]);
                            }
                        }
                        let n = BLOCK.min(w - x);
                        out[x..x + n].copy_from_slice(&block[..n]);
                    }
                }
            }
        }
    };
}

bands!(band_u16, u16);
bands!(band_f32, f32);

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn plain(data: &[u16], w: usize, params: &MedianParams) -> Vec<u16> {
        let (h, r) = (data.len() / w, params.size_px as isize / 2);
        let clamp = |x: isize, n: usize| x.clamp(0, n as isize - 1) as usize;
        let at = |i: usize| {
            let (u, v) = ((i % w) as isize, (i / w) as isize);
            let mut all: Vec<u16> = (-r..=r)
                .flat_map(|y| (-r..=r).map(move |x| (x, y)))
                .map(|(x, y)| data[clamp(v + y, h) * w + clamp(u + x, w)])
                .collect();
            if params.holes == MedianHoles::Ignored {
                if data[i] == 0 {
                    return 0;
                }
                all.retain(|d| *d > 0);
            }
            all.sort_unstable();
            all[(all.len() - 1) / 2]
        };
        (0..data.len()).map(at).collect()
    }

    #[test]
    fn medians_are_those_of_sorted_windows() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for (w, h) in [(1, 1), (1, 7), (7, 1), (3, 2), (64, 5), (70, 65), (131, 9)] {
            // Few values make ties, many make every order.
            for top in [2u16, 5, 60000] {
                let data: Vec<u16> = (0..w * h).map(|_| rng.random_range(0..top)).collect();
                for size_px in [3, 5] {
                    for holes in [MedianHoles::AsZero, MedianHoles::Ignored] {
                        let params = MedianParams { size_px, holes };
                        let expected = plain(&data, w, &params);
                        assert_eq!(median_units(&data, w, h, &params).unwrap(), expected, "{w} x {h}, {params:?}");
                        let metres = DepthImage::new(w, h, data.iter().map(|&d| f32::from(d)).collect()).unwrap();
                        let metres = median(&metres, &params).unwrap();
                        assert!(metres.data().iter().zip(&expected).all(|(a, b)| *a == f32::from(*b)));
                    }
                }
            }
        }
    }

    #[test]
    fn sizes_and_lengths_are_checked() {
        let params = MedianParams { size_px: 4, ..Default::default() };
        assert!(params.validate().unwrap_err().to_string().starts_with("size_px"));
        assert!(median_units(&[1, 2, 3], 2, 2, &MedianParams::default()).is_err());
        assert!(median_units(&[], 0, 0, &MedianParams::default()).unwrap().is_empty());
    }
}

//! Gaussian blur of byte images, sigma 2, 7 x 7, by two passes in 16-bit integers.

use super::pyramid::Level;
use percept_geometry::by_processor;

/// exp(-x^2 / 8) at 0, 1, 2, 3, of 256 in all.
const WEIGHTS: [u16; 4] = [56, 49, 33, 18];

/// The level blurred; pixels within 3 of the border are left as they are.
pub(super) fn blur(level: &Level) -> Level {
    let mut out = level.clone();
    if level.width < 7 || level.height < 7 {
        return out;
    }
    let mut column = vec![0u8; level.width];
    for v in 3..level.height - 3 {
        let rows: [&[u8]; 7] = std::array::from_fn(|k| level.row(v + k - 3));
        vertical(&rows, &mut column);
        let start = v * level.stride;
        horizontal(&column, &mut out.data[start + 3..start + level.width - 3]);
    }
    out
}

#[inline(always)]
fn mix(c: [u8; 7]) -> u8 {
    let s = |a: u8, b: u8| u16::from(a) + u16::from(b);
    let sum = u16::from(c[3]) * WEIGHTS[0]
        + s(c[2], c[4]) * WEIGHTS[1]
        + s(c[1], c[5]) * WEIGHTS[2]
        + s(c[0], c[6]) * WEIGHTS[3];
    // At most 255 * 256 + 128: no overflow.
    ((sum + 128) >> 8) as u8
}

by_processor! {
    fn vertical(rows: &[&[u8]; 7], out: &mut [u8]) -> () {
        let n = out.len();
        let [a, b, c, d, e, f, g] = rows.map(|r| &r[..n]);
        for i in 0..n {
            out[i] = mix([a[i], b[i], c[i], d[i], e[i], f[i], g[i]]);
        }
    }
}

by_processor! {
    fn horizontal(row: &[u8], out: &mut [u8]) -> () {
        let n = out.len();
        let [a, b, c, d, e, f, g]: [&[u8]; 7] = std::array::from_fn(|k| &row[k..k + n]);
        for i in 0..n {
            out[i] = mix([a[i], b[i], c[i], d[i], e[i], f[i], g[i]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_a_gaussian_that_keeps_brightness() {
        assert_eq!(WEIGHTS[0] + 2 * (WEIGHTS[1] + WEIGHTS[2] + WEIGHTS[3]), 256);
        let level = Level { width: 20, height: 20, stride: 20, data: vec![255; 400] };
        assert!(blur(&level).data.iter().all(|&b| b == 255));
        let mut level = Level { width: 20, height: 20, stride: 20, data: vec![0; 400] };
        level.data[10 * 20 + 10] = 255;
        let out = blur(&level);
        for (dx, dy) in [(0, 0), (1, 0), (2, 1), (3, 3)] {
            let d2 = f64::from(dx * dx + dy * dy);
            let truth = 255.0 * (-d2 / 8.0).exp() * (56.0f64 / 256.0).powi(2);
            let got = f64::from(out.data[(10 + dy as usize) * 20 + 10 + dx as usize]);
            assert!((got - truth).abs() < 1.2, "{dx} {dy} {got} {truth}");
        }
    }
}

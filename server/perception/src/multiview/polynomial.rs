//! Real roots of polynomials.

use nalgebra::Complex;

/// Real roots of the polynomial with coefficients `c[0] + c[1] x + ...`, ascending; multiple roots may come once.
///
/// All roots at once by Aberth's method ("Iteration methods for finding all zeros of a polynomial simultaneously",
/// 1973), those near the real axis polished by Newton's.
pub(super) fn real_roots(c: &[f64]) -> Vec<f64> {
    let scale = c.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    // `max` passes over NaN.
    if !(scale > 0.0 && c.iter().all(|v| v.is_finite())) {
        return vec![];
    }
    let degree = c.iter().rposition(|v| v.abs() > 1e-13 * scale).unwrap_or(0);
    let c: Vec<f64> = c[..=degree].iter().map(|v| v / c[degree]).collect();
    match degree {
        0 => vec![],
        1 => vec![-c[0]],
        _ => {
            let mut out: Vec<f64> = aberth(&c).into_iter().filter_map(|z| polished(&c, z)).collect();
            out.sort_by(f64::total_cmp);
            out.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * (1.0 + b.abs()));
            out
        }
    }
}

fn aberth(c: &[f64]) -> Vec<Complex<f64>> {
    let n = c.len() - 1;
    // Cauchy-like radius, and angles without symmetry about the real axis.
    let radius = (0..n).map(|i| c[i].abs().powf(1.0 / (n - i) as f64)).fold(0.0f64, f64::max).max(1e-9);
    let mut z: Vec<Complex<f64>> =
        (0..n).map(|i| Complex::from_polar(radius, 0.4 + std::f64::consts::TAU * i as f64 / n as f64)).collect();
    for _ in 0..60 {
        let mut moved = 0.0f64;
        for i in 0..n {
            let (p, dp) = evaluate(c, z[i]);
            if p.norm_sqr() == 0.0 {
                continue;
            }
            let newton = p / dp;
            let repulsion: Complex<f64> = (0..n).filter(|&j| j != i).map(|j| (z[i] - z[j]).inv()).sum();
            let step = newton / (Complex::new(1.0, 0.0) - newton * repulsion);
            if step.re.is_finite() && step.im.is_finite() {
                z[i] -= step;
                moved = moved.max(step.norm() / (1e-12 + z[i].norm()));
            }
        }
        if moved < 1e-10 {
            break;
        }
    }
    z
}

fn evaluate(c: &[f64], z: Complex<f64>) -> (Complex<f64>, Complex<f64>) {
    let zero = Complex::new(0.0, 0.0);
    c.iter().rev().fold((zero, zero), |(p, dp), &k| (p * z + k, dp * z + p))
}

fn polished(c: &[f64], z: Complex<f64>) -> Option<f64> {
    if z.im.abs() > 1e-4 * (1.0 + z.re.abs()) {
        return None;
    }
    let mut x = z.re;
    for _ in 0..3 {
        let (p, dp) = c.iter().rev().fold((0.0, 0.0), |(p, dp), &k| (p * x + k, dp * x + p));
        if dp != 0.0 {
            x -= p / dp;
        }
    }
    // A root of the real polynomial moves little; what was near the axis only by chance runs away.
    (x.is_finite() && (x - z.re).abs() <= 1e-3 * (1.0 + z.re.abs())).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_roots_of_a_product_of_factors_come_back(
            mut roots in prop::collection::vec(-5.0..5.0f64, 1..7), pairs in prop::collection::vec((-2.0..2.0f64, 0.5..2.0f64), 0..3),
        ) {
            roots.sort_by(f64::total_cmp);
            prop_assume!(roots.windows(2).all(|w| w[1] - w[0] > 0.2));
            let times = |c: &[f64], f: &[f64]| {
                let mut out = vec![0.0; c.len() + f.len() - 1];
                for (i, a) in c.iter().enumerate() { for (j, b) in f.iter().enumerate() { out[i + j] += a * b; } }
                out
            };
            let mut c = vec![2.0];
            for r in &roots { c = times(&c, &[-r, 1.0]); }
            for (re, im) in &pairs { c = times(&c, &[re * re + im * im, -2.0 * re, 1.0]); }
            let found = real_roots(&c);
            prop_assert_eq!(found.len(), roots.len());
            for (a, b) in found.iter().zip(&roots) { prop_assert!((a - b).abs() < 1e-5, "{} {}", a, b); }
        }
    }

    #[test]
    fn constants_and_nothing_have_no_roots() {
        assert!(real_roots(&[]).is_empty());
        assert!(real_roots(&[3.0]).is_empty());
        assert!(real_roots(&[0.0, 0.0]).is_empty());
        assert!(real_roots(&[f64::NAN, 1.0]).is_empty());
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
        assert_eq!(real_roots(&[-6.0, 2.0, 0.0]), [3.0]);
    }
}

//! Real roots of polynomials by Sturm's theorem.

/// Most coefficients.
const MAX: usize = 11;

/// A polynomial of degree 10 at most: coefficients of 1, x, x^2 …
#[derive(Clone, Copy)]
struct Poly {
    c: [f64; MAX],
    degree: usize,
}

impl Poly {
    fn at(&self, x: f64) -> f64 {
        self.c[..=self.degree].iter().rev().fold(0.0, |sum, c| sum * x + c)
    }

    /// Without leading coefficients that are nothing beside the others; none if nothing is left.
    fn trimmed(mut self, tolerance: f64) -> Option<Self> {
        let most = self.c[..=self.degree].iter().fold(0.0f64, |m, c| m.max(c.abs()));
        if !(most > 0.0 && most.is_finite()) {
            return None;
        }
        while self.c[self.degree].abs() <= tolerance * most {
            if self.degree == 0 {
                return None;
            }
            self.degree -= 1;
        }
        let scale = 1.0 / self.c[self.degree].abs();
        self.c[..=self.degree].iter_mut().for_each(|c| *c *= scale);
        Some(self)
    }

    /// No root is larger (Fujiwara 1916); with room for roundings. The leading coefficient is 1 or -1.
    fn bound(&self) -> f64 {
        let root = |i: usize| (self.c[i].abs().ln() / (self.degree - i) as f64).exp();
        2.001 * (0..self.degree).map(root).fold(1e-9, f64::max)
    }

    fn derivative(&self) -> Self {
        let mut c = [0.0; MAX];
        for i in 1..=self.degree {
            c[i - 1] = self.c[i] * i as f64;
        }
        Self { c, degree: self.degree.saturating_sub(1) }
    }

    /// Minus the remainder of a division.
    fn minus_remainder(&self, by: &Self) -> Option<Self> {
        let mut r = self.c;
        for top in (by.degree..=self.degree).rev() {
            let q = r[top] / by.c[by.degree];
            for i in 0..=by.degree {
                r[top - by.degree + i] -= q * by.c[i];
            }
        }
        if by.degree == 0 {
            return None;
        }
        let mut c = [0.0; MAX];
        (0..by.degree).for_each(|i| c[i] = -r[i]);
        let scale = self.c[..=self.degree].iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let most = c[..by.degree].iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if most <= 1e-14 * scale {
            return None;
        }
        Self { c, degree: by.degree - 1 }.trimmed(1e-14)
    }
}

/// Distinct real roots of the polynomial with coefficients `c[0] + c[1] x + ...` of degree 10 at most, ascending.
///
/// **Source:** Sturm 1829; used for relative pose by Nister 2004. Roots are isolated by halving, then polished by
/// Newton steps that stay inside.
pub(super) fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    let mut c = [0.0; MAX];
    let n = coefficients.len().min(MAX);
    c[..n].copy_from_slice(&coefficients[..n]);
    let mut roots = Vec::new();
    let Some(poly) = (Poly { c, degree: n.saturating_sub(1) }).trimmed(1e-13) else { return roots };
    if poly.degree == 0 {
        return roots;
    }
    let mut chain = [poly; MAX];
    let mut length = 1;
    let mut next = poly.derivative().trimmed(0.0);
    while let Some(p) = next {
        chain[length] = p;
        length += 1;
        next = if length < MAX { chain[length - 2].minus_remainder(&chain[length - 1]) } else { None };
    }
    let chain = &chain[..length];
    let bound = poly.bound();
    let (low, high) = (changes(chain, -bound), changes(chain, bound));
    isolate(chain, [-bound, bound], [low, high], 0, &mut roots);
    roots
}

/// Changes of sign along the chain.
fn changes(chain: &[Poly], x: f64) -> usize {
    let (mut count, mut before) = (0, 0.0f64);
    for p in chain {
        let value = p.at(x);
        if value != 0.0 {
            count += usize::from(before * value.signum() < 0.0);
            before = value.signum();
        }
    }
    count
}

fn isolate(chain: &[Poly], [a, b]: [f64; 2], [va, vb]: [usize; 2], depth: usize, out: &mut Vec<f64>) {
    let inside = va.saturating_sub(vb);
    if inside == 0 || out.len() >= chain[0].degree {
        return;
    }
    let polish_now = inside == 1 && chain[0].at(a) * chain[0].at(b) <= 0.0;
    if polish_now || depth > 60 {
        out.push(polish(&chain[0], a, b));
        return;
    }
    let middle = 0.5 * (a + b);
    let vm = changes(chain, middle);
    isolate(chain, [a, middle], [va, vm], depth + 1, out);
    isolate(chain, [middle, b], [vm, vb], depth + 1, out);
}

/// Newton's steps where they stay between a change of sign, halving where not.
fn polish(p: &Poly, mut a: f64, mut b: f64) -> f64 {
    let derivative = p.derivative();
    let rising = p.at(a) < 0.0;
    let mut x = 0.5 * (a + b);
    for _ in 0..100 {
        let value = p.at(x);
        if value == 0.0 {
            return x;
        }
        if (value < 0.0) == rising {
            a = x
        } else {
            b = x
        }
        let newton = x - value / derivative.at(x);
        let next = if newton > a && newton < b { newton } else { 0.5 * (a + b) };
        let step = (next - x).abs();
        x = next;
        if step <= 1e-14 * x.abs().max(1e-3) {
            break;
        }
    }
    x
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

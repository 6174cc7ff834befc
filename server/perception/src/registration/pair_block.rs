//! Sums of many pairs at once, in lanes that the compiler can vectorise.

use super::NormalEquations;

/// Pairs a block holds.
pub(super) const BLOCK: usize = 256;
/// Pairs that are summed side by side.
const LANES: usize = 8;

/// Pairs of points, each with the information that its difference is weighted by, one array a component.
///
/// A pair adds `e' W e` with `e = p + (target point in the source frame, negated)`; under `exp(xi)` the difference
/// moves by `v + w x p`. Everything is in the source frame.
pub struct PairBlock {
    /// Source point.
    p: [[f64; BLOCK]; 3],
    /// Moved source point minus target point, turned back into the source frame.
    e: [[f64; BLOCK]; 3],
    /// Upper triangle of the information, weight included.
    w: [[f64; BLOCK]; 6],
    len: usize,
}

impl Default for PairBlock {
    fn default() -> Self {
        Self { p: [[0.0; BLOCK]; 3], e: [[0.0; BLOCK]; 3], w: [[0.0; BLOCK]; 6], len: 0 }
    }
}

impl PairBlock {
    /// Adds a pair; a full block takes no more.
    #[inline]
    pub fn push(&mut self, p: [f64; 3], e: [f64; 3], information: &[f64; 6], weight: f64) {
        let i = self.len;
        if i == BLOCK {
            return;
        }
        for k in 0..3 {
            self.p[k][i] = p[k];
            self.e[k][i] = e[k];
        }
        for (w, value) in self.w.iter_mut().zip(information) {
            w[i] = weight * value;
        }
        self.len = i + 1;
    }

    /// Sums of all pairs, each counted as `residuals_a_pair` residuals.
    pub fn sum(&mut self, residuals_a_pair: usize) -> NormalEquations {
        // What is left of the last lanes must not count.
        for i in self.len..self.len.next_multiple_of(LANES) {
            self.w.iter_mut().for_each(|w| w[i] = 0.0);
            self.p.iter_mut().chain(&mut self.e).for_each(|v| v[i] = 0.0);
        }
        let mut out = [0.0; 28];
        sum_lanes(self, &mut out);
        NormalEquations::from_sums(&out, self.len * residuals_a_pair)
    }
}

percept_geometry::by_processor! {
    /// Upper triangle of the Hessian, gradient, cost.
    fn sum_lanes(block: &PairBlock, out: &mut [f64; 28]) {
        let mut sums = [[0.0f64; LANES]; 28];
        let mut start = 0;
        while start < block.len && start + LANES <= BLOCK {
            let lane = |v: &[f64; BLOCK]| -> [f64; LANES] { std::array::from_fn(|l| v[start + l]) };
            let [px, py, pz] = [lane(&block.p[0]), lane(&block.p[1]), lane(&block.p[2])];
            let [ex, ey, ez] = [lane(&block.e[0]), lane(&block.e[1]), lane(&block.e[2])];
            let [xx, xy, xz] = [lane(&block.w[0]), lane(&block.w[1]), lane(&block.w[2])];
            let [yy, yz, zz] = [lane(&block.w[3]), lane(&block.w[4]), lane(&block.w[5])];
            for l in 0..LANES {
                let p = [px[l], py[l], pz[l]];
                let w = [[xx[l], xy[l], xz[l]], [xy[l], yy[l], yz[l]], [xz[l], yz[l], zz[l]]];
                // Rows of W J: the translation's block is W, the rotation's is B = p x (rows of W).
                let b = [cross(&p, &w[0]), cross(&p, &w[1]), cross(&p, &w[2])];
                // Its own block is p x (columns of B).
                let r0 = cross(&p, &[b[0][0], b[1][0], b[2][0]]);
                let r1 = cross(&p, &[b[0][1], b[1][1], b[2][1]]);
                let r2 = cross(&p, &[b[0][2], b[1][2], b[2][2]]);
                let f = [
                    w[0][0] * ex[l] + w[0][1] * ey[l] + w[0][2] * ez[l],
                    w[1][0] * ex[l] + w[1][1] * ey[l] + w[1][2] * ez[l],
                    w[2][0] * ex[l] + w[2][1] * ey[l] + w[2][2] * ez[l],
                ];
                let m = cross(&p, &f);
                let cost = f[0] * ex[l] + f[1] * ey[l] + f[2] * ez[l];
                let all = [
                    w[0][0], w[0][1], w[0][2], b[0][0], b[0][1], b[0][2],
                    w[1][1], w[1][2], b[1][0], b[1][1], b[1][2],
                    w[2][2], b[2][0], b[2][1], b[2][2],
                    r0[0], r1[0], r2[0], r1[1], r2[1], r2[2],
                    f[0], f[1], f[2], m[0], m[1], m[2], cost,
                ];
                for k in 0..28 {
                    sums[k][l] += all[k];
                }
            }
            start += LANES;
        }
        for (o, lanes) in out.iter_mut().zip(&sums) {
            *o = lanes.iter().sum();
        }
    }
}

#[inline(always)]
fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::factors::{gicp, point_to_point};
    use nalgebra::{Matrix3, Point3, Vector3, Vector6};
    use percept_geometry::se3;

    #[test]
    fn identity_information_sums_as_the_rows_of_point_to_point() {
        let t = se3::exp(&Vector6::new(0.3, -0.5, 1.0, 0.4, 0.2, -0.7));
        let r = *t.rotation.to_rotation_matrix().matrix();
        let (mut rows, mut block) = (NormalEquations::default(), PairBlock::default());
        for i in 0..37 {
            let at = |k: f64| (f64::from(i) * k).sin() * 3.0;
            let (p, q) = (Vector3::new(at(1.0), at(2.0), at(3.0)), Vector3::new(at(4.0), at(5.0), at(6.0)));
            let moved = (t * Point3::from(p)).coords;
            for (residual, row) in point_to_point::residuals(&r, &p, &moved, &q) {
                rows.add(&row, residual, 2.0);
            }
            let e = r.tr_mul(&(moved - q));
            block.push(p.into(), e.into(), &[1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 2.0);
        }
        let sums = block.sum(3);
        assert!((sums.hessian() - rows.hessian()).abs().max() < 1e-9);
        assert!((sums.gradient() - rows.gradient()).abs().max() < 1e-9);
        assert!((sums.cost - rows.cost).abs() < 1e-9 && sums.num_residuals == rows.num_residuals);
    }

    #[test]
    fn the_gradient_is_half_of_the_numeric_derivative_of_the_cost() {
        let t = se3::exp(&Vector6::new(0.3, -0.5, 1.0, 0.4, 0.2, -0.7));
        let (p, q) = (Vector3::new(1.0, 2.0, -0.5), Vector3::new(0.2, 1.5, 0.3));
        let w = gicp::information(&Vector3::new(0.6, 0.0, 0.8), &Vector3::new(0.0, -0.6, 0.8));
        let full = Matrix3::new(w[0], w[1], w[2], w[1], w[3], w[4], w[2], w[4], w[5]);
        let difference = |xi: &Vector6<f64>| t.rotation.inverse() * ((t * se3::exp(xi) * Point3::from(p)).coords - q);
        let cost = |xi: &Vector6<f64>| difference(xi).dot(&(full * difference(xi)));
        let mut block = PairBlock::default();
        block.push(p.into(), difference(&Vector6::zeros()).into(), &w, 1.0);
        let sums = block.sum(3);
        for i in 0..6 {
            let mut d = Vector6::zeros();
            d[i] = 1e-6;
            let numeric = (cost(&d) - cost(&-d)) / 2e-6;
            assert!((0.5 * numeric - sums.gradient()[i]).abs() < 1e-5 * (1.0 + numeric.abs()), "axis {i}");
        }
        assert!((sums.cost - cost(&Vector6::zeros())).abs() < 1e-9);
    }
}

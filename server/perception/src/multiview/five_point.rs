//! Essential matrices through five correspondences.

use super::polynomial::real_roots;
use nalgebra::{Matrix3, SMatrix, Vector2};

/// Polynomials in x, y, z of degree 1: coefficients of x, y, z, 1.
type Linear = [f64; 4];
/// Of degree 2: xx, xy, yy, xz, yz, zz, x, y, z, 1.
type Quadratic = [f64; 10];
/// Of degree 3, in the order that elimination wants: xxx, yyy, xxy, xyy, xxz, xx, yyz, yy, xyz, xy, then
/// x, xz, xzz, y, yz, yzz, 1, z, zz, zzz.
type Cubic = [f64; 20];

/// Every essential matrix E (Frobenius norm 1) with `b' E a = 0` for five pairs of normalised points; up to ten.
///
/// Source: Nister, "An efficient solution to the five-point relative pose problem", 2004: the null space of the epipolar
/// constraints, ten cubics in its coordinates, eliminated to a polynomial of degree ten in z.
pub(super) fn essential_matrices(pairs: &[(Vector2<f64>, Vector2<f64>)], out: &mut Vec<Matrix3<f64>>) {
    let Some(basis) = null_space(pairs) else { return };
    let Some(rows) = eliminate(constraints(&basis)) else { return };
    // Rows 4..10 have xxz, xx, yyz, yy, xyz, xy as leading terms. Differences leave x, y, 1 with polynomials in z.
    let b = [less(&rows[4], &rows[5]), less(&rows[6], &rows[7]), less(&rows[8], &rows[9])];
    for z in real_roots(&determinant(&b)) {
        let at = |p: &[f64]| p.iter().rev().fold(0.0, |s, c| s * z + c);
        let row = |r: &Eliminated| nalgebra::Vector3::new(at(&r.x), at(&r.y), at(&r.one));
        let [r0, r1, r2] = [row(&b[0]), row(&b[1]), row(&b[2])];
        // x, y, 1 span the null space: the best conditioned cross product of two rows.
        let crossed = [r0.cross(&r1), r0.cross(&r2), r1.cross(&r2)];
        let v = crossed.into_iter().fold(crossed[0], |m, c| if c.norm_squared() > m.norm_squared() { c } else { m });
        let (x, y) = (v.x / v.z, v.y / v.z);
        let e = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
        let norm = e.norm();
        if norm.is_finite() && norm > 0.0 {
            out.push(e / norm);
        }
    }
}

/// Four matrices that span what the epipolar constraints leave open; none if they leave more.
fn null_space(pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Option<[Matrix3<f64>; 4]> {
    // Gauss-Jordan with full pivoting on 5 x 9; entries of E row by row.
    let mut a = [[0.0f64; 9]; 5];
    for (row, (p, q)) in a.iter_mut().zip(pairs) {
        *row = [q.x * p.x, q.x * p.y, q.x, q.y * p.x, q.y * p.y, q.y, p.x, p.y, 1.0];
    }
    let mut columns: [usize; 9] = std::array::from_fn(|i| i);
    for step in 0..5 {
        let (mut best, mut at) = (0.0, (step, step));
        for (r, row) in a.iter().enumerate().skip(step) {
            for (c, v) in row.iter().enumerate().skip(step) {
                if v.abs() > best {
                    (best, at) = (v.abs(), (r, c));
                }
            }
        }
        if best < 1e-12 {
            return None;
        }
        a.swap(step, at.0);
        a.iter_mut().for_each(|row| row.swap(step, at.1));
        columns.swap(step, at.1);
        let pivot = a[step];
        for (r, row) in a.iter_mut().enumerate() {
            if r == step {
                row.iter_mut().for_each(|v| *v /= pivot[step]);
            } else {
                let f = row[step] / pivot[step];
                row.iter_mut().zip(&pivot).for_each(|(v, p)| *v -= f * p);
            }
        }
    }
    let mut vectors = SMatrix::<f64, 9, 4>::zeros();
    for k in 0..4 {
        vectors[(columns[5 + k], k)] = 1.0;
        for i in 0..5 {
            vectors[(columns[i], k)] = -a[i][5 + k];
        }
    }
    let q = vectors.qr().q();
    Some(std::array::from_fn(|k| Matrix3::from_row_slice(q.column(k).as_slice())))
}

fn times(a: &Linear, b: &Linear) -> Quadratic {
    [
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[1] * b[1],
        a[0] * b[2] + a[2] * b[0],
        a[1] * b[2] + a[2] * b[1],
        a[2] * b[2],
        a[0] * b[3] + a[3] * b[0],
        a[1] * b[3] + a[3] * b[1],
        a[2] * b[3] + a[3] * b[2],
        a[3] * b[3],
    ]
}

fn times3(q: &Quadratic, l: &Linear) -> Cubic {
    let [xx, xy, yy, xz, yz, zz, x, y, z, one] = *q;
    let [lx, ly, lz, l1] = *l;
    [
        xx * lx,
        yy * ly,
        xx * ly + xy * lx,
        xy * ly + yy * lx,
        xx * lz + xz * lx,
        xx * l1 + x * lx,
        yy * lz + yz * ly,
        yy * l1 + y * ly,
        xy * lz + xz * ly + yz * lx,
        xy * l1 + x * ly + y * lx,
        x * l1 + one * lx,
        xz * l1 + x * lz + z * lx,
        xz * lz + zz * lx,
        y * l1 + one * ly,
        yz * l1 + y * lz + z * ly,
        yz * lz + zz * ly,
        one * l1,
        z * l1 + one * lz,
        zz * l1 + z * lz,
        zz * lz,
    ]
}

fn add<const N: usize>(a: &mut [f64; N], b: &[f64; N], factor: f64) {
    a.iter_mut().zip(b).for_each(|(x, y)| *x += factor * y);
}

// Three nested indices of small matrices read better than iterators.
#[allow(clippy::needless_range_loop)]
/// det E = 0 and 2 E E' E - tr(E E') E = 0 as ten cubics.
fn constraints(basis: &[Matrix3<f64>; 4]) -> [Cubic; 10] {
    let e = |r: usize, c: usize| -> Linear { std::array::from_fn(|k| basis[k][(r, c)]) };
    // E E' is symmetric.
    let mut eet = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in i..3 {
            for k in 0..3 {
                add(&mut eet[i][j], &times(&e(i, k), &e(j, k)), 1.0);
            }
            eet[j][i] = eet[i][j];
        }
    }
    let mut half_trace = [0.0; 10];
    (0..3).for_each(|i| add(&mut half_trace, &eet[i][i], 0.5));
    for (i, row) in eet.iter_mut().enumerate() {
        add(&mut row[i], &half_trace, -1.0);
    }
    let mut out = [[0.0; 20]; 10];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add(&mut out[3 * i + j], &times3(&eet[i][k], &e(k, j)), 1.0);
            }
        }
    }
    for (c, (a, b)) in [(0, (1, 2)), (1, (2, 0)), (2, (0, 1))] {
        let mut minor = times(&e(0, a), &e(1, b));
        add(&mut minor, &times(&e(0, b), &e(1, a)), -1.0);
        add(&mut out[9], &times3(&minor, &e(2, c)), 1.0);
    }
    out
}

/// Reduced row echelon form of the ten leading columns, with row pivoting.
fn eliminate(mut rows: [Cubic; 10]) -> Option<[Cubic; 10]> {
    for step in 0..10 {
        let pivot = (step..10).max_by(|&a, &b| rows[a][step].abs().total_cmp(&rows[b][step].abs()))?;
        if rows[pivot][step].abs() < 1e-14 {
            return None;
        }
        rows.swap(step, pivot);
        let scale = 1.0 / rows[step][step];
        rows[step].iter_mut().for_each(|v| *v *= scale);
        let head = rows[step];
        // Only rows 4..10 are read in the end: those above need no back substitution.
        for (r, row) in rows.iter_mut().enumerate() {
            if r != step && (r > step || r >= 4) {
                let f = row[step];
                add(row, &head, -f);
            }
        }
    }
    Some(rows)
}

/// A row without its quadratic terms: polynomials in z (ascending) before x, y and 1.
struct Eliminated {
    x: [f64; 4],
    y: [f64; 4],
    one: [f64; 5],
}

/// Row `a` less z times row `b`: their leading terms cancel.
fn less(a: &Cubic, b: &Cubic) -> Eliminated {
    let part = |from: usize| {
        let (a, b) = (&a[from..from + 3], &b[from..from + 3]);
        [a[0], a[1] - b[0], a[2] - b[1], -b[2]]
    };
    let (a1, b1) = (&a[16..20], &b[16..20]);
    Eliminated { x: part(10), y: part(13), one: [a1[0], a1[1] - b1[0], a1[2] - b1[1], a1[3] - b1[2], -b1[3]] }
}

/// Determinant of the three rows: degree ten in z, ascending.
fn determinant(b: &[Eliminated; 3]) -> [f64; 11] {
    let mut out = [0.0; 11];
    for (i, (j, k)) in [(0, (1, 2)), (1, (2, 0)), (2, (0, 1))] {
        let mut minor = [0.0; 7];
        for p in 0..4 {
            for q in 0..4 {
                minor[p + q] += b[j].x[p] * b[k].y[q] - b[k].x[p] * b[j].y[q];
            }
        }
        for (p, m) in minor.iter().enumerate() {
            for (q, c) in b[i].one.iter().enumerate() {
                out[p + q] += m * c;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_true_matrix_is_among_the_solutions() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut uniform = |low: f64, high: f64| rng.random_range(low..high);
        let (mut missed, samples) = (0, 3000);
        for _ in 0..samples {
            let mut vector = |size: f64| Vector3::from_fn(|_, _| uniform(-size, size));
            let (r, t) = (UnitQuaternion::from_scaled_axis(vector(0.5)), vector(1.0));
            let points: [Point3<f64>; 5] = std::array::from_fn(|_| Point3::from(vector(2.0)) + Vector3::z() * 6.0);
            let pairs = points.map(|p| {
                let q = r * p + t;
                (p.xy().coords / p.z, q.xy().coords / q.z)
            });
            let truth = t.cross_matrix() * r.to_rotation_matrix().matrix();
            let truth = truth / truth.norm();
            let mut found = vec![];
            essential_matrices(&pairs, &mut found);
            let off = found.iter().map(|e| (e - truth).norm().min((e + truth).norm())).fold(f64::INFINITY, f64::min);
            missed += usize::from(off > 1e-4);
        }
        // Samples near a degenerate configuration lose digits.
        assert!(missed * 200 < samples, "{missed} of {samples}");
    }

    #[test]
    fn degenerate_samples_give_nothing_or_something_finite() {
        let same = vec![(Vector2::new(0.1, 0.2), Vector2::new(0.1, 0.2)); 5];
        let mut found = vec![];
        essential_matrices(&same, &mut found);
        assert!(found.is_empty());
        let line: Vec<_> = (0..5)
            .map(|i| (Vector2::new(0.1 * f64::from(i), 0.0), Vector2::new(0.1 * f64::from(i) + 0.05, 0.0)))
            .collect();
        essential_matrices(&line, &mut found);
        assert!(found.iter().all(|e| e.iter().all(|v| v.is_finite())));
    }
}

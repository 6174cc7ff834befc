//! Cholesky factor of a sparse matrix of small blocks, and substitution with it: the hot loops.
//!
//! Left-looking: a panel of a few columns with the same rows is made from all earlier columns that reach it, then
//! factorised (Ng and Peyton, "Block sparse Cholesky algorithms on advanced uniprocessor computers", 1993). Blocks have a
//! fixed size, their columns are padded to whole vectors of the processor. Work: two multiplications and additions of `D`
//! cubed for every pair of blocks in a column of the factor.

use super::pattern::Pattern;
use percept_geometry::by_processor;

/// A block by columns: `D` of them, `D` numbers and zeros up to `P` each.
type Block<const D: usize, const P: usize> = [[f64; P]; D];

/// Numbers that a block takes: its columns are padded to a length that vectors of the processor divide.
pub(super) const fn stride(d: usize) -> usize {
    match d {
        3 => 4,
        6 => 8,
        d => d,
    }
}

/// The numbers as blocks.
fn blocks<const D: usize, const P: usize>(values: &[f64]) -> &[Block<D, P>] {
    values.as_chunks::<P>().0.as_chunks::<D>().0
}

fn blocks_mut<const D: usize, const P: usize>(values: &mut [f64]) -> &mut [Block<D, P>] {
    values.as_chunks_mut::<P>().0.as_chunks_mut::<D>().0
}

/// Replaces a matrix by its factor, both by the factor's blocks; false if it is not positive definite. `local` has a place
/// for every row.
pub(super) fn factorise<const D: usize>(pattern: &Pattern, values: &mut [f64], local: &mut [u32]) -> bool {
    match D {
        6 => factorise_6(pattern, values, local),
        4 => factorise_4(pattern, values, local),
        3 => factorise_3(pattern, values, local),
        _ => factorise_any::<D, D>(pattern, values, local),
    }
}

by_processor! { [avx512]
    fn factorise_6(pattern: &Pattern, values: &mut [f64], local: &mut [u32]) -> bool {
        factorise_any::<6, 8>(pattern, values, local)
    }
}

by_processor! {
    fn factorise_4(pattern: &Pattern, values: &mut [f64], local: &mut [u32]) -> bool {
        factorise_any::<4, 4>(pattern, values, local)
    }
}

by_processor! {
    fn factorise_3(pattern: &Pattern, values: &mut [f64], local: &mut [u32]) -> bool {
        factorise_any::<3, 4>(pattern, values, local)
    }
}

#[inline(always)]
fn factorise_any<const D: usize, const P: usize>(pattern: &Pattern, values: &mut [f64], local: &mut [u32]) -> bool {
    let values = blocks_mut::<D, P>(values);
    let rows = pattern.factor_rows();
    for (columns, updates) in pattern.panels() {
        let start = pattern.column(columns.start).start;
        let (earlier, panel) = values.split_at_mut(start);
        (0..).zip(&rows[pattern.column(columns.start)]).for_each(|(k, &row)| local[row as usize] = k);
        for update in updates {
            let (first, last) = (update.first as usize, update.last as usize);
            for t in first..update.end as usize {
                let a = &earlier[t];
                let at = local[rows[t] as usize];
                for m in first..last.min(t + 1) {
                    let column = rows[m] as usize;
                    let target = pattern.column(column).start - start + (at - local[column]) as usize;
                    subtract_product(&mut panel[target], a, &earlier[m]);
                }
            }
        }
        for j in columns.clone() {
            let own = pattern.column(j).start - start;
            let (before, column) = panel.split_at_mut(own);
            let column = &mut column[..pattern.column(j).len()];
            for m in columns.start..j {
                let from = pattern.column(m).start - start + (j - m);
                let multiplier = before[from];
                for (y, a) in column.iter_mut().zip(&before[from..]) {
                    subtract_product(y, a, &multiplier);
                }
            }
            let Some((diagonal, below)) = column.split_first_mut() else { return false };
            let Some(scales) = factorise_dense(diagonal) else { return false };
            below.iter_mut().for_each(|y| divide(y, diagonal, &scales));
        }
    }
    true
}

/// Runs a body for 0, 1 .. up to `$d`, at most 7, without a loop: the compiler would put neighbouring columns into a
/// vector, gathered from afar, instead of each column's own numbers.
macro_rules! unrolled {
    ($i:ident < $d:ident $body:block) => { unrolled! { $i < $d $body 0 1 2 3 4 5 6 } };
    ($i:ident < $d:ident $body:block $($n:literal)*) => {
        $(if $n < $d {
            const $i: usize = $n;
            $body
        })*
    };
}

/// `y -= a * b^T`.
#[inline(always)]
fn subtract_product<const D: usize, const P: usize>(y: &mut Block<D, P>, a: &Block<D, P>, b: &Block<D, P>) {
    const { assert!(D <= 7, "columns beyond would be left as they are") };
    unrolled! { C < D {
        let mut column = y[C];
        for k in 0..D {
            for r in 0..P {
                column[r] -= a[k][r] * b[k][C];
            }
        }
        y[C] = column;
    }}
}

/// Replaces a block by its factor, zeros above; the inverses of its diagonal. None if it is not positive definite.
#[inline(always)]
fn factorise_dense<const D: usize, const P: usize>(a: &mut Block<D, P>) -> Option<[f64; D]> {
    let mut scales = [0.0; D];
    for c in 0..D {
        let (done, rest) = a.split_at_mut(c);
        let column = &mut rest[0];
        for left in done.iter() {
            let factor = left[c];
            column.iter_mut().zip(left).for_each(|(v, l)| *v -= l * factor);
        }
        let pivot = column[c];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        scales[c] = 1.0 / pivot.sqrt();
        for (r, v) in column.iter_mut().enumerate() {
            *v = if r < c { 0.0 } else { *v * scales[c] };
        }
    }
    Some(scales)
}

/// `y = y * l^-T`, where `scales` are the inverses of the diagonal of `l`.
#[inline(always)]
fn divide<const D: usize, const P: usize>(y: &mut Block<D, P>, l: &Block<D, P>, scales: &[f64; D]) {
    for c in 0..D {
        let mut column = y[c];
        for k in 0..c {
            for r in 0..P {
                column[r] -= y[k][r] * l[k][c];
            }
        }
        y[c] = column.map(|v| v * scales[c]);
    }
}

/// Solves for `x` in place, a padded block row after the other in the pattern's order.
pub(super) fn substitute<const D: usize>(pattern: &Pattern, values: &[f64], x: &mut [f64]) {
    match D {
        6 => substitute_6(pattern, values, x),
        3 => substitute_3(pattern, values, x),
        _ => substitute_any::<D, D>(pattern, values, x),
    }
}

by_processor! { [avx512]
    fn substitute_6(pattern: &Pattern, values: &[f64], x: &mut [f64]) {
        substitute_any::<6, 8>(pattern, values, x);
    }
}

by_processor! {
    fn substitute_3(pattern: &Pattern, values: &[f64], x: &mut [f64]) {
        substitute_any::<3, 4>(pattern, values, x);
    }
}

#[inline(always)]
fn substitute_any<const D: usize, const P: usize>(pattern: &Pattern, values: &[f64], x: &mut [f64]) {
    let (values, rows) = (blocks::<D, P>(values), pattern.factor_rows());
    let x = x.as_chunks_mut::<P>().0;
    (0..pattern.len()).for_each(|j| forward(j, &values[pattern.column(j)], &rows[pattern.column(j)], x));
    for j in (0..pattern.len()).rev() {
        let range = pattern.column(j);
        let mut sums: Block<D, P> = [[0.0; P]; D];
        for (l, &row) in values[range.clone()].iter().zip(&rows[range.clone()]).skip(1) {
            let known = &x[row as usize];
            for c in 0..D {
                for r in 0..P {
                    sums[c][r] += l[c][r] * known[r];
                }
            }
        }
        let l = &values[range.start];
        for c in (0..D).rev() {
            let below: f64 = (c + 1..D).map(|r| l[c][r] * x[j][r]).sum();
            x[j][c] = (x[j][c] - sums[c].iter().sum::<f64>() - below) / l[c][c];
        }
    }
}

/// The first half of [`substitute`] for an `x` of zeros but for row `j`: only the rows that hang on it change.
pub(super) fn climb<const D: usize>(pattern: &Pattern, values: &[f64], j: usize, x: &mut [f64]) {
    match D {
        6 => climb_any::<6, 8>(pattern, values, j, x),
        3 => climb_any::<3, 4>(pattern, values, j, x),
        _ => climb_any::<D, D>(pattern, values, j, x),
    }
}

fn climb_any<const D: usize, const P: usize>(pattern: &Pattern, values: &[f64], j: usize, x: &mut [f64]) {
    let (values, x) = (blocks::<D, P>(values), x.as_chunks_mut::<P>().0);
    let mut next = Some(j);
    while let Some(j) = next {
        let rows = &pattern.factor_rows()[pattern.column(j)];
        forward(j, &values[pattern.column(j)], rows, x);
        next = rows.get(1).map(|&parent| parent as usize);
    }
}

/// Solves row `j` with the blocks of its column and takes it out of the rows below.
#[inline(always)]
fn forward<const D: usize, const P: usize>(j: usize, column: &[Block<D, P>], rows: &[u32], x: &mut [[f64; P]]) {
    let Some((l, below)) = column.split_first() else { return };
    let mut known = x[j];
    for c in 0..D {
        known[c] /= l[c][c];
        for r in c + 1..D {
            known[r] -= l[c][r] * known[c];
        }
    }
    x[j] = known;
    for (l, &row) in below.iter().zip(&rows[1..]) {
        let target = &mut x[row as usize];
        for c in 0..D {
            for r in 0..P {
                target[r] -= l[c][r] * known[c];
            }
        }
    }
}

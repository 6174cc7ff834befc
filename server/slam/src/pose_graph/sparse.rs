//! Symmetric positive definite systems of small dense blocks, by sparse Cholesky.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::SMatrix;

/// The system cannot be solved: not positive definite, or too large for the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NotSolvable;

/// Where the blocks of a symmetric matrix are, in an order that keeps its factor sparse.
///
/// The order is found on blocks, not on their entries: minimum degree (Amestoy, Davis and Duff 1996).
#[derive(Debug)]
pub(super) struct Pattern {
    /// Place in the order of every block row.
    place: Vec<u32>,
    /// Per place, where its blocks begin in `rows`: the upper triangle, so that the last of each is the diagonal one.
    starts: Vec<usize>,
    /// Places, ascending within a column.
    rows: Vec<u32>,
}

impl Pattern {
    /// For `n` block rows of which these pairs are coupled, in either order and as often as they like.
    pub(super) fn new(n: usize, pairs: &[(u32, u32)]) -> Result<Self, NotSolvable> {
        let place = Self::order(n, pairs)?;
        let mut entries: Vec<u64> = (0..n as u64).map(|k| k << 32 | k).collect();
        entries.extend(pairs.iter().filter(|(a, b)| a != b).map(|&(a, b)| {
            let (a, b) = (place[a as usize], place[b as usize]);
            u64::from(a.max(b)) << 32 | u64::from(a.min(b))
        }));
        entries.sort_unstable();
        entries.dedup();
        let mut starts = vec![0; n + 1];
        entries.iter().for_each(|e| starts[(e >> 32) as usize + 1] += 1);
        (0..n).for_each(|k| starts[k + 1] += starts[k]);
        Ok(Self { place, starts, rows: entries.iter().map(|e| *e as u32).collect() })
    }

    fn order(n: usize, pairs: &[(u32, u32)]) -> Result<Vec<u32>, NotSolvable> {
        let mut entries: Vec<u64> = pairs
            .iter()
            .filter(|(a, b)| a != b)
            .map(|&(a, b)| u64::from(a.max(b)) << 32 | u64::from(a.min(b)))
            .collect();
        entries.sort_unstable();
        entries.dedup();
        let mut starts = vec![0usize; n + 1];
        entries.iter().for_each(|e| starts[(e >> 32) as usize + 1] += 1);
        (0..n).for_each(|k| starts[k + 1] += starts[k]);
        let rows: Vec<usize> = entries.iter().map(|e| *e as u32 as usize).collect();
        let matrix = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let (mut forward, mut inverse) = (vec![0usize; n], vec![0usize; n]);
        let mut memory = MemBuffer::try_new(amd::order_scratch::<usize>(n, rows.len())).map_err(|_| NotSolvable)?;
        amd::order(&mut forward, &mut inverse, matrix, amd::Control::default(), MemStack::new(&mut memory))
            .map_err(|_| NotSolvable)?;
        Ok(inverse.iter().map(|&p| p as u32).collect())
    }

    /// Block rows.
    pub(super) fn len(&self) -> usize {
        self.place.len()
    }

    /// Index of the block that couples two rows, and whether it holds row `a` against column `b` (else transposed).
    pub(super) fn block(&self, a: u32, b: u32) -> Option<(usize, bool)> {
        let (pa, pb) = (self.place[a as usize], self.place[b as usize]);
        let (column, row) = (pa.max(pb), pa.min(pb));
        let range = self.starts[column as usize]..self.starts[column as usize + 1];
        let at = self.rows[range.clone()].binary_search(&row).ok()?;
        Some((range.start + at, pa <= pb))
    }

    /// Index of a diagonal block.
    pub(super) fn diagonal(&self, a: u32) -> usize {
        self.starts[self.place[a as usize] as usize + 1] - 1
    }

    /// Number of blocks.
    pub(super) fn num_blocks(&self) -> usize {
        self.rows.len()
    }
}

/// Solves systems of one pattern again and again.
pub(super) struct Solver<const D: usize> {
    pattern: Pattern,
    columns: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    memory: MemBuffer,
    rhs: Vec<f64>,
}

impl<const D: usize> Solver<D> {
    /// Analyses the pattern; solves for `num_rhs` right-hand sides at a time.
    pub(super) fn new(pattern: Pattern, num_rhs: usize) -> Result<Self, NotSolvable> {
        let n = pattern.len() * D;
        let (mut columns, mut rows) = (Vec::with_capacity(n + 1), Vec::with_capacity(pattern.num_blocks() * D * D));
        columns.push(0);
        for j in 0..pattern.len() {
            let of_column = &pattern.rows[pattern.starts[j]..pattern.starts[j + 1]];
            for c in 0..D {
                let (_, above) = of_column.split_last().unwrap_or((&0, &[]));
                rows.extend(above.iter().flat_map(|&i| (0..D).map(move |r| i as usize * D + r)));
                rows.extend((0..=c).map(|r| j * D + r));
                columns.push(rows.len());
            }
        }
        let matrix = SymbolicSparseColMatRef::new_checked(n, n, &columns, None, &rows);
        let symbolic = factorize_symbolic_cholesky(
            matrix,
            Side::Upper,
            SymmetricOrdering::Identity,
            CholeskySymbolicParams::default(),
        )
        .map_err(|_| NotSolvable)?;
        let scratch = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(num_rhs, Par::Seq));
        let memory = MemBuffer::try_new(scratch).map_err(|_| NotSolvable)?;
        let (values, factor) = (vec![0.0; rows.len()], vec![0.0; symbolic.len_val()]);
        Ok(Self { pattern, columns, rows, values, symbolic, factor, memory, rhs: vec![0.0; n * num_rhs] })
    }

    /// The pattern.
    pub(super) fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// Factorises the matrix of these blocks (by their index), its diagonal multiplied by `1 + damping`.
    pub(super) fn factorise(&mut self, blocks: &[SMatrix<f64, D, D>], damping: f64) -> Result<(), NotSolvable> {
        for j in 0..self.pattern.len() {
            let (start, end) = (self.pattern.starts[j], self.pattern.starts[j + 1]);
            for c in 0..D {
                let mut at = self.columns[j * D + c];
                for block in &blocks[start..end - 1] {
                    self.values[at..at + D].copy_from_slice(block.column(c).as_slice());
                    at += D;
                }
                self.values[at..=at + c].copy_from_slice(&blocks[end - 1].column(c).as_slice()[..=c]);
                self.values[at + c] *= 1.0 + damping;
            }
        }
        let n = self.pattern.len() * D;
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &self.columns, None, &self.rows);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(pattern, &self.values[..]),
                Side::Upper,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .map(|_| ())
            .map_err(|_| NotSolvable)
    }

    /// Solves in place for `K` right-hand sides, a row of `D x K` numbers a block row, with the last factor.
    pub(super) fn solve<const K: usize>(&mut self, x: &mut [SMatrix<f64, D, K>]) {
        let n = self.pattern.len() * D;
        for (i, v) in x.iter().enumerate() {
            let at = self.pattern.place[i] as usize * D;
            for k in 0..K {
                self.rhs[k * n + at..k * n + at + D].copy_from_slice(v.column(k).as_slice());
            }
        }
        let rhs = MatMut::from_column_major_slice_mut(&mut self.rhs[..n * K], n, K);
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            rhs,
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        for (i, v) in x.iter_mut().enumerate() {
            let at = self.pattern.place[i] as usize * D;
            for k in 0..K {
                v.column_mut(k).copy_from_slice(&self.rhs[k * n + at..k * n + at + D]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, Matrix2, Vector2};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solves_what_a_dense_solver_solves(
            pairs in prop::collection::vec((0..8u32, 0..8u32), 0..20),
            numbers in prop::collection::vec(-1.0..1.0f64, 200),
        ) {
            let n = 8;
            let mut solver = Solver::<2>::new(Pattern::new(n, &pairs).unwrap(), 1).unwrap();
            let mut dense = DMatrix::<f64>::identity(2 * n, 2 * n) * 100.0;
            let mut blocks = vec![Matrix2::zeros(); solver.pattern().num_blocks()];
            (0..n as u32).for_each(|k| blocks[solver.pattern().diagonal(k)] += Matrix2::identity() * 100.0);
            for ((a, b), v) in pairs.iter().filter(|(a, b)| a != b).zip(numbers.chunks(4)) {
                let coupling = Matrix2::from_column_slice(v);
                let (k, is_row) = solver.pattern().block(*a, *b).unwrap();
                blocks[k] += if is_row { coupling } else { coupling.transpose() };
                let (i, j) = (2 * *a as usize, 2 * *b as usize);
                for r in 0..2 {
                    for c in 0..2 {
                        dense[(i + r, j + c)] += coupling[(r, c)];
                        dense[(j + c, i + r)] += coupling[(r, c)];
                    }
                }
            }
            let rhs: Vec<Vector2<f64>> = numbers[100..].chunks(2).take(n).map(Vector2::from_column_slice).collect();
            let mut x = rhs.clone();
            solver.factorise(&blocks, 0.0).unwrap();
            solver.solve(&mut x);
            let flat = |v: &[Vector2<f64>]| nalgebra::DVector::from_iterator(2 * n, v.iter().flat_map(|v| [v.x, v.y]));
            prop_assert!((dense * flat(&x) - flat(&rhs)).norm() < 1e-9);
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let mut solver = Solver::<2>::new(Pattern::new(2, &[(0, 1)]).unwrap(), 1).unwrap();
        let blocks = vec![Matrix2::identity(); solver.pattern().num_blocks()];
        assert_eq!(solver.factorise(&blocks, 0.0), Err(NotSolvable));
        assert_eq!(solver.factorise(&blocks, 2.0), Ok(()));
    }
}

//! Symmetric positive definite systems of small dense blocks, by sparse Cholesky.

use super::cholesky::{climb, factorise, stride, substitute};
use super::pattern::{NotSolvable, Pattern};
use nalgebra::SMatrix;

/// Solves systems of one pattern again and again.
pub(super) struct Solver<'a, const D: usize> {
    pattern: &'a Pattern,
    factor: Vec<f64>,
    /// For each row, its place in the panel at hand.
    local: Vec<u32>,
    rhs: Vec<f64>,
}

impl<'a, const D: usize> Solver<'a, D> {
    /// For systems of this pattern.
    pub(super) fn new(pattern: &'a Pattern) -> Result<Self, NotSolvable> {
        let mut factor = Vec::new();
        factor.try_reserve_exact(pattern.num_factor_blocks() * D * stride(D)).map_err(|_| NotSolvable)?;
        Ok(Self { pattern, factor, local: vec![0; pattern.len()], rhs: vec![0.0; pattern.len() * stride(D)] })
    }

    /// Its pattern.
    pub(super) fn pattern(&self) -> &'a Pattern {
        self.pattern
    }

    /// Factorises the matrix of these blocks (by their index), its diagonal multiplied by `1 + damping`.
    pub(super) fn factorise(&mut self, blocks: &[SMatrix<f64, D, D>], damping: f64) -> Result<(), NotSolvable> {
        let (stride, size) = (stride(D), stride(D) * D);
        self.factor.clear();
        self.factor.resize(self.pattern.num_factor_blocks() * size, 0.0);
        for (block, &at) in blocks.iter().zip(self.pattern.in_factor()) {
            let target = &mut self.factor[at as usize * size..][..size];
            target
                .chunks_exact_mut(stride)
                .zip(block.column_iter())
                .for_each(|(t, c)| t[..D].copy_from_slice(c.as_slice()));
        }
        for j in 0..self.pattern.len() {
            let diagonal = &mut self.factor[self.pattern.column(j).start * size..][..size];
            (0..D).for_each(|c| diagonal[c * stride + c] *= 1.0 + damping);
        }
        match factorise::<D>(self.pattern, &mut self.factor, &mut self.local) {
            true => Ok(()),
            false => Err(NotSolvable),
        }
    }

    /// Solves in place for `K` right-hand sides, a row of `D x K` numbers a block row, with the last factor.
    pub(super) fn solve<const K: usize>(&mut self, x: &mut [SMatrix<f64, D, K>]) {
        let stride = stride(D);
        for k in 0..K {
            for (i, v) in (0..).zip(x.iter()) {
                let at = self.pattern.place(i) * stride;
                self.rhs[at..at + D].copy_from_slice(v.column(k).as_slice());
            }
            substitute::<D>(self.pattern, &self.factor, &mut self.rhs);
            for (i, v) in (0..).zip(x.iter_mut()) {
                let at = self.pattern.place(i) * stride;
                v.column_mut(k).copy_from_slice(&self.rhs[at..at + D]);
            }
        }
    }

    /// The block of the inverse that belongs to row `a` alone, of the matrix that was last factorised.
    ///
    /// With `x` the columns of the factor's inverse that belong to the row, it is `x^T * x`.
    pub(super) fn inverse_of(&self, a: u32) -> SMatrix<f64, D, D> {
        let (j, stride) = (self.pattern.place(a), stride(D));
        let column = |c: usize| {
            let mut x = vec![0.0; self.rhs.len()];
            x[j * stride + c] = 1.0;
            climb::<D>(self.pattern, &self.factor, j, &mut x);
            x
        };
        let columns: Vec<Vec<f64>> = (0..D).map(column).collect();
        SMatrix::from_fn(|r, c| columns[r].iter().zip(&columns[c]).map(|(a, b)| a * b).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector, Matrix2, SVector};
    use proptest::prelude::*;

    /// Solves what these pairs and numbers make with the sparse and with a dense solver; how far they are apart.
    fn apart<const D: usize>(n: usize, pairs: &[(u32, u32)], numbers: &[f64], damping: f64) -> f64 {
        let pattern = Pattern::new(n, pairs).unwrap();
        let mut solver = Solver::<D>::new(&pattern).unwrap();
        let mut number = numbers.iter().copied().cycle();
        let mut dense = DMatrix::<f64>::identity(D * n, D * n) * 100.0;
        let mut blocks = vec![SMatrix::<f64, D, D>::zeros(); pattern.num_blocks()];
        (0..n as u32).for_each(|k| blocks[pattern.diagonal(k)] += SMatrix::identity() * 100.0);
        for (a, b) in pairs.iter().filter(|(a, b)| a != b) {
            let coupling = SMatrix::<f64, D, D>::from_fn(|_, _| number.next().unwrap_or(0.0));
            let (k, is_row) = pattern.block(*a, *b).unwrap();
            blocks[k] += if is_row { coupling } else { coupling.transpose() };
            let (i, j) = (D * *a as usize, D * *b as usize);
            let mut above = dense.view_mut((i, j), (D, D));
            above += coupling;
            let mut below = dense.view_mut((j, i), (D, D));
            below += coupling.transpose();
        }
        (0..D * n).for_each(|k| dense[(k, k)] *= 1.0 + damping);
        let rhs: Vec<SVector<f64, D>> = (0..n).map(|_| SVector::from_fn(|_, _| number.next().unwrap_or(0.0))).collect();
        let mut x = rhs.clone();
        solver.factorise(&blocks, damping).unwrap();
        solver.solve(&mut x);
        let flat = |v: &[SVector<f64, D>]| DVector::from_iterator(D * n, v.iter().flat_map(|v| v.iter().copied()));
        let inverse = dense.clone().try_inverse().unwrap();
        let own = (0..n).map(|k| (inverse.view((D * k, D * k), (D, D)) - solver.inverse_of(k as u32)).amax());
        (dense * flat(&x) - flat(&rhs)).amax().max(own.fold(0.0, f64::max))
    }

    proptest! {
        #[test]
        fn solves_what_a_dense_solver_solves(
            pairs in prop::collection::vec((0..20u32, 0..20u32), 0..60),
            numbers in prop::collection::vec(-1.0..1.0f64, 200),
            damping in 0.0..1.0f64,
        ) {
            prop_assert!(apart::<1>(20, &pairs, &numbers, damping) < 1e-9);
            prop_assert!(apart::<2>(20, &pairs, &numbers, damping) < 1e-9);
            prop_assert!(apart::<3>(20, &pairs, &numbers, damping) < 1e-9);
            prop_assert!(apart::<4>(20, &pairs, &numbers, damping) < 1e-9);
            prop_assert!(apart::<6>(20, &pairs, &numbers, damping) < 1e-9);
            prop_assert!(apart::<7>(20, &pairs, &numbers, damping) < 1e-9);
        }
    }

    #[test]
    fn an_empty_system_is_solved() {
        let pattern = Pattern::new(0, &[]).unwrap();
        let mut solver = Solver::<3>::new(&pattern).unwrap();
        assert_eq!(solver.factorise(&[], 0.0), Ok(()));
        solver.solve::<1>(&mut []);
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let pattern = Pattern::new(2, &[(0, 1)]).unwrap();
        let mut solver = Solver::<2>::new(&pattern).unwrap();
        let blocks = vec![Matrix2::identity(); pattern.num_blocks()];
        assert_eq!(solver.factorise(&blocks, 0.0), Err(NotSolvable));
        assert_eq!(solver.factorise(&blocks, 2.0), Ok(()));
    }
}

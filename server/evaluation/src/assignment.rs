//! Who belongs to whom, so that the sum is best.

/// One-to-one pairs (row, column) of the largest sum of `worth`, R x C, row by row; only pairs worth at least `least`
/// (positive) are told, by row. A pair that is worth less counts as it is while the sum is made.
///
/// Source: Kuhn, "The Hungarian method for the assignment problem", 1955, in the form with potentials and shortest
/// augmenting paths (Jonker and Volgenant 1987); O(R R C).
///
/// # Panics
/// If rows differ in length.
pub fn best_pairs(worth: &[Vec<f64>], least: f64) -> Vec<(usize, usize)> {
    let (rows, columns) = (worth.len(), worth.first().map_or(0, Vec::len));
    if rows > columns {
        let turned: Vec<Vec<f64>> = (0..columns).map(|c| worth.iter().map(|row| row[c]).collect()).collect();
        let mut pairs: Vec<(usize, usize)> = best_pairs(&turned, least).into_iter().map(|(c, r)| (r, c)).collect();
        pairs.sort_unstable();
        return pairs;
    }
    // Row and column 0 stand for none; `row_of[c]` is who has column c.
    let (mut u, mut v, mut row_of) = (vec![0.0; rows + 1], vec![0.0; columns + 1], vec![0; columns + 1]);
    for row in 1..=rows {
        row_of[0] = row;
        let (mut slack, mut done, mut from) =
            (vec![f64::INFINITY; columns + 1], vec![false; columns + 1], vec![0; columns + 1]);
        let mut at = 0;
        while row_of[at] != 0 {
            done[at] = true;
            let (mut delta, mut next) = (f64::INFINITY, 0);
            for c in (1..=columns).filter(|&c| !done[c]) {
                let cost = -worth[row_of[at] - 1][c - 1] - u[row_of[at]] - v[c];
                if cost < slack[c] {
                    (slack[c], from[c]) = (cost, at);
                }
                if slack[c] < delta {
                    (delta, next) = (slack[c], c);
                }
            }
            for c in 0..=columns {
                if done[c] {
                    u[row_of[c]] += delta;
                    v[c] -= delta;
                } else {
                    slack[c] -= delta;
                }
            }
            at = next;
        }
        while at != 0 {
            row_of[at] = row_of[from[at]];
            at = from[at];
        }
    }
    let taken = (1..=columns).filter(|&c| row_of[c] != 0).map(|c| (row_of[c] - 1, c - 1));
    let mut pairs: Vec<(usize, usize)> = taken.filter(|&(r, c)| worth[r][c] >= least).collect();
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_best_sum_is_not_the_greedy_one() {
        // Greedy takes 0.9 and is left with 0.1; the best is 0.8 + 0.7.
        assert_eq!(best_pairs(&[vec![0.9, 0.8], vec![0.7, 0.1]], 0.25), [(0, 1), (1, 0)]);
        assert_eq!(best_pairs(&[vec![0.9, 0.8], vec![0.0, 0.1]], 0.25), [(0, 0)]);
        assert_eq!(best_pairs(&[vec![0.3], vec![0.6], vec![0.5]], 0.25), [(1, 0)]);
        assert_eq!(best_pairs(&[], 0.25), []);
        assert_eq!(best_pairs(&[vec![], vec![]], 0.25), []);
    }

    /// The best sum by trying all.
    fn plain(worth: &[Vec<f64>], row: usize, free: &mut Vec<usize>) -> f64 {
        if row == worth.len() {
            return 0.0;
        }
        (0..free.len())
            .map(|i| {
                let column = free.remove(i);
                let sum = worth[row][column] + plain(worth, row + 1, free);
                free.insert(i, column);
                sum
            })
            .fold(f64::NEG_INFINITY, f64::max)
    }

    proptest! {
        #[test]
        fn the_sum_is_that_of_trying_all(worth in prop::collection::vec(prop::array::uniform5(0.001..1.0f64), 1..5)) {
            let worth: Vec<Vec<f64>> = worth.into_iter().map(|r| r.to_vec()).collect();
            let sum: f64 = best_pairs(&worth, 1e-6).iter().map(|&(r, c)| worth[r][c]).sum();
            prop_assert!((sum - plain(&worth, 0, &mut (0..5).collect())).abs() < 1e-9);
        }
    }
}

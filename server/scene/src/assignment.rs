//! The cheapest one-to-one assignment.

/// For each row of `cost` the column assigned to it, so that the sum of costs is least; every row gets one.
///
/// `cost` is row-major, `rows` x `columns`, finite, with at least as many columns as rows. Takes time in the
/// order of `rows^2 * columns`. Ties fall the same way each time. Empty if the shape does not hold.
///
/// Source: Kuhn, "The Hungarian method for the assignment problem", 1955, as shortest augmenting paths with
/// potentials (Jonker and Volgenant, 1987).
pub fn assign(cost: &[f64], rows: usize, columns: usize) -> Vec<usize> {
    if rows > columns || cost.len() != rows * columns {
        return Vec::new();
    }
    const NONE: usize = usize::MAX;
    let mut row_potential = vec![0.0; rows];
    let mut column_potential = vec![0.0; columns];
    let mut row_of = vec![NONE; columns];
    for start in 0..rows {
        // Dijkstra over columns from the new row, along reduced costs, to the nearest column without a row.
        let mut distance = vec![f64::INFINITY; columns];
        let mut parent = vec![NONE; columns];
        let mut done = vec![false; columns];
        let (mut row, mut last, mut reached) = (start, NONE, 0.0);
        let end = loop {
            let mut nearest = NONE;
            for c in (0..columns).filter(|&c| !done[c]) {
                let through = reached + cost[row * columns + c] - row_potential[row] - column_potential[c];
                if through < distance[c] {
                    (distance[c], parent[c]) = (through, last);
                }
                if nearest == NONE || distance[c] < distance[nearest] {
                    nearest = c;
                }
            }
            done[nearest] = true;
            (last, reached) = (nearest, distance[nearest]);
            if row_of[nearest] == NONE {
                break nearest;
            }
            row = row_of[nearest];
        };
        row_potential[start] += reached;
        for c in (0..columns).filter(|&c| done[c] && c != end) {
            column_potential[c] -= reached - distance[c];
            row_potential[row_of[c]] += reached - distance[c];
        }
        // Each column on the path takes the row of the column before it.
        let mut column = end;
        while parent[column] != NONE {
            row_of[column] = row_of[parent[column]];
            column = parent[column];
        }
        row_of[column] = start;
    }
    let mut out = vec![NONE; rows];
    for (column, &row) in row_of.iter().enumerate() {
        if row != NONE {
            out[row] = column;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn least(cost: &[f64], columns: usize, row: usize, used: &mut Vec<bool>) -> f64 {
        if row * columns == cost.len() {
            return 0.0;
        }
        let mut best = f64::INFINITY;
        for c in 0..columns {
            if !used[c] {
                used[c] = true;
                best = best.min(cost[row * columns + c] + least(cost, columns, row + 1, used));
                used[c] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn no_permutation_is_cheaper(rows in 1usize..6, extra in 0usize..3, seed in prop::collection::vec(-5i32..20, 40)) {
            let columns = rows + extra;
            // Whole numbers make ties likely.
            let cost: Vec<f64> = seed.iter().cycle().take(rows * columns).map(|&v| f64::from(v)).collect();
            let found = assign(&cost, rows, columns);
            let mut columns_used = found.clone();
            columns_used.sort_unstable();
            columns_used.dedup();
            prop_assert_eq!(columns_used.len(), rows);
            let sum: f64 = found.iter().enumerate().map(|(r, &c)| cost[r * columns + c]).sum();
            prop_assert!((sum - least(&cost, columns, 0, &mut vec![false; columns])).abs() < 1e-9);
        }
    }

    #[test]
    fn shapes_that_cannot_be_assigned_give_nothing() {
        assert!(assign(&[], 0, 0).is_empty());
        assert!(assign(&[1.0, 2.0], 2, 1).is_empty());
        assert!(assign(&[1.0], 1, 2).is_empty());
    }
}

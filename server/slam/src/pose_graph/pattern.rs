//! Where the blocks of a sparse symmetric matrix and of its factor are, found once for all systems of one graph.

use std::ops::Range;

/// The system cannot be solved: not positive definite, or too large for the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NotSolvable;

/// Columns that are worked on together at most: each block of an earlier column is then read once for so many.
const WIDEST: usize = 4;
/// Blocks of a factor at most: 1.5 GB of those of poses in space. A graph whose nodes are tied at random fills up; maps of
/// a thousand poses have ten thousand.
const MOST_BLOCKS: usize = 4_000_000;

/// Where the blocks of a symmetric matrix and of its Cholesky factor are, in an order that keeps the factor sparse:
/// lower triangles by columns, rows ascending, so that the first block of each column is the diagonal one.
///
/// The order is found on blocks, not on their entries: minimum degree (Amestoy, Davis and Duff 1996). The rows of the
/// factor's column are those of the matrix and of the columns that it is the parent of (Liu, "The role of elimination
/// trees in sparse factorization", 1990).
#[derive(Debug)]
pub(super) struct Pattern {
    /// Place in the order of every block row.
    place: Vec<u32>,
    matrix: Columns,
    /// Per block of the matrix, where it is in the factor.
    in_factor: Vec<u32>,
    factor: Columns,
    /// First columns of the panels: neighbours whose rows are the same. One more at the end.
    panels: Vec<u32>,
    /// Per panel, where its updates begin. One more at the end.
    update_starts: Vec<usize>,
    updates: Vec<Update>,
}

/// Lower triangle by columns.
#[derive(Debug)]
struct Columns {
    starts: Vec<usize>,
    rows: Vec<u32>,
}

impl Columns {
    fn range(&self, column: usize) -> Range<usize> {
        self.starts[column]..self.starts[column + 1]
    }
}

/// What an earlier column takes from a panel: its blocks from `first` to `end`, times those up to `last`, whose rows
/// are columns of the panel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Update {
    pub(super) first: u32,
    pub(super) last: u32,
    pub(super) end: u32,
}

impl Pattern {
    /// For `n` block rows of which these pairs are coupled, in either order and as often as they like.
    pub(super) fn new(n: usize, pairs: &[(u32, u32)]) -> Result<Self, NotSolvable> {
        let place = order(n, pairs)?;
        let placed: Vec<(u32, u32)> = pairs.iter().map(|&(a, b)| (place[a as usize], place[b as usize])).collect();
        let matrix = lower_triangle(n, &placed);
        let factor = factor_of(&matrix, MOST_BLOCKS)?;
        let mut in_factor = Vec::with_capacity(matrix.rows.len());
        for j in 0..n {
            let range = factor.range(j);
            let mut at = range.start;
            for row in &matrix.rows[matrix.range(j)] {
                at += factor.rows[at..range.end].iter().take_while(|r| *r != row).count();
                in_factor.push(at as u32);
            }
        }
        let panels = panels_of(&factor);
        let (update_starts, updates) = updates_of(&factor, &panels);
        Ok(Self { place, matrix, in_factor, factor, panels, update_starts, updates })
    }

    /// Block rows.
    pub(super) fn len(&self) -> usize {
        self.place.len()
    }

    /// Place in the order of a block row.
    pub(super) fn place(&self, a: u32) -> usize {
        self.place[a as usize] as usize
    }

    /// Index of the block that couples two rows, and whether it holds row `a` against column `b` (else transposed).
    pub(super) fn block(&self, a: u32, b: u32) -> Option<(usize, bool)> {
        let (pa, pb) = (self.place[a as usize], self.place[b as usize]);
        let range = self.matrix.range(pa.min(pb) as usize);
        let at = self.matrix.rows[range.clone()].binary_search(&pa.max(pb)).ok()?;
        Some((range.start + at, pa >= pb))
    }

    /// Index of a diagonal block.
    pub(super) fn diagonal(&self, a: u32) -> usize {
        self.matrix.starts[self.place(a)]
    }

    /// Number of blocks.
    pub(super) fn num_blocks(&self) -> usize {
        self.matrix.rows.len()
    }

    /// Number of the factor's blocks.
    pub(super) fn num_factor_blocks(&self) -> usize {
        self.factor.rows.len()
    }

    /// Per block of the matrix, where it is in the factor.
    pub(super) fn in_factor(&self) -> &[u32] {
        &self.in_factor
    }

    /// Blocks of a column of the factor.
    #[inline(always)]
    pub(super) fn column(&self, j: usize) -> Range<usize> {
        self.factor.range(j)
    }

    /// Rows of the factor's blocks.
    #[inline(always)]
    pub(super) fn factor_rows(&self) -> &[u32] {
        &self.factor.rows
    }

    /// The panels: their columns, and what earlier columns take from them.
    #[inline(always)]
    pub(super) fn panels(&self) -> impl Iterator<Item = (Range<usize>, &[Update])> {
        self.panels
            .windows(2)
            .zip(self.update_starts.windows(2))
            .map(|(columns, updates)| (columns[0] as usize..columns[1] as usize, &self.updates[updates[0]..updates[1]]))
    }
}

/// The lower triangle that these pairs make with the diagonal, each once.
fn lower_triangle(n: usize, pairs: &[(u32, u32)]) -> Columns {
    let mut entries: Vec<u64> = Vec::with_capacity(pairs.len() + n);
    entries.extend((0..n as u64).map(|k| k << 32 | k));
    let coupled = pairs.iter().filter(|(a, b)| a != b);
    entries.extend(coupled.map(|&(a, b)| u64::from(a.min(b)) << 32 | u64::from(a.max(b))));
    entries.sort_unstable();
    entries.dedup();
    let mut starts = vec![0; n + 1];
    entries.iter().for_each(|e| starts[(e >> 32) as usize + 1] += 1);
    (0..n).for_each(|k| starts[k + 1] += starts[k]);
    Columns { starts, rows: entries.iter().map(|e| *e as u32).collect() }
}

/// Place in the order of every row.
fn order(n: usize, pairs: &[(u32, u32)]) -> Result<Vec<u32>, NotSolvable> {
    let Columns { starts, rows } = lower_triangle(n, pairs);
    let rows: Vec<usize> = rows.iter().map(|&r| r as usize).collect();
    let (_, inverse, _) = amd::order(n, &starts, &rows, &amd::Control::default()).map_err(|_| NotSolvable)?;
    Ok(inverse.iter().map(|&p| p as u32).collect())
}

/// The factor's blocks; refused as soon as they are more than `most`.
fn factor_of(matrix: &Columns, most: usize) -> Result<Columns, NotSolvable> {
    const NONE: u32 = u32::MAX;
    let n = matrix.starts.len() - 1;
    let mut factor = Columns { starts: Vec::with_capacity(n + 1), rows: Vec::with_capacity(2 * matrix.rows.len()) };
    factor.starts.push(0);
    // Children of each column, as a list through `next`; the last column that had each row.
    let (mut child, mut next, mut seen) = (vec![NONE; n], vec![NONE; n], vec![NONE; n]);
    for j in 0..n {
        let start = factor.rows.len();
        for &row in &matrix.rows[matrix.range(j)] {
            seen[row as usize] = j as u32;
            factor.rows.push(row);
        }
        let mut of = child[j];
        while of != NONE {
            // Without its own diagonal.
            for at in factor.starts[of as usize] + 1..factor.starts[of as usize + 1] {
                let row = factor.rows[at];
                if seen[row as usize] != j as u32 {
                    seen[row as usize] = j as u32;
                    factor.rows.push(row);
                }
            }
            of = next[of as usize];
        }
        if factor.rows.len() > most {
            return Err(NotSolvable);
        }
        factor.rows[start..].sort_unstable();
        factor.starts.push(factor.rows.len());
        if let Some(&parent) = factor.rows.get(start + 1) {
            next[j] = child[parent as usize];
            child[parent as usize] = j as u32;
        }
    }
    Ok(factor)
}

fn panels_of(factor: &Columns) -> Vec<u32> {
    let n = factor.starts.len() - 1;
    let mut panels = vec![0u32];
    for j in 1..n {
        let (before, own) = (factor.range(j - 1), factor.range(j));
        // A column's rows without its diagonal are some of its parent's: if they are as many, they are the same.
        let is_same = before.len() == own.len() + 1 && factor.rows[before.start + 1] == j as u32;
        if !is_same || j - panels[panels.len() - 1] as usize >= WIDEST {
            panels.push(j as u32);
        }
    }
    if n > 0 {
        panels.push(n as u32);
    }
    panels
}

fn updates_of(factor: &Columns, panels: &[u32]) -> (Vec<usize>, Vec<Update>) {
    let n = factor.starts.len() - 1;
    let num_panels = panels.len() - 1;
    let mut panel_of = vec![0u32; n];
    for (k, columns) in panels.windows(2).enumerate() {
        panel_of[columns[0] as usize..columns[1] as usize].fill(k as u32);
    }
    let mut found: Vec<(u32, Update)> = Vec::new();
    for k in 0..n {
        let range = factor.range(k);
        let mut first = range.start + 1;
        while first < range.end {
            let panel = panel_of[factor.rows[first] as usize];
            let more = factor.rows[first..range.end].iter().take_while(|r| panel_of[**r as usize] == panel).count();
            if panel != panel_of[k] {
                let update = Update { first: first as u32, last: (first + more) as u32, end: range.end as u32 };
                found.push((panel, update));
            }
            first += more;
        }
    }
    let mut starts = vec![0usize; num_panels + 1];
    found.iter().for_each(|(panel, _)| starts[*panel as usize + 1] += 1);
    (0..num_panels).for_each(|k| starts[k + 1] += starts[k]);
    // In the order of the columns that they are from.
    let (mut at, mut updates) = (starts.clone(), vec![Update { first: 0, last: 0, end: 0 }; found.len()]);
    for (panel, update) in found {
        updates[at[panel as usize]] = update;
        at[panel as usize] += 1;
    }
    (starts, updates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_that_fills_up_is_refused_before_it_takes_the_memory() {
        // A star whose centre comes first ties all others to each other.
        let star: Vec<(u32, u32)> = (1..100).map(|k| (0, k)).collect();
        let matrix = lower_triangle(100, &star);
        assert_eq!(factor_of(&matrix, 5050).map(|f| f.rows.len()), Ok(5050));
        assert!(factor_of(&matrix, 5049).is_err());
    }

    #[test]
    fn the_order_has_every_row_once_whatever_is_coupled() {
        let everything: Vec<(u32, u32)> = (0..40).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
        let star: Vec<(u32, u32)> = (1..400).map(|k| (0, k)).collect();
        let twice = vec![(3, 1), (1, 3), (3, 3), (1, 3)];
        for (n, pairs) in [(0, vec![]), (1, vec![]), (5, vec![]), (5, twice), (40, everything), (400, star)] {
            let mut places = order(n, &pairs).unwrap();
            places.sort_unstable();
            assert!(places.iter().copied().eq(0..n as u32), "{n}");
        }
    }

    #[test]
    fn the_order_keeps_the_factor_of_a_grid_sparse() {
        // Row by row each row of the factor would be as long as the grid is wide.
        const WIDE: u32 = 30;
        let along = (0..WIDE * WIDE).filter(|k| k % WIDE > 0).map(|k| (k - 1, k));
        let pairs: Vec<(u32, u32)> = along.chain((WIDE..WIDE * WIDE).map(|k| (k - WIDE, k))).collect();
        let blocks = Pattern::new((WIDE * WIDE) as usize, &pairs).unwrap().num_factor_blocks();
        assert!(2 * blocks < (WIDE * WIDE * WIDE) as usize, "{blocks}");
    }
}

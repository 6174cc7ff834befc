//! Exact squared distances in a box of cells.

/// Cells along the largest distance: its square and two more fit into 15 bits together.
pub(super) const MAX_CELLS: usize = 100;

/// Shape of a box of cells, x fastest, then y, then z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) z: usize,
}

impl Shape {
    pub(super) fn len(self) -> usize {
        self.x * self.y * self.z
    }
}

/// Squared distance from each cell's centre to that of the nearest cell that is set, in cells; more than `most` squared becomes that.
/// `most` is at most [`MAX_CELLS`].
///
/// Source: the minimum over each axis in turn, as in Saito and Toriwaki, "New algorithms for Euclidean distance transformation of an
/// n-dimensional digitized picture", 1994. Each looks no farther than `most`, for whole rows at once.
pub(super) fn squared_distances(set: &[bool], shape: Shape, most: usize) -> Vec<u16> {
    let limit = (most * most) as u16;
    let mut out = vec![limit; set.len()];
    for (set, out) in set.chunks_exact(shape.x).zip(out.chunks_exact_mut(shape.x)) {
        along_row(set, out, limit);
    }
    let mut next = out.clone();
    // Rows of a layer, then layers: either way whole rows lie so many cells apart.
    for layer in 0..shape.z {
        let of_layer = layer * shape.x * shape.y..(layer + 1) * shape.x * shape.y;
        across(&out[of_layer.clone()], &mut next[of_layer], shape.x, shape.y, most);
    }
    if shape.z > 1 {
        across(&next, &mut out, shape.x * shape.y, shape.z, most);
        return out;
    }
    next
}

fn along_row(set: &[bool], out: &mut [u16], limit: u16) {
    let far = usize::from(limit);
    let mut since = far;
    let mut pass = |i: usize| {
        since = if set[i] { 0 } else { since.saturating_add(1) };
        out[i] = out[i].min(since.saturating_mul(since).min(far) as u16);
    };
    (0..set.len()).for_each(&mut pass);
    let mut since = far;
    for i in (0..set.len()).rev() {
        since = if set[i] { 0 } else { since.saturating_add(1) };
        out[i] = out[i].min(since.saturating_mul(since).min(far) as u16);
    }
}

/// The minimum over rows of `width`, of which there are `num`: of each cell's own and those of other rows, farther by their distance.
fn across(from: &[u16], to: &mut [u16], width: usize, num: usize, most: usize) {
    let limit = (most * most) as u16;
    // Where nothing is near nothing gets nearer: rows that are all far are stepped over.
    let is_far: Vec<bool> = from.chunks_exact(width).map(|row| row.iter().all(|v| *v == limit)).collect();
    for (row, to) in to.chunks_exact_mut(width).enumerate() {
        to.copy_from_slice(&from[row * width..(row + 1) * width]);
        let (first, last) = (row.saturating_sub(most - 1), (row + most).min(num));
        for other in (first..last).filter(|other| *other != row && !is_far[*other]) {
            let square = (other.abs_diff(row) * other.abs_diff(row)) as u16;
            let from = &from[other * width..(other + 1) * width];
            // No branch, no overflow: two squares fit into 15 bits.
            to.iter_mut().zip(from).for_each(|(to, from)| *to = (*to).min(from + square));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plainly(set: &[bool], shape: Shape, most: usize) -> Vec<u16> {
        let at = |i: usize| [i % shape.x, i / shape.x % shape.y, i / shape.x / shape.y];
        let all: Vec<usize> = (0..set.len()).filter(|i| set[*i]).collect();
        let between = |a: usize, b: usize| (0..3).map(|k| at(a)[k].abs_diff(at(b)[k]).pow(2)).sum::<usize>();
        (0..set.len())
            .map(|i| all.iter().map(|b| between(i, *b)).min().map_or(most * most, |d| d.min(most * most)) as u16)
            .collect()
    }

    proptest! {
        #[test]
        fn distances_are_those_to_the_nearest_of_all(x in 1usize..14, y in 1usize..14, z in 1usize..8, most in 1usize..16,
                                                     seed in any::<u64>(), share in 1u64..60) {
            let shape = Shape { x, y, z };
            let mut state = seed;
            let set: Vec<bool> = (0..shape.len()).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % 100 < share / 4
            }).collect();
            prop_assert_eq!(squared_distances(&set, shape, most), plainly(&set, shape, most));
        }
    }

    #[test]
    fn the_largest_distance_does_not_overflow() {
        let shape = Shape { x: 150, y: 150, z: 1 };
        let mut set = vec![false; shape.len()];
        set[0] = true;
        let found = squared_distances(&set, shape, MAX_CELLS);
        assert_eq!((found[99], found[100], found[149 * 150 + 149]), (9_801, 10_000, 10_000));
        assert_eq!(found[60 * 150 + 70], 8_500);
    }
}

//! Exact distances from voxels' centres to the nearest obstacle's surface.

/// Square of twice the distance from each voxel's centre to the nearest obstacle's cube, in voxels: a whole number; 0 in
/// obstacles, at most that of an obstacle `most` voxels on, `(2 most - 1)^2`. `most` is 1 to 90. With `is_open` what lies
/// beyond the box is free, else it is an obstacle. `obstacle` has x fastest, then y, then z.
///
/// Source: the minimum over each axis in turn, as in Saito and Toriwaki, "New algorithms for Euclidean distance
/// transformation of an n-dimensional digitized picture", 1994, with cubes for points: `n` voxels on along an axis, a cube
/// begins `n - 1/2` from the centre.
pub(super) fn squared_clearances(obstacle: &[bool], size: [usize; 3], most: usize, is_open: bool) -> Vec<u16> {
    let [x, y, z] = size;
    let mut out = vec![square(most); obstacle.len()];
    for (row, out) in obstacle.chunks_exact(x).zip(out.chunks_exact_mut(x)) {
        along_row(row, out, most, is_open);
    }
    let mut before = vec![0; x * y.max(z)];
    // Rows of a layer, one layer after the other; then the rows above each other, one slab after the other.
    for layer in 0..z {
        across(&mut out, &mut before, (layer * x * y, x, x, y), most, is_open);
    }
    for slab in 0..y {
        across(&mut out, &mut before, (slab * x, x * y, x, z), most, is_open);
    }
    out
}

/// Of a cube so many voxels on.
const fn square(n: usize) -> u16 {
    if n == 0 { 0 } else { ((2 * n - 1) * (2 * n - 1)) as u16 }
}

fn along_row(row: &[bool], out: &mut [u16], most: usize, is_open: bool) {
    let before = if is_open { most } else { 0 };
    let mut pass = |since: &mut usize, i: usize| {
        *since = if row[i] { 0 } else { (*since + 1).min(most) };
        out[i] = out[i].min(square(*since));
    };
    let mut since = before;
    (0..row.len()).for_each(|i| pass(&mut since, i));
    let mut since = before;
    (0..row.len()).rev().for_each(|i| pass(&mut since, i));
}

/// The minimum over `num` rows of `width`, `stride` apart from `first` on: of each value and those of other rows, farther by
/// their distance.
fn across(
    out: &mut [u16],
    before: &mut [u16],
    (first, stride, width, num): (usize, usize, usize, usize),
    most: usize,
    is_open: bool,
) {
    let limit = square(most);
    for (i, row) in before.chunks_exact_mut(width).take(num).enumerate() {
        row.copy_from_slice(&out[first + i * stride..][..width]);
    }
    // Where nothing is near nothing gets nearer: rows that are all far are stepped over.
    let is_far: Vec<bool> = before.chunks_exact(width).take(num).map(|row| row.iter().all(|v| *v == limit)).collect();
    for i in 0..num {
        let to = &mut out[first + i * stride..][..width];
        let (low, high) = (i.saturating_sub(most - 1), (i + most).min(num));
        for other in (low..high).filter(|other| *other != i && !is_far[*other]) {
            let farther = square(other.abs_diff(i));
            // No overflow: two squares of at most 179 fit into 16 bits.
            to.iter_mut().zip(&before[other * width..][..width]).for_each(|(to, from)| *to = (*to).min(from + farther));
        }
        let beyond = square((i + 1).min(num - i).min(most));
        if !is_open && beyond < limit {
            to.iter_mut().for_each(|to| *to = (*to).min(beyond));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plainly(obstacle: &[bool], size: [usize; 3], most: usize, is_open: bool) -> Vec<u16> {
        let at = |i: usize| [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
        let of = |i: usize| {
            let cubes = (0..obstacle.len()).filter(|j| obstacle[*j]);
            let between = |j: usize| (0..3).map(|k| u32::from(square(at(i)[k].abs_diff(at(j)[k])))).sum::<u32>();
            let beyond = (0..3).map(|k| u32::from(square((at(i)[k] + 1).min(size[k] - at(i)[k]))));
            let beyond = if is_open { u32::MAX } else { beyond.min().unwrap() };
            let nearest = cubes.map(between).min().unwrap_or(u32::MAX);
            if obstacle[i] { 0 } else { nearest.min(beyond).min(u32::from(square(most))) as u16 }
        };
        (0..obstacle.len()).map(of).collect()
    }

    proptest! {
        #[test]
        fn clearances_are_those_to_the_nearest_of_all_cubes(
            x in 1usize..12, y in 1usize..10, z in 1usize..8, most in 1usize..12, is_open: bool, seed in any::<u64>(),
            share in 0u64..40,
        ) {
            let mut state = seed;
            let obstacle: Vec<bool> = (0..x * y * z).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % 200 < share
            }).collect();
            let found = squared_clearances(&obstacle, [x, y, z], most, is_open);
            prop_assert_eq!(found, plainly(&obstacle, [x, y, z], most, is_open));
        }
    }
}

//! Building the tree: medians by sampling, halves in the order of the cloud.
//!
//! Bound: every level reads and writes each point once (32 bytes) besides two readings for its box and its median;
//! there are `log2(n / 16)` levels.

use super::kdtree::{Bounds, KdTree, LEAF, Leaf, Node};
use nalgebra::Point3;
use percept_geometry::by_processor;

/// Subtrees with fewer points are built by the thread that has them.
const PARALLEL_ABOVE: usize = 8192;
/// So many values are ranked by comparing each with each.
const RANKED: usize = 64;
/// Ranks to both sides of the sample's median that the median of all lies between: 2.5 standard deviations of the
/// rank that it has in a sample, `sqrt(RANKED) / 2`.
const SPREAD: usize = 10;

/// A point and its index in the cloud.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    p: [f32; 3],
    index: u32,
}

/// The points of a subtree in the order of the cloud, and room of the same size.
struct Work<'a> {
    entries: &'a mut [Entry],
    spare: &'a mut [Entry],
    values: &'a mut [f32],
}

/// The part of the tree that a subtree fills.
struct Parts<'a> {
    nodes: &'a mut [Node],
    bounds: &'a mut [Bounds],
    leaves: &'a mut [Leaf],
}

impl KdTree {
    /// Builds the tree; points with a non-finite coordinate are left out. `O(n log n)`.
    ///
    /// Points beyond the first 2^32 are not indexed (memory ends before).
    pub fn build(points: &[Point3<f32>]) -> Self {
        let mut entries: Vec<Entry> = Vec::with_capacity(points.len());
        let finite = points.iter().zip(0..u32::MAX).filter(|(p, _)| percept_geometry::cloud::is_finite(p));
        entries.extend(finite.map(|(p, index)| Entry { p: [p.x, p.y, p.z], index }));
        let len = entries.len();
        let num_leaves = len.div_ceil(LEAF);
        if num_leaves == 0 {
            return Self { num_given: points.len(), ..Self::default() };
        }
        let mut nodes = vec![Node::default(); num_leaves - 1];
        let mut bounds = vec![Bounds::default(); 2 * num_leaves - 1];
        let mut leaves = vec![Leaf::EMPTY; num_leaves];
        let (mut spare, mut values) = (vec![Entry::default(); len], vec![0.0; len]);
        let work = Work { entries: &mut entries, spare: &mut spare, values: &mut values };
        split(work, Parts { nodes: &mut nodes, bounds: &mut bounds, leaves: &mut leaves });
        Self { num_given: points.len(), nodes, bounds, leaves, len }
    }
}

/// Orders the points into leaves and fills the nodes and boxes above them, in pre-order.
///
/// Halves keep the order of the cloud. So equal values go left in the order of their indices, and the first point of
/// a subtree has its smallest index.
fn split(work: Work, parts: Parts) {
    let Work { entries, spare, values } = work;
    let Parts { nodes, bounds, leaves } = parts;
    let Some((here, below)) = bounds.split_first_mut() else { return };
    *here = bounds_of(entries);
    let Some((root, children)) = nodes.split_first_mut() else {
        return fill(entries, &mut leaves[0]);
    };
    let axis = here.widest_axis();
    let left_leaves = leaves.len() / 2;
    let mid = left_leaves * LEAF;
    let median = select(entries, axis, mid, values);
    halve(entries, axis, &median, mid, spare);
    *root = Node { axis: axis as u8, split: median.value, least: entries[0].index };
    let (left_entries, right_entries) = spare.split_at_mut(mid);
    let (left_spare, right_spare) = entries.split_at_mut(mid);
    let (left_values, right_values) = values.split_at_mut(mid);
    let (left_nodes, right_nodes) = children.split_at_mut(left_leaves - 1);
    let (left_bounds, right_bounds) = below.split_at_mut(2 * left_leaves - 1);
    let (left_leaves, right_leaves) = leaves.split_at_mut(left_leaves);
    let left = Work { entries: left_entries, spare: left_spare, values: left_values };
    let right = Work { entries: right_entries, spare: right_spare, values: right_values };
    let left_parts = Parts { nodes: left_nodes, bounds: left_bounds, leaves: left_leaves };
    let right_parts = Parts { nodes: right_nodes, bounds: right_bounds, leaves: right_leaves };
    if mid > PARALLEL_ABOVE {
        rayon::join(|| split(left, left_parts), || split(right, right_parts));
    } else {
        split(left, left_parts);
        split(right, right_parts);
    }
}

fn fill(entries: &[Entry], leaf: &mut Leaf) {
    for (i, e) in entries.iter().enumerate().take(LEAF) {
        (leaf.xs[i], leaf.ys[i], leaf.zs[i], leaf.indices[i]) = (e.p[0], e.p[1], e.p[2], e.index);
    }
}

/// A value of a given rank.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ranked {
    value: f32,
    /// How many are smaller.
    num_less: usize,
}

/// The value along the axis that `rank` points come before; `values` is room for as many as there are points.
fn select(entries: &[Entry], axis: usize, rank: usize, values: &mut [f32]) -> Ranked {
    take_axis(entries, axis, values);
    narrow(values, rank).unwrap_or_else(|| {
        take_axis(entries, axis, values);
        let (less, &mut value, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
        Ranked { value, num_less: less.iter().filter(|&&v| v < value).count() }
    })
}

/// The value of a rank, found by keeping only what lies between two values of a sample, and so on. None if the sample
/// was not like the values (which are lost).
///
/// Source: Floyd and Rivest, "Expected time bounds for selection", 1975.
fn narrow(values: &mut [f32], rank: usize) -> Option<Ranked> {
    let (mut len, mut below) = (values.len(), 0);
    while len > RANKED {
        let sample: [f32; RANKED] = std::array::from_fn(|i| values[scattered(i, len)]);
        let middle = (rank - below) * RANKED / len;
        let [low, high] = rank_all(&sample, [middle.saturating_sub(SPREAD), (middle + SPREAD + 1).min(RANKED - 1)]);
        let low = if middle < SPREAD { f32::NEG_INFINITY } else { low.value };
        let high = if middle + SPREAD + 1 < RANKED { high.value } else { f32::INFINITY };
        let (kept, less) = keep_between(&mut values[..len], low, high);
        below += less;
        if rank < below || rank >= below + kept {
            return None;
        }
        if low == high {
            return Some(Ranked { value: low, num_less: below });
        }
        if kept > len - len / 4 {
            return None;
        }
        len = kept;
    }
    let [last, _] = rank_all(&values[..len], [rank - below; 2]);
    Some(Ranked { value: last.value, num_less: below + last.num_less })
}

/// A place in the `i`-th of as many equal stretches of `len` places as there are samples: anywhere in it, so that the
/// rows of an image do not beat with the samples.
fn scattered(i: usize, len: usize) -> usize {
    let stretch = len / RANKED;
    let share = u64::from((i as u32 + 1).wrapping_mul(2_654_435_769));
    i * stretch + ((share * stretch as u64) >> 32) as usize
}

by_processor! {
    fn bounds_of(entries: &[Entry]) -> Bounds {
        // Four boxes side by side, so that minima need not wait for each other.
        let (mut lo, mut hi) = ([[f32::INFINITY; 3]; 4], [[f32::NEG_INFINITY; 3]; 4]);
        let (fours, rest) = entries.as_chunks::<4>();
        for four in fours {
            for (l, e) in four.iter().enumerate() {
                for i in 0..3 {
                    lo[l][i] = if e.p[i] < lo[l][i] { e.p[i] } else { lo[l][i] };
                    hi[l][i] = if e.p[i] > hi[l][i] { e.p[i] } else { hi[l][i] };
                }
            }
        }
        let mut out = Bounds { lo: [f32::INFINITY; 3], hi: [f32::NEG_INFINITY; 3] };
        for (lo, hi) in lo.iter().zip(&hi).chain(rest.iter().map(|e| (&e.p, &e.p))) {
            for i in 0..3 {
                out.lo[i] = out.lo[i].min(lo[i]);
                out.hi[i] = out.hi[i].max(hi[i]);
            }
        }
        out
    }
}

by_processor! {
    fn take_axis(entries: &[Entry], axis: usize, values: &mut [f32]) {
        values.iter_mut().zip(entries).for_each(|(v, e)| *v = e.p[axis % 3]);
    }
}

by_processor! {
    /// The values of two ranks among at most `RANKED` values.
    fn rank_all(values: &[f32], ranks: [usize; 2]) -> [Ranked; 2] {
        let mut own = [f32::INFINITY; RANKED];
        own[..values.len()].copy_from_slice(values);
        let mut less = [[0i32; 16]; RANKED / 16];
        let own = &own.as_chunks::<16>().0[..values.len().div_ceil(16)];
        for (own, less) in own.iter().zip(&mut less) {
            let mut sums = [0i32; 16];
            for v in values {
                for i in 0..16 {
                    sums[i] += i32::from(*v < own[i]);
                }
            }
            *less = sums;
        }
        ranks.map(|rank| {
            // The value that the most are smaller than, but not more than `rank`.
            let (mut num_less, mut value) = ([-1i32; 16], [0.0f32; 16]);
            for (own, less) in own.iter().zip(&less) {
                for i in 0..16 {
                    let better = (less[i] <= rank as i32) & (less[i] > num_less[i]);
                    num_less[i] = if better { less[i] } else { num_less[i] };
                    value[i] = if better { own[i] } else { value[i] };
                }
            }
            let most = num_less.iter().fold(0, |m, &n| if n > m { n } else { m });
            let at = num_less.iter().position(|&n| n == most).unwrap_or(0);
            Ranked { value: value[at], num_less: most as usize }
        })
    }
}

by_processor! {
    /// Moves the values from `low` to `high` to the front. How many they are, and how many are lower.
    fn keep_between(values: &mut [f32], low: f32, high: f32) -> (usize, usize) {
        let less = values.iter().map(|&v| u32::from(v < low)).sum::<u32>();
        let mut kept = 0;
        for i in 0..values.len() {
            let v = values[i];
            values[kept] = v;
            kept += usize::from((v >= low) & (v <= high));
        }
        (kept, less as usize)
    }
}

by_processor! {
    /// Puts the `mid` points below the median first, each half in the order that it had. Of points on the median the
    /// first ones are below.
    fn halve(entries: &[Entry], axis: usize, median: &Ranked, mid: usize, out: &mut [Entry]) {
        let (mut left, mut right, mut ties) = (0, mid, mid - median.num_less);
        let mut put = |e: &Entry, below: bool| {
            let at = if below { left } else { right };
            // Never beyond the end: so many are below.
            if let Some(out) = out.get_mut(at) {
                *out = *e;
            }
            left += usize::from(below);
            right += usize::from(!below);
        };
        if ties == 0 {
            return entries.iter().for_each(|e| put(e, e.p[axis % 3] < median.value));
        }
        for e in entries {
            let v = e.p[axis % 3];
            let tie = (v == median.value) & (ties > 0);
            put(e, (v < median.value) | tie);
            ties -= usize::from(tie);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn medians_equal_those_of_sorted_values(
            mut values in prop_oneof![
                prop::collection::vec(-1.0..1.0f32, 1..3000),
                prop::collection::vec((-3i8..3).prop_map(f32::from), 1..3000),
                (1usize..5000).prop_map(|n| (0..n).map(|i| i as f32).collect()),
            ],
            share in 0.0..1.0f64,
        ) {
            let entries: Vec<Entry> =
                values.iter().zip(0..).map(|(&v, index)| Entry { p: [0.0, v, 0.0], index }).collect();
            let rank = (share * values.len() as f64) as usize;
            let found = select(&entries, 1, rank, &mut vec![0.0; values.len()]);
            let mut out = vec![Entry::default(); values.len()];
            halve(&entries, 1, &found, rank, &mut out);
            values.sort_by(f32::total_cmp);
            prop_assert_eq!(found.value, values[rank]);
            prop_assert_eq!(found.num_less, values.iter().filter(|&&v| v < found.value).count());
            let mut expected = entries;
            expected.sort_by(|a, b| a.p[1].total_cmp(&b.p[1]));
            let (low, high) = expected.split_at_mut(rank);
            for (out, expected) in [(&out[..rank], low), (&out[rank..], high)] {
                expected.sort_by_key(|e| e.index);
                prop_assert!(out.iter().map(|e| e.index).eq(expected.iter().map(|e| e.index)));
            }
        }
    }
}

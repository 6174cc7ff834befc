//! An exact, implicit k-d tree over f32 points.

use nalgebra::Point3;
use std::cmp::Ordering;

/// Points in a leaf (all are full but the last). Sixteen f32 are four SSE or two AVX registers.
pub(super) const LEAF: usize = 16;
/// Up to this `k` an insertion-sorted list beats a heap.
const LIST_UP_TO: usize = 48;

/// A point found by a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbor {
    /// Squared distance to the query, square metres, computed in f32.
    pub distance2: f32,
    /// Index into the points that the tree was built from.
    pub index: usize,
}

impl Neighbor {
    /// Distance and index as one number: the order of numbers is the order of answers.
    pub(super) fn key(&self) -> u64 {
        key(self.distance2, self.index as u32)
    }

    /// Back from [`key`](Self::key).
    pub(crate) fn of_key(key: u64) -> Self {
        Self { distance2: f32::from_bits((key >> 32) as u32), index: (key & u64::from(u32::MAX)) as usize }
    }

    /// The order of answers: nearest first, equal distances by index.
    fn order(&self, other: &Self) -> Ordering {
        self.distance2.total_cmp(&other.distance2).then(self.index.cmp(&other.index))
    }
}

/// Distances are not negative, so that their bits are in their order.
#[inline(always)]
pub(super) fn key(distance2: f32, index: u32) -> u64 {
    u64::from(distance2.to_bits()) << 32 | u64::from(index)
}

/// A static k-d tree: built from a slice of points, queried by many threads at once.
///
/// Every level splits the leaves of the widest axis in half, so the tree needs no child pointers, a leaf's range
/// follows from its number alone, all leaves but the last are full, and leaf coordinates lie side by side. Answers
/// equal brute force in f32 exactly, with ties broken by the smaller index; subtrees know their smallest index, so
/// that a heap of equal points is not searched through.
///
/// Source: Friedman, Bentley and Finkel, "An algorithm for finding best matches in logarithmic expected
/// time", 1977; bounds carried down as in Arya and Mount, "Algorithms for fast vector quantization", 1993.
#[derive(Debug, Clone, Default)]
pub struct KdTree {
    /// Number of points that the tree was built from, those not finite among them.
    pub(super) num_given: usize,
    /// Inner nodes in pre-order: the left child follows its parent, the right one follows the left subtree.
    pub(super) nodes: Vec<Node>,
    /// Boxes of inner nodes and leaves in pre-order.
    pub(super) bounds: Vec<Bounds>,
    /// Coordinates and indices by leaf, the last one filled up with infinity.
    pub(super) leaves: Vec<Leaf>,
    pub(super) len: usize,
}

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Node {
    pub(super) axis: u8,
    pub(super) split: f32,
    /// Smallest index in the subtree.
    pub(super) least: u32,
}

/// The points of a leaf.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leaf {
    pub(super) xs: [f32; LEAF],
    pub(super) ys: [f32; LEAF],
    pub(super) zs: [f32; LEAF],
    pub(super) indices: [u32; LEAF],
}

/// The box about the points of a subtree.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bounds {
    pub(super) lo: [f32; 3],
    pub(super) hi: [f32; 3],
}

impl Bounds {
    /// Axis of the longest side, the first of equal ones.
    pub(super) fn widest_axis(&self) -> usize {
        let size = |i: usize| self.hi[i] - self.lo[i];
        let xy = if size(1) > size(0) { 1 } else { 0 };
        if size(2) > size(xy) { 2 } else { xy }
    }
}

impl Leaf {
    /// No points: infinitely far away.
    pub(super) const EMPTY: Self = Self {
        xs: [f32::INFINITY; LEAF],
        ys: [f32::INFINITY; LEAF],
        zs: [f32::INFINITY; LEAF],
        indices: [u32::MAX; LEAF],
    };
}

impl KdTree {
    /// Number of (finite) points in the tree.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no point in the tree.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The nearest point; none if the tree is empty or the query not finite.
    pub fn nearest(&self, query: &Point3<f32>) -> Option<Neighbor> {
        self.nearest_within(query, f32::INFINITY)
    }

    /// The nearest point at most `radius_m` away.
    pub fn nearest_within(&self, query: &Point3<f32>, radius_m: f32) -> Option<Neighbor> {
        let mut found = Nearest { limit: radius_m * radius_m, best: None };
        self.search(query, &mut found);
        found.best
    }

    /// The `k` nearest points (fewer if the tree has fewer), nearest first, ties by index.
    pub fn knn(&self, query: &Point3<f32>, k: usize) -> Vec<Neighbor> {
        let mut out = Vec::new();
        self.knn_into(query, k, &mut out);
        out
    }

    /// As [`knn`](Self::knn), into a buffer that is cleared first and can be reused.
    pub fn knn_into(&self, query: &Point3<f32>, k: usize, out: &mut Vec<Neighbor>) {
        self.hybrid_into(query, f32::INFINITY, k, out);
    }

    /// Every point at most `radius_m` away (the border belongs to it), nearest first, ties by index.
    pub fn radius(&self, query: &Point3<f32>, radius_m: f32) -> Vec<Neighbor> {
        let mut out = Vec::new();
        self.radius_into(query, radius_m, &mut out);
        out.sort_unstable_by(Neighbor::order);
        out
    }

    /// As [`radius`](Self::radius), into a buffer that is cleared first, in an order that depends on the
    /// tree alone but is not sorted.
    pub fn radius_into(&self, query: &Point3<f32>, radius_m: f32, out: &mut Vec<Neighbor>) {
        out.clear();
        if radius_m >= 0.0 {
            self.search(query, &mut Within { radius2: radius_m * radius_m, out });
        }
    }

    /// At most `max_nn` nearest points that are at most `radius_m` away, nearest first, ties by index.
    pub fn hybrid(&self, query: &Point3<f32>, radius_m: f32, max_nn: usize) -> Vec<Neighbor> {
        let mut out = Vec::new();
        self.hybrid_into(query, radius_m, max_nn, &mut out);
        out
    }

    /// As [`hybrid`](Self::hybrid), into a buffer that is cleared first and can be reused.
    pub fn hybrid_into(&self, query: &Point3<f32>, radius_m: f32, max_nn: usize, out: &mut Vec<Neighbor>) {
        out.clear();
        let k = max_nn.min(self.len());
        if k == 0 || radius_m.is_nan() || radius_m < 0.0 {
            return;
        }
        let radius2 = radius_m * radius_m;
        if k <= LIST_UP_TO {
            self.search(query, &mut SortedList { k, limit: radius2, out });
        } else {
            self.search(query, &mut Heap { k, limit: radius2, out });
            out.sort_unstable_by(Neighbor::order);
        }
    }

    fn search<C: Collector>(&self, query: &Point3<f32>, collector: &mut C) {
        if !self.is_empty() && percept_geometry::cloud::is_finite(query) {
            self.descend(Subtree { node: 0, leaf: 0, leaves: self.leaves.len() }, query, [0.0; 3], collector);
        }
    }

    /// Visits the side of the query first, the other only if its nearest border is within the bound.
    ///
    /// `off` is the distance along each axis to this subtree's region. Differences, squares and the sum are
    /// rounded monotonically and in the same order as the distances themselves, so the bound never exceeds
    /// a distance that it stands for: pruning is exact, not exact up to rounding.
    fn descend<C: Collector>(&self, s: Subtree, q: &Point3<f32>, off: [f32; 3], collector: &mut C) {
        if s.leaves == 1 {
            return self.scan(s.leaf, q, collector);
        }
        let Node { axis, split, .. } = self.nodes[s.node];
        let axis = usize::from(axis);
        let to_split = q[axis] - split;
        let (left, right) = s.children();
        // On the border the left side comes first: among equal points it holds the smaller indices.
        let (near, far) = if to_split <= 0.0 { (left, right) } else { (right, left) };
        if !collector.is_beyond(off[0] * off[0] + off[1] * off[1] + off[2] * off[2], self.least(near)) {
            self.descend(near, q, off, collector);
        }
        let mut off = off;
        off[axis] = to_split;
        if !collector.is_beyond(off[0] * off[0] + off[1] * off[1] + off[2] * off[2], self.least(far)) {
            self.descend(far, q, off, collector);
        }
    }

    /// Smallest index in a subtree; a leaf's is not worth looking for.
    fn least(&self, s: Subtree) -> u32 {
        if s.leaves == 1 { 0 } else { self.nodes[s.node].least }
    }

    #[inline]
    fn scan<C: Collector>(&self, leaf: usize, q: &Point3<f32>, collector: &mut C) {
        let Leaf { xs, ys, zs, indices } = &self.leaves[leaf];
        let mut distances = [0.0f32; LEAF];
        for (((d, &x), &y), &z) in distances.iter_mut().zip(xs).zip(ys).zip(zs) {
            let (dx, dy, dz) = (q.x - x, q.y - y, q.z - z);
            *d = dx * dx + dy * dy + dz * dz;
        }
        for (&distance2, &index) in distances.iter().zip(&indices[..(self.len - leaf * LEAF).min(LEAF)]) {
            if distance2 <= collector.limit() {
                collector.push(Neighbor { distance2, index: index as usize });
            }
        }
    }
}

/// A subtree: its root's place and its leaves.
#[derive(Clone, Copy)]
struct Subtree {
    node: usize,
    leaf: usize,
    leaves: usize,
}

impl Subtree {
    fn children(self) -> (Self, Self) {
        let left = self.leaves / 2;
        (
            Self { node: self.node + 1, leaf: self.leaf, leaves: left },
            Self { node: self.node + left, leaf: self.leaf + left, leaves: self.leaves - left },
        )
    }
}

/// What a query keeps of the points it meets.
trait Collector {
    /// Squared distance beyond which nothing is wanted any more.
    fn limit(&self) -> f32;
    /// Whether a point at this squared distance at least, and of this index at least, is not wanted any more.
    fn is_beyond(&self, distance2: f32, _least_index: u32) -> bool {
        distance2 > self.limit()
    }
    /// Takes a point that is within the limit.
    fn push(&mut self, neighbor: Neighbor);
}

struct Nearest {
    limit: f32,
    best: Option<Neighbor>,
}

impl Collector for Nearest {
    fn is_beyond(&self, distance2: f32, least_index: u32) -> bool {
        distance2 > self.limit || self.best.is_some_and(|b| b.distance2 == distance2 && b.index < least_index as usize)
    }

    fn limit(&self) -> f32 {
        self.limit
    }

    fn push(&mut self, neighbor: Neighbor) {
        if self.best.is_none_or(|best| neighbor.order(&best).is_lt()) {
            self.limit = neighbor.distance2;
            self.best = Some(neighbor);
        }
    }
}

struct Within<'a> {
    radius2: f32,
    out: &'a mut Vec<Neighbor>,
}

impl Collector for Within<'_> {
    fn limit(&self) -> f32 {
        self.radius2
    }

    fn push(&mut self, neighbor: Neighbor) {
        self.out.push(neighbor);
    }
}

/// The k best so far, sorted.
struct SortedList<'a> {
    k: usize,
    limit: f32,
    out: &'a mut Vec<Neighbor>,
}

impl Collector for SortedList<'_> {
    fn is_beyond(&self, distance2: f32, least_index: u32) -> bool {
        let full = self.out.len() == self.k;
        let worst = self.out.last().filter(|_| full);
        distance2 > self.limit || worst.is_some_and(|w| w.distance2 == distance2 && w.index < least_index as usize)
    }

    fn limit(&self) -> f32 {
        self.limit
    }

    fn push(&mut self, neighbor: Neighbor) {
        if self.out.len() == self.k {
            if neighbor.order(&self.out[self.k - 1]).is_ge() {
                return;
            }
            self.out.pop();
        }
        let at = self.out.iter().rposition(|n| n.order(&neighbor).is_lt()).map_or(0, |i| i + 1);
        self.out.insert(at, neighbor);
        if self.out.len() == self.k {
            self.limit = self.out[self.k - 1].distance2;
        }
    }
}

/// The k best so far as a binary heap with the worst on top.
struct Heap<'a> {
    k: usize,
    limit: f32,
    out: &'a mut Vec<Neighbor>,
}

impl Heap<'_> {
    fn sift_up(&mut self, mut i: usize) {
        while i > 0 && self.out[i].order(&self.out[(i - 1) / 2]).is_gt() {
            self.out.swap(i, (i - 1) / 2);
            i = (i - 1) / 2;
        }
    }

    fn sift_down(&mut self, mut i: usize) {
        loop {
            let worse = |a: usize, b: usize| b < self.k && self.out[b].order(&self.out[a]).is_gt();
            let (l, r) = (2 * i + 1, 2 * i + 2);
            let mut top = if worse(i, l) { l } else { i };
            if worse(top, r) {
                top = r;
            }
            if top == i {
                return;
            }
            self.out.swap(i, top);
            i = top;
        }
    }
}

impl Collector for Heap<'_> {
    fn is_beyond(&self, distance2: f32, least_index: u32) -> bool {
        let full = self.out.len() == self.k;
        let worst = self.out.first().filter(|_| full);
        distance2 > self.limit || worst.is_some_and(|w| w.distance2 == distance2 && w.index < least_index as usize)
    }

    fn limit(&self) -> f32 {
        self.limit
    }

    fn push(&mut self, neighbor: Neighbor) {
        if self.out.len() < self.k {
            self.out.push(neighbor);
            self.sift_up(self.out.len() - 1);
        } else if neighbor.order(&self.out[0]).is_lt() {
            self.out[0] = neighbor;
            self.sift_down(0);
        }
        if self.out.len() == self.k {
            self.limit = self.out[0].distance2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute(points: &[Point3<f32>], q: &Point3<f32>) -> Vec<Neighbor> {
        let mut all: Vec<Neighbor> = points
            .iter()
            .enumerate()
            .filter(|(_, p)| percept_geometry::cloud::is_finite(p))
            .map(|(index, p)| {
                let d = q - p;
                Neighbor { distance2: d.x * d.x + d.y * d.y + d.z * d.z, index }
            })
            .collect();
        all.sort_by(Neighbor::order);
        all
    }

    /// Coordinates on a coarse lattice now and then, so that ties and equal points occur, and some NaN.
    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![
            4 => -10.0..10.0f32,
            4 => (-3..3i32).prop_map(|i| i as f32),
            1 => Just(1e7f32),
            1 => Just(f32::NAN),
        ]
    }

    fn cloud() -> impl Strategy<Value = Vec<Point3<f32>>> {
        prop::collection::vec([coordinate(), coordinate(), coordinate()].prop_map(Point3::from), 0..400)
    }

    proptest! {
        #[test]
        fn answers_equal_brute_force(
            points in cloud(),
            q in [-10.0..10.0f32, -4.0..4.0f32, -3.0..3.0f32],
            snap in any::<bool>(), k in 0usize..90, radius in 0.0..6.0f32,
        ) {
            let q = Point3::from(if snap { q.map(f32::round) } else { q });
            let tree = KdTree::build(&points);
            let all = brute(&points, &q);
            let within: Vec<Neighbor> = all.iter().copied().filter(|n| n.distance2 <= radius * radius).collect();
            prop_assert_eq!(tree.len(), all.len());
            prop_assert_eq!(tree.nearest(&q), all.first().copied());
            prop_assert_eq!(tree.nearest_within(&q, radius), within.first().copied());
            prop_assert_eq!(tree.knn(&q, k), all[..k.min(all.len())].to_vec());
            prop_assert_eq!(tree.hybrid(&q, radius, k), within[..k.min(within.len())].to_vec());
            prop_assert_eq!(tree.radius(&q, radius), within);
        }
    }

    #[test]
    fn a_large_tree_built_in_parallel_equals_brute_force() {
        let points: Vec<Point3<f32>> = (0..40_000u32)
            .map(|i| {
                Point3::from([i, i ^ 0x5bd1, i.rotate_left(7)].map(|s| (s.wrapping_mul(2_654_435_761) >> 8) as f32))
            })
            .collect();
        let tree = KdTree::build(&points);
        for q in points.iter().step_by(4001) {
            assert_eq!(tree.knn(q, 20), brute(&points, q)[..20]);
        }
    }

    #[test]
    fn equal_points_come_in_the_order_of_their_indices() {
        let tree = KdTree::build(&vec![Point3::new(1.0, 2.0, 3.0); 100]);
        let found: Vec<usize> = tree.knn(&Point3::origin(), 5).iter().map(|n| n.index).collect();
        assert_eq!(found, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn queries_that_are_not_finite_find_nothing() {
        let tree = KdTree::build(&[Point3::origin()]);
        assert_eq!(tree.nearest(&Point3::new(f32::NAN, 0.0, 0.0)), None);
        assert!(tree.radius(&Point3::origin(), f32::NAN).is_empty());
        assert!(tree.radius(&Point3::origin(), -1.0).is_empty());
        assert_eq!(KdTree::default().knn(&Point3::origin(), 3), []);
        assert_eq!(KdTree::build(&[]).nearest(&Point3::origin()), None);
    }
}

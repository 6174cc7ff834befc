//! Neighbours of many queries at once, in flat arrays.

use super::group::{Group, Wanted, What};
use super::kdtree::{KdTree, LEAF, Neighbor};
use nalgebra::Point3;
use percept_geometry::GeometryError;
use rayon::prelude::*;

/// Leaves of one task.
const LEAVES: usize = 64;
/// Queries of one task.
const QUERIES: usize = 512;

/// Neighbours of `Q` queries: those of query `i` are at `offsets[i]..offsets[i + 1]` of the other two, nearest first,
/// equal distances by index. A query that is not finite has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Neighbors {
    /// `Q + 1`, ascending from 0.
    pub offsets: Vec<usize>,
    /// Indices into the points that were searched.
    pub indices: Vec<u32>,
    /// Squared distances, square metres.
    pub distances2: Vec<f32>,
}

impl Neighbors {
    /// Number of queries.
    pub fn num_queries(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Indices and squared distances of the neighbours of a query.
    pub fn of(&self, query: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[query]..self.offsets[query + 1];
        (&self.indices[range.clone()], &self.distances2[range])
    }

    fn with_counts(counts: impl Iterator<Item = usize>) -> Self {
        let mut offsets = vec![0];
        let mut sum = 0;
        offsets.extend(counts.map(|c| {
            sum += c;
            sum
        }));
        Self { offsets, indices: vec![0; sum], distances2: vec![0.0; sum] }
    }

    /// Fills the rows of all queries, of which `row` gives the keys, with the threads there are.
    fn fill<'a>(&mut self, row: impl Fn(usize) -> &'a [u64] + Sync) {
        let (mut indices, mut distances2) = (self.indices.as_mut_slice(), self.distances2.as_mut_slice());
        let mut pieces = Vec::with_capacity(self.offsets.len() / QUERIES + 1);
        for from in (0..self.offsets.len() - 1).step_by(QUERIES) {
            let to = (from + QUERIES).min(self.offsets.len() - 1);
            let len = self.offsets[to] - self.offsets[from];
            pieces.push((
                from..to,
                indices.split_off_mut(..len).unwrap_or_default(),
                distances2.split_off_mut(..len).unwrap_or_default(),
            ));
        }
        pieces.into_par_iter().for_each(|(queries, indices, distances2)| {
            let mut places = indices.iter_mut().zip(distances2);
            for &key in queries.flat_map(&row) {
                if let Some((index, distance2)) = places.next() {
                    let n = Neighbor::of_key(key);
                    (*index, *distance2) = (n.index as u32, n.distance2);
                }
            }
        });
    }
}

/// Neighbours found by a task: where those of each query end, and all of them.
#[derive(Default)]
struct Part {
    ends: Vec<usize>,
    keys: Vec<u64>,
}

impl Part {
    fn row(&self, i: usize) -> &[u64] {
        let from = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.keys[from..self.ends[i]]
    }
}

impl KdTree {
    /// The `k` nearest of every point that the tree was built from, itself among them. Points that are not finite
    /// have none.
    pub fn knn_all(&self, k: usize) -> Neighbors {
        self.hybrid_all(f32::INFINITY, k)
    }

    /// At most `max_nn` nearest within `radius_m` of every point that the tree was built from, itself among them.
    /// None at all if the radius is negative or not a number.
    pub fn hybrid_all(&self, radius_m: f32, max_nn: usize) -> Neighbors {
        let wanted = Wanted { k: max_nn.min(self.len()), radius_m, what: What::Rows };
        let parts = self.map_leaves(&wanted, |part: &mut Part, leaf, group| {
            if part.ends.len() == LEAF {
                part.keys.reserve_exact(part.keys.len() * (LEAVES - 1));
            }
            for i in 0..self.num_points_of(leaf) {
                let row = group.row(i, &wanted);
                part.keys.extend_from_slice(row);
                part.ends.push(part.keys.len());
            }
        });
        if parts.is_empty() {
            return Neighbors::with_counts(std::iter::repeat_n(0, self.num_given));
        }
        // Mostly all have k, so that the place of a row needs no looking up.
        let full = parts.iter().all(|part| part.keys.len() == part.ends.len() * wanted.k);
        let mut slots = vec![u32::MAX; self.num_given];
        for leaf in 0..self.num_leaves() {
            self.indices_of(leaf).iter().zip(leaf * LEAF..).for_each(|(&i, slot)| slots[i as usize] = slot as u32);
        }
        let row = |query: usize| match slots[query] as usize {
            slot if slot < self.len() => {
                let (part, i) = (&parts[slot / (LEAVES * LEAF)], slot % (LEAVES * LEAF));
                if full { &part.keys[i * wanted.k..][..wanted.k] } else { part.row(i) }
            }
            _ => &[],
        };
        let mut out = Neighbors::with_counts((0..self.num_given).map(|query| row(query).len()));
        out.fill(row);
        out
    }

    /// Every point within `radius_m` of every point that the tree was built from, itself among them.
    ///
    /// # Errors
    /// `OutOfRange` for `radius_m` if there are more than `max_total` neighbours in all; nothing is kept of them.
    pub fn radius_all(&self, radius_m: f32, max_total: usize) -> Result<Neighbors, GeometryError> {
        let mut queries = vec![Point3::from([f32::NAN; 3]); self.num_given];
        for leaf in 0..self.num_leaves() {
            for (i, &index) in self.indices_of(leaf).iter().enumerate() {
                queries[index as usize] = self.leaves[leaf].point(i);
            }
        }
        self.radius_of(&queries, radius_m, max_total)
    }

    /// The `k` nearest of each query.
    pub fn knn_of(&self, queries: &[Point3<f32>], k: usize) -> Neighbors {
        self.hybrid_of(queries, f32::INFINITY, k)
    }

    /// At most `max_nn` nearest within `radius_m` of each query.
    pub fn hybrid_of(&self, queries: &[Point3<f32>], radius_m: f32, max_nn: usize) -> Neighbors {
        let parts = queries.par_chunks(QUERIES).map_init(Vec::new, |found, queries| {
            let mut part = Part::default();
            for q in queries {
                self.hybrid_into(q, radius_m, max_nn, found);
                part.keys.extend(found.iter().map(Neighbor::key));
                part.ends.push(part.keys.len());
            }
            part
        });
        joined(&parts.collect::<Vec<_>>())
    }

    /// Every point within `radius_m` of each query.
    ///
    /// # Errors
    /// `OutOfRange` for `radius_m` if there are more than `max_total` neighbours in all; nothing is kept of them.
    pub fn radius_of(
        &self,
        queries: &[Point3<f32>],
        radius_m: f32,
        max_total: usize,
    ) -> Result<Neighbors, GeometryError> {
        let total = std::sync::atomic::AtomicUsize::new(0);
        let too_many = || GeometryError::OutOfRange {
            field: "radius_m",
            value: f64::from(radius_m),
            requirement: "small enough for the limit of neighbours in all",
        };
        let parts = queries.par_chunks(QUERIES).map_init(Vec::new, |found, queries| {
            let mut part = Part::default();
            for q in queries {
                self.radius_into(q, radius_m, found);
                let before = total.fetch_add(found.len(), std::sync::atomic::Ordering::Relaxed);
                if before.saturating_add(found.len()) > max_total {
                    return Err(too_many());
                }
                let from = part.keys.len();
                part.keys.extend(found.iter().map(Neighbor::key));
                part.keys[from..].sort_unstable();
                part.ends.push(part.keys.len());
            }
            Ok(part)
        });
        Ok(joined(&parts.collect::<Result<Vec<_>, _>>()?))
    }

    /// Calls `take` with each leaf and the neighbours of its points; one `R` for each task of leaves in turn, which
    /// are [`leaves_of_task`](Self::leaves_of_task).
    pub(crate) fn map_leaves<R: Send + Default>(
        &self,
        wanted: &Wanted,
        take: impl Fn(&mut R, usize, &Group) + Sync,
    ) -> Vec<R> {
        if wanted.k == 0 || wanted.radius_m.is_nan() || wanted.radius_m < 0.0 {
            return Vec::new();
        }
        self.map_tasks(|group, out, leaf| {
            group.find(self, leaf, wanted);
            take(out, leaf, group);
        })
    }

    /// Whether each point that the tree was built from has at least `wanted` points within `radius_m`, itself among
    /// them; false for points that are not finite. Stops counting as soon as it can.
    pub fn at_least_within(&self, radius_m: f32, wanted: usize) -> Vec<bool> {
        if radius_m.is_nan() || radius_m < 0.0 {
            return vec![false; self.num_given];
        }
        let by_task = self.map_tasks(|group, out: &mut Vec<bool>, leaf| {
            let reached = group.at_least(self, leaf, radius_m, wanted);
            out.extend_from_slice(&reached[..self.num_points_of(leaf)]);
        });
        self.in_cloud_order(&by_task, false)
    }

    fn map_tasks<R: Send + Default>(&self, work: impl Fn(&mut Group, &mut R, usize) + Sync + Send) -> Vec<R> {
        let tasks = (0..self.num_leaves().div_ceil(LEAVES)).into_par_iter();
        let task = |group: &mut Group, task| {
            // What a thread did before must not be seen: the rounding of sums depends on the guess.
            group.forget();
            let mut out = R::default();
            self.leaves_of_task(task).for_each(|leaf| work(group, &mut out, leaf));
            out
        };
        tasks.map_init(Group::new, task).collect()
    }

    /// The leaves that belong to a result of [`map_leaves`](Self::map_leaves).
    pub(crate) fn leaves_of_task(&self, task: usize) -> std::ops::Range<usize> {
        task * LEAVES..((task + 1) * LEAVES).min(self.num_leaves())
    }

    /// One value a point, in the order of the cloud, from values in the order of leaves.
    pub(crate) fn in_cloud_order<T: Copy>(&self, by_task: &[Vec<T>], absent: T) -> Vec<T> {
        let mut out = vec![absent; self.num_given];
        for (task, values) in by_task.iter().enumerate() {
            let indices = self.leaves_of_task(task).flat_map(|leaf| self.indices_of(leaf));
            indices.zip(values).for_each(|(&index, &value)| out[index as usize] = value);
        }
        out
    }
}

fn joined(parts: &[Part]) -> Neighbors {
    let row = |query: usize| parts[query / QUERIES].row(query % QUERIES);
    let num_queries = parts.iter().map(|p| p.ends.len()).sum();
    let mut out = Neighbors::with_counts((0..num_queries).map(|query| row(query).len()));
    out.fill(row);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coordinates on a coarse lattice now and then, so that ties and equal points occur, and some far or not finite.
    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![
            6 => -10.0..10.0f32,
            6 => (-3..3i32).prop_map(|i| i as f32),
            1 => Just(1e7f32),
            1 => Just(f32::NAN),
        ]
    }

    fn cloud() -> impl Strategy<Value = Vec<Point3<f32>>> {
        let random = prop::collection::vec([coordinate(), coordinate(), coordinate()].prop_map(Point3::from), 0..700);
        let sheet = (0usize..2500, 1u32..400).prop_map(|(n, spread)| {
            let hash = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 8;
            (0..n)
                .map(|i| Point3::new((hash(i) % spread) as f32 * 0.1, (hash(i + 9999) % spread) as f32 * 0.1, 0.0))
                .collect()
        });
        prop_oneof![random, sheet]
    }

    /// Row by row what single queries say, which are tested against brute force.
    fn same(
        all: &Neighbors,
        points: &[Point3<f32>],
        single: impl Fn(&Point3<f32>) -> Vec<Neighbor>,
    ) -> Result<(), TestCaseError> {
        prop_assert_eq!(all.num_queries(), points.len());
        for (i, p) in points.iter().enumerate() {
            let (indices, distances2) = all.of(i);
            let row: Vec<Neighbor> = indices
                .iter()
                .zip(distances2)
                .map(|(&index, &distance2)| Neighbor { distance2, index: index as usize })
                .collect();
            prop_assert_eq!(row, single(p), "query {}", i);
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn all_points_at_once_have_the_neighbours_of_single_queries(
            points in cloud(), k in 0usize..80, radius in 0.0..3.0f32,
        ) {
            let tree = KdTree::build(&points);
            same(&tree.knn_all(k), &points, |p| tree.knn(p, k))?;
            same(&tree.hybrid_all(radius, k), &points, |p| tree.hybrid(p, radius, k))?;
            same(&tree.radius_all(radius, usize::MAX).unwrap(), &points, |p| tree.radius(p, radius))?;
            same(&tree.knn_of(&points, k), &points, |p| tree.knn(p, k))?;
            let counts = tree.at_least_within(radius, k);
            for (p, reached) in points.iter().zip(counts) {
                prop_assert_eq!(reached, percept_geometry::cloud::is_finite(p) && tree.radius(p, radius).len() >= k);
            }
        }
    }

    #[test]
    fn sums_do_not_depend_on_the_number_of_threads() {
        // Dense and sparse stretches in turn, so that a guess carried over from elsewhere would be wrong.
        let hash = |i: u32| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
        let stretch = |i: u32| if (i / 3000).is_multiple_of(2) { 0.1 } else { 10.0 };
        let points: Vec<Point3<f32>> = (0..24_000u32)
            .map(|i| Point3::new((i / 3000) as f32 * 20.0 + hash(i) * stretch(i), hash(i + 77_777) * stretch(i), 0.0))
            .collect();
        let tree = KdTree::build(&points);
        let wanted = Wanted { k: 20, radius_m: f32::INFINITY, what: What::Distances };
        let rows = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                tree.map_leaves(&wanted, |out: &mut Vec<f64>, leaf, group| {
                    out.extend((0..tree.num_points_of(leaf)).map(|i| group.sum_of_distances(i)));
                })
            })
        };
        let one = rows(1);
        assert!((0..5).all(|_| rows(3) == one));
    }

    #[test]
    fn a_heap_of_equal_points_is_answered_in_time() {
        let points = vec![Point3::new(1.0, 2.0, 3.0); 20_000];
        let all = KdTree::build(&points).knn_all(10);
        assert!((0..points.len()).all(|i| all.of(i).0.iter().copied().eq(0..10)));
    }

    #[test]
    fn more_neighbours_than_allowed_are_refused() {
        let tree = KdTree::build(&vec![Point3::origin(); 1000]);
        assert!(tree.radius_all(1.0, 999_999).unwrap_err().to_string().starts_with("radius_m"));
        assert_eq!(tree.radius_all(1.0, 1_000_000).unwrap().indices.len(), 1_000_000);
        assert_eq!(tree.hybrid_all(f32::NAN, 3).indices.len(), 0);
    }
}

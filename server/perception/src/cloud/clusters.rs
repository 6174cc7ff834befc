//! Points that hang together.

use super::cells::Cells;
use super::{at_least, positive};
use crate::search::{KdTree, Neighbor};
use nalgebra::Point3;
use percept_geometry::{GeometryError, cloud::is_finite};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Points whose edges are gathered in parallel before they are joined, a bound on memory.
const BLOCK: usize = 1 << 15;
const CHUNK: usize = 512;

/// How [`cluster`] joins points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClusterParams {
    /// Points at most this far apart belong together, metres; about twice their spacing.
    pub eps_m: f64,
    /// Clusters with fewer points are noise; at least 1.
    pub min_points: usize,
    /// Growth of the distance with range, metres a metre: at range r (from the origin of the cloud's frame, where the
    /// sensor is) it is `eps_m + eps_slope * r`, as the spacing of beams grows; 0 for the same distance everywhere.
    pub eps_slope: f64,
}

impl Default for ClusterParams {
    fn default() -> Self {
        Self { eps_m: 0.05, min_points: 10, eps_slope: 0.0 }
    }
}

impl ClusterParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("eps_m", self.eps_m)?;
        at_least("min_points", self.min_points, 1, "at least 1")?;
        if (0.0..=1.0).contains(&self.eps_slope) {
            return Ok(());
        }
        Err(GeometryError::OutOfRange { field: "eps_slope", value: self.eps_slope, requirement: "from 0 to 1" })
    }
}

/// How [`dbscan`] joins points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DbscanParams {
    /// Radius of a neighbourhood, metres.
    pub eps_m: f64,
    /// Points in it, the point itself among them, that make a point a core point; at least 1.
    pub min_points: usize,
}

impl Default for DbscanParams {
    fn default() -> Self {
        Self { eps_m: 0.05, min_points: 10 }
    }
}

/// To which cluster each point belongs.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Clusters {
    /// N labels from 0; none is noise.
    pub labels: Vec<Option<u32>>,
    /// Number of clusters.
    pub num_clusters: usize,
}

impl Clusters {
    /// Indices of the points of each cluster, ascending, by label.
    pub fn indices(&self) -> Vec<Vec<usize>> {
        let mut out = vec![Vec::new(); self.num_clusters];
        for (i, label) in self.labels.iter().enumerate() {
            if let Some(label) = label {
                out[*label as usize].push(i);
            }
        }
        out
    }
}

/// Connected components under 'at most `eps_m` apart', numbered by their first point; small ones are noise.
/// If the distance grows with range, two points are joined that are within the smaller of their two distances.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn cluster(points: &[Point3<f32>], params: &ClusterParams) -> Result<Clusters, GeometryError> {
    params.validate()?;
    let mut sets = DisjointSets::new(points.len());
    let eps = params.eps_m as f32;
    if params.eps_slope > 0.0 {
        let reach = |p: &Point3<f32>| (params.eps_m + params.eps_slope * p.coords.cast::<f64>().norm()) as f32;
        let reaches: Vec<f32> = points.iter().map(reach).collect();
        join(points, &KdTree::build(points), &reaches, |_| true, &mut sets);
    } else if let Some(cells) = Cells::new(points, eps) {
        join_cells(&cells, &vec![true; cells.indices.len()], &mut sets);
    } else {
        join(points, &KdTree::build(points), &vec![eps; points.len()], |_| true, &mut sets);
    }
    Ok(sets.clusters(params.min_points, |i| is_finite(&points[i])))
}

/// Density-based clusters. A border point in reach of several goes to the one that comes first: clusters are numbered
/// by their first core point, and the smallest label wins, as in scikit-learn.
///
/// Points are sorted into cells in which all are neighbours, so that cores of one cell are of one cluster and only
/// cells are joined; the answer is that of trying all pairs (in f32).
///
/// Source: Ester et al., "A density-based algorithm for discovering clusters", 1996; cells: see `Cells`.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn dbscan(points: &[Point3<f32>], params: &DbscanParams) -> Result<Clusters, GeometryError> {
    ClusterParams { eps_m: params.eps_m, min_points: params.min_points, eps_slope: 0.0 }.validate()?;
    let eps = params.eps_m as f32;
    let Some(cells) = Cells::new(points, eps) else {
        return Ok(dbscan_by_tree(points, eps, params.min_points));
    };
    let core = cells.cores(params.min_points);
    let mut sets = DisjointSets::new(points.len());
    join_cells(&cells, &core, &mut sets);
    let mut roots = vec![None; points.len()];
    for (&i, _) in cells.indices.iter().zip(&core).filter(|(_, core)| **core) {
        roots[i as usize] = Some(sets.root(i));
    }
    let mut out = number(roots.into_iter(), points.len());
    let labels: Vec<Option<u32>> = cells.indices.iter().map(|&i| out.labels[i as usize]).collect();
    let asked: Vec<bool> = core.iter().map(|core| !core).collect();
    for (&i, border) in cells.indices.iter().zip(cells.least_around(&labels, &asked)) {
        out.labels[i as usize] = out.labels[i as usize].or(border);
    }
    Ok(out)
}

/// Joins all of a cell that take part (by place), and cells that hold neighbours.
fn join_cells(cells: &Cells, takes_part: &[bool], sets: &mut DisjointSets) {
    let first: Vec<Option<u32>> = (0..cells.len())
        .map(|cell| {
            let mut members = cells.places(cell).filter(|&place| takes_part[place]).map(|place| cells.indices[place]);
            let first = members.next()?;
            members.for_each(|i| sets.unite(first, i));
            Some(first)
        })
        .collect();
    cells.join(takes_part, |a, b, meet| {
        if let (Some(a), Some(b)) = (first[a], first[b])
            && sets.root(a) != sets.root(b)
            && meet()
        {
            sets.unite(a, b);
        }
    });
}

/// As [`dbscan`], for clouds too wide for cells.
fn dbscan_by_tree(points: &[Point3<f32>], eps: f32, min_points: usize) -> Clusters {
    let tree = KdTree::build(points);
    let mut core = vec![false; points.len()];
    core.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK)).for_each_init(Vec::new, |found, (core, points)| {
        for (core, p) in core.iter_mut().zip(points) {
            tree.hybrid_into(p, eps, min_points, found);
            *core = found.len() == min_points;
        }
    });
    let mut sets = DisjointSets::new(points.len());
    join(points, &tree, &vec![eps; points.len()], |i| core[i], &mut sets);
    let mut out = number((0..points.len() as u32).map(|i| core[i as usize].then(|| sets.root(i))), points.len());
    let of_cores = &out.labels;
    let mut borders = vec![None; points.len()];
    borders.par_chunks_mut(CHUNK).enumerate().for_each_init(Vec::new, |found, (chunk, borders)| {
        for (i, border) in borders.iter_mut().enumerate().map(|(i, b)| (chunk * CHUNK + i, b)) {
            if !core[i] {
                tree.radius_into(&points[i], eps, found);
                *border = found.iter().filter_map(|n| of_cores[n.index]).min();
            }
        }
    });
    out.labels.iter_mut().zip(borders).for_each(|(label, border)| *label = label.or(border));
    out
}

/// Joins all pairs within the reach of both, of which both `take` part.
fn join(
    points: &[Point3<f32>],
    tree: &KdTree,
    reaches: &[f32],
    take: impl Fn(usize) -> bool + Sync,
    sets: &mut DisjointSets,
) {
    let edges_of = |found: &mut Vec<Neighbor>, i: usize, edges: &mut Vec<(u32, u32)>| {
        if take(i) {
            tree.radius_into(&points[i], reaches[i], found);
            // The one of the smaller reach tells of the pair; of equals the later.
            let told = |n: &&Neighbor| (reaches[i], n.index) < (reaches[n.index], i) && take(n.index);
            edges.extend(found.iter().filter(told).map(|n| (n.index as u32, i as u32)));
        }
    };
    let all: Vec<usize> = (0..points.len()).collect();
    for block in all.chunks(BLOCK) {
        let edges: Vec<Vec<(u32, u32)>> = block
            .par_chunks(CHUNK)
            .map_init(Vec::new, |found, chunk| {
                let mut edges = Vec::new();
                chunk.iter().for_each(|&i| edges_of(found, i, &mut edges));
                edges
            })
            .collect();
        edges.iter().flatten().for_each(|&(a, b)| sets.unite(a, b));
    }
}

/// Labels from 0 in the order in which roots first come.
fn number(roots: impl Iterator<Item = Option<u32>>, num_points: usize) -> Clusters {
    let mut label_of = vec![None; num_points];
    let mut num_clusters = 0;
    let labels = roots
        .map(|root| {
            root.map(|root| {
                *label_of[root as usize].get_or_insert_with(|| {
                    num_clusters += 1;
                    num_clusters as u32 - 1
                })
            })
        })
        .collect();
    Clusters { labels, num_clusters }
}

/// Union by smaller index with path halving (Tarjan and van Leeuwen 1984).
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// Every one of `n` by itself.
    pub(crate) fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    /// The smallest of its set.
    pub(crate) fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    /// The sets of at least so many elements, without those that do not take part, numbered by their first.
    pub(crate) fn clusters(&mut self, min_points: usize, takes_part: impl Fn(usize) -> bool) -> Clusters {
        let n = self.0.len();
        let roots: Vec<u32> = (0..n as u32).map(|i| self.root(i)).collect();
        let mut sizes = vec![0usize; n];
        roots.iter().for_each(|&r| sizes[r as usize] += 1);
        let counts = |i: usize| takes_part(i) && sizes[roots[i] as usize] >= min_points;
        number((0..n).map(|i| counts(i).then_some(roots[i])), n)
    }

    /// Makes two sets one.
    pub(crate) fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Point3<f32>>> {
        let coordinate = prop_oneof![20 => -1.0..1.0f32, 1 => Just(f32::NAN)];
        prop::collection::vec(prop::array::uniform3(coordinate).prop_map(Point3::from), 0..150)
    }

    fn near(a: &Point3<f32>, b: &Point3<f32>, eps: f32) -> bool {
        let d = a - b;
        d.x * d.x + d.y * d.y + d.z * d.z <= eps * eps
    }

    /// Ester's algorithm as written: grow each cluster from its first core point.
    fn plain_dbscan(points: &[Point3<f32>], eps: f32, min_points: usize) -> Vec<Option<u32>> {
        let around = |i: usize| (0..points.len()).filter(|&j| near(&points[i], &points[j], eps)).collect::<Vec<_>>();
        let mut labels = vec![None; points.len()];
        let mut next = 0;
        for i in 0..points.len() {
            if labels[i].is_some() || around(i).len() < min_points {
                continue;
            }
            labels[i] = Some(next);
            let mut queue = vec![i];
            while let Some(j) = queue.pop() {
                if around(j).len() < min_points {
                    continue;
                }
                for k in around(j) {
                    if labels[k].is_none() {
                        labels[k] = Some(next);
                        queue.push(k);
                    }
                }
            }
            next += 1;
        }
        labels
    }

    proptest! {
        #[test]
        fn dbscan_equals_the_plain_algorithm(points in points(), eps in 0.05..0.6f64, min_points in 1usize..8) {
            let found = dbscan(&points, &DbscanParams { eps_m: eps, min_points }).unwrap();
            let plain = plain_dbscan(&points, eps as f32, min_points);
            prop_assert_eq!(&dbscan_by_tree(&points, eps as f32, min_points), &found);
            prop_assert_eq!(found.labels, plain);
        }

        #[test]
        fn distances_that_grow_with_range_join_what_both_points_reach(
            points in points(), eps in 0.02..0.2f64, slope in 0.01..0.5f64,
        ) {
            let params = ClusterParams { eps_m: eps, min_points: 1, eps_slope: slope };
            let found = cluster(&points, &params).unwrap();
            let reach = |p: &Point3<f32>| (eps + slope * p.coords.cast::<f64>().norm()) as f32;
            let mut sets = DisjointSets::new(points.len());
            for (i, p) in points.iter().enumerate() {
                for (j, q) in points[..i].iter().enumerate() {
                    if near(p, q, reach(p).min(reach(q))) {
                        sets.unite(i as u32, j as u32);
                    }
                }
            }
            for i in 0..points.len() {
                for j in (0..i).filter(|&j| is_finite(&points[i]) && is_finite(&points[j])) {
                    let together = sets.root(i as u32) == sets.root(j as u32);
                    prop_assert_eq!(found.labels[i] == found.labels[j], together);
                }
            }
        }

        #[test]
        fn clusters_are_components_numbered_by_first_point(points in points(), eps in 0.05..0.6f64) {
            // With one point enough for a core, DBSCAN's clusters are the components.
            let found = cluster(&points, &ClusterParams { eps_m: eps, min_points: 1, eps_slope: 0.0 }).unwrap();
            prop_assert_eq!(&found.labels, &plain_dbscan(&points, eps as f32, 1));
            prop_assert_eq!(found.indices().iter().map(Vec::len).sum::<usize>(),
                            points.iter().filter(|p| is_finite(p)).count());
        }
    }

    #[test]
    fn a_cloud_too_wide_for_cells_is_clustered_all_the_same() {
        let mut points = vec![Point3::new(1e7, 0.0, 0.0); 12];
        points.extend((0..20).map(|i| Point3::new(i as f32 * 1e-3, 0.0, 0.0)));
        let found = dbscan(&points, &DbscanParams { eps_m: 1e-3, min_points: 2 }).unwrap();
        assert!(Cells::new(&points, 1e-3).is_none());
        assert_eq!(found.labels, plain_dbscan(&points, 1e-3, 2));
    }

    #[test]
    fn small_clusters_are_noise_and_labels_stay_dense() {
        let mut points = vec![Point3::new(5.0, 0.0, 0.0); 3];
        points.extend((0..20).map(|i| Point3::new(i as f32 * 0.04, 0.0, 0.0)));
        points.extend((0..20).map(|i| Point3::new(1e7, i as f32 * 0.04, 0.0)));
        let found = cluster(&points, &ClusterParams::default()).unwrap();
        assert_eq!(found.num_clusters, 2);
        assert_eq!((found.labels[0], found.labels[3], found.labels[23]), (None, Some(0), Some(1)));
    }

    #[test]
    fn nothing_and_nonsense() {
        assert_eq!(cluster(&[], &ClusterParams::default()).unwrap(), Clusters::default());
        assert!(
            cluster(&[], &ClusterParams { eps_m: 0.0, ..ClusterParams::default() })
                .unwrap_err()
                .to_string()
                .starts_with("eps_m")
        );
        assert!(dbscan(&[], &DbscanParams { eps_m: 0.1, min_points: 0 }).is_err());
    }
}

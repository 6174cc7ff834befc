//! Normals whose signs agree.

use super::at_least;
use crate::search::KdTree;
use nalgebra::{Point3, Vector3};
use percept_geometry::GeometryError;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Edges are kept for all points at once, a bound on memory.
const MAX_NEIGHBORS: usize = 100;

/// How [`orient_by_spanning_tree`] connects points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpanningTreeParams {
    /// Nearest other points that a normal is compared with, 1 to 100; more reach over gaps, and over thin walls.
    pub tree_neighbours: usize,
}

impl Default for SpanningTreeParams {
    fn default() -> Self {
        Self { tree_neighbours: 12 }
    }
}

impl SpanningTreeParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        at_least("tree_neighbours", self.tree_neighbours, 1, "at least 1")?;
        if self.tree_neighbours > MAX_NEIGHBORS {
            let (value, requirement) = (self.tree_neighbours as f64, "at most 100");
            return Err(GeometryError::OutOfRange { field: "tree_neighbours", value, requirement });
        }
        Ok(())
    }
}

/// Turns unit normals (`N x 3`, zero where undefined, which stay) so that neighbours look to the same side: along a
/// minimum spanning tree of the graph of nearest neighbours, whose edges cost the more the more the planes are turned.
/// The normal of the highest point (largest z) of each connected part looks up.
///
/// Source: Hoppe et al., "Surface reconstruction from unorganized points", 1992, section 3.3. Parts of the graph that
/// no edge connects are turned by themselves there as here; no Euclidean tree joins them, as a gap says nothing.
///
/// # Errors
/// `OutOfRange` naming the parameter; `ShapeMismatch` if normals and points are not of one number.
pub fn orient_by_spanning_tree(
    points: &[Point3<f32>],
    normals: &mut [Vector3<f32>],
    params: &SpanningTreeParams,
) -> Result<(), GeometryError> {
    params.validate()?;
    if normals.len() != points.len() {
        let (expected, actual) = (points.len(), normals.len());
        return Err(GeometryError::ShapeMismatch { field: "normals", expected, actual });
    }
    let mut sides = Sides::new(points.len());
    for edge in edges(points, normals, params.tree_neighbours) {
        let opposite = normals[edge.a as usize].dot(&normals[edge.b as usize]) < 0.0;
        sides.unite(edge.a, edge.b, opposite);
    }
    let turn = sides.turned_up(points, normals);
    normals.iter_mut().zip(turn).filter(|(_, turn)| *turn).for_each(|(n, _)| *n = -*n);
    Ok(())
}

/// Two neighbours. The order of edges is that of their cost, then of their points.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    /// One less the cosine between the planes, as the bits of a float: those of floats above 0 are ordered like them.
    cost: u32,
    a: u32,
    b: u32,
}

/// Edges between points with normals, cheapest first; some come twice.
fn edges(points: &[Point3<f32>], normals: &[Vector3<f32>], tree_neighbours: usize) -> Vec<Edge> {
    let neighbors = KdTree::build(points).knn_all(tree_neighbours + 1);
    let has_normal = |i: u32| normals[i as usize] != Vector3::zeros();
    let edges_of = |a: usize| {
        let edge = move |&b: &u32| {
            let (low, high) = ((a as u32).min(b), (a as u32).max(b));
            let cosine = normals[a].dot(&normals[b as usize]).abs();
            Edge { cost: (1.0 - cosine).max(0.0).to_bits(), a: low, b: high }
        };
        let others = neighbors.of(a).0.iter().filter(move |&&b| b as usize != a && has_normal(b));
        others.map(edge).filter(move |_| has_normal(a as u32))
    };
    let mut out: Vec<Edge> = (0..points.len()).into_par_iter().flat_map_iter(edges_of).collect();
    out.par_sort_unstable();
    out
}

/// Disjoint sets that know of each member on which side of the set's root its normal looks.
struct Sides {
    parent: Vec<u32>,
    /// Whether a member looks to the other side than its parent.
    opposite: Vec<bool>,
}

impl Sides {
    fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect(), opposite: vec![false; n] }
    }

    /// The root, and whether `i` looks to the other side than it. Halves the path.
    fn root(&mut self, mut i: u32) -> (u32, bool) {
        let mut opposite = false;
        while self.parent[i as usize] != i {
            let parent = self.parent[i as usize] as usize;
            self.opposite[i as usize] ^= self.opposite[parent];
            self.parent[i as usize] = self.parent[parent];
            opposite ^= self.opposite[i as usize];
            i = self.parent[i as usize];
        }
        (i, opposite)
    }

    /// Makes two sets one (Kruskal's step), unless they are.
    fn unite(&mut self, a: u32, b: u32, opposite: bool) {
        let ((a, a_opposite), (b, b_opposite)) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        if low != high {
            self.parent[high as usize] = low;
            self.opposite[high as usize] = opposite ^ a_opposite ^ b_opposite;
        }
    }

    /// Which normals have to be turned so that the highest of each set looks up.
    fn turned_up(&mut self, points: &[Point3<f32>], normals: &[Vector3<f32>]) -> Vec<bool> {
        let roots: Vec<(u32, bool)> = (0..points.len() as u32).map(|i| self.root(i)).collect();
        let mut highest: Vec<u32> = (0..points.len() as u32).collect();
        for (i, &(root, _)) in roots.iter().enumerate() {
            let best = &mut highest[root as usize];
            if points[i].z > points[*best as usize].z {
                *best = i as u32;
            }
        }
        let is_down = |&(root, opposite): &(u32, bool)| {
            let top = highest[root as usize] as usize;
            opposite ^ roots[top].1 ^ (normals[top].z < 0.0)
        };
        roots.iter().map(is_down).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a sphere by a Fibonacci lattice, its normals outward and inward in turn.
    fn sphere(center: Vector3<f32>, n: usize) -> (Vec<Point3<f32>>, Vec<Vector3<f32>>) {
        let outward = |i: usize| {
            let z = 1.0 - (2 * i + 1) as f32 / n as f32;
            let (s, c) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Vector3::new(r * c, r * s, z)
        };
        let sign = |i: usize| if i.is_multiple_of(3) { 1.0 } else { -1.0 };
        (0..n).map(|i| (Point3::from(center + outward(i)), outward(i) * sign(i))).unzip()
    }

    #[test]
    fn all_normals_of_closed_surfaces_look_outward() {
        let (mut points, mut normals) = sphere(Vector3::new(0.0, 0.0, 4.0), 2000);
        let (more, of_more) = sphere(Vector3::new(5.0, 1.0, -3.0), 1500);
        points.extend(more);
        normals.extend(of_more);
        orient_by_spanning_tree(&points, &mut normals, &SpanningTreeParams::default()).unwrap();
        for (i, (p, n)) in points.iter().zip(&normals).enumerate() {
            let center = if i < 2000 { Point3::new(0.0, 0.0, 4.0) } else { Point3::new(5.0, 1.0, -3.0) };
            assert!(n.dot(&(p - center)) > 0.99, "{i}");
        }
    }

    #[test]
    fn signs_go_around_an_edge() {
        // Both sides of a roof, and of a valley beside it.
        let mut points = Vec::new();
        let mut normals = Vec::new();
        for i in 0..3200usize {
            let (x, y) = ((i % 40) as f32 * 0.05, (i / 40) as f32 * 0.05 - 0.975);
            let slope = if (-1.0..0.0).contains(&y) || y > 2.0 { 0.7 } else { -0.7 };
            let height = if y < 2.0 { -0.7 * y.abs() } else { -1.4 + 0.7 * (y - 2.0) };
            points.push(Point3::new(x, y, height));
            normals.push(Vector3::new(0.0, -slope, 1.0).normalize() * if i.is_multiple_of(2) { 1.0 } else { -1.0 });
        }
        orient_by_spanning_tree(&points, &mut normals, &SpanningTreeParams::default()).unwrap();
        assert!(normals.iter().all(|n| n.z > 0.0));
    }

    #[test]
    fn undefined_normals_stay_and_part_nothing() {
        let (mut points, mut normals) = sphere(Vector3::zeros(), 1000);
        for i in (0..1000).step_by(7) {
            normals[i] = Vector3::zeros();
        }
        points.push(Point3::from([f32::NAN; 3]));
        normals.push(Vector3::zeros());
        orient_by_spanning_tree(&points, &mut normals, &SpanningTreeParams::default()).unwrap();
        let outward = |(p, n): (&Point3<f32>, &Vector3<f32>)| *n == Vector3::zeros() || n.dot(&p.coords) > 0.99;
        assert!(points.iter().zip(&normals).all(outward));
        assert_eq!(normals.iter().filter(|n| **n == Vector3::zeros()).count(), 144);
        orient_by_spanning_tree(&[], &mut [], &SpanningTreeParams::default()).unwrap();
        assert!(orient_by_spanning_tree(&points, &mut [], &SpanningTreeParams::default()).is_err());
        for (tree_neighbours, name) in [(0, "tree_neighbours"), (101, "tree_neighbours")] {
            let error = orient_by_spanning_tree(&[], &mut [], &SpanningTreeParams { tree_neighbours }).unwrap_err();
            assert!(error.to_string().starts_with(name));
        }
    }

    #[test]
    fn the_tree_is_that_of_all_edges_searched_by_prim() {
        // Signs by Prim's algorithm from the highest point, over the same graph.
        let (points, normals) = sphere(Vector3::zeros(), 300);
        let turn =
            |i: usize| nalgebra::Rotation3::from_euler_angles(0.9 * (i as f32).sin(), 0.7 * (i as f32).cos(), 0.0);
        let normals: Vec<Vector3<f32>> = normals.iter().enumerate().map(|(i, n)| turn(i) * n).collect();
        let graph = edges(&points, &normals, 6);
        let mut expected = normals.clone();
        let top = (0..300).max_by(|&a, &b| points[a].z.total_cmp(&points[b].z)).unwrap();
        if expected[top].z < 0.0 {
            expected[top] = -expected[top];
        }
        let mut reached = vec![false; 300];
        reached[top] = true;
        while let Some(e) = graph.iter().find(|e| reached[e.a as usize] != reached[e.b as usize]) {
            let (from, to) = if reached[e.a as usize] { (e.a, e.b) } else { (e.b, e.a) };
            if expected[from as usize].dot(&expected[to as usize]) < 0.0 {
                expected[to as usize] = -expected[to as usize];
            }
            reached[to as usize] = true;
        }
        let mut found = normals;
        orient_by_spanning_tree(&points, &mut found, &SpanningTreeParams { tree_neighbours: 6 }).unwrap();
        assert!(reached.iter().all(|r| *r));
        assert_eq!(found, expected);
    }
}

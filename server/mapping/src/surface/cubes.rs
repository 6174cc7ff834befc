//! The cases of marching cubes, derived when they are first needed.
//!
//! Source: Lorensen and Cline, "Marching cubes: a high resolution 3D surface construction algorithm", 1987. The cases are not
//! tabled by hand: on each face of the cube, each run of corners behind the surface is cut off by one segment, from the edge at which a
//! walk around the face comes behind the surface to that at which it comes out again. The walks of two faces run along their
//! common edge in opposite directions, so that segments close into rings. What a face shows depends on its own four corners
//! alone: cubes that share it agree, also where corners alternate, and the surface has no cracks.

use std::sync::LazyLock;

/// Corners of a cube by bits: x, y, z.
const CORNERS: usize = 8;
/// Corners of each face, counter-clockwise as seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// An edge of a cube: its axis times 4, and a bit for each of the two axes after that, in order.
pub(super) type Edge = u8;
/// Edges of a cube.
pub(super) const EDGES: usize = 12;

/// Triangles of each case, as edges, counter-clockwise as seen from where the surface is seen.
pub(super) static CASES: LazyLock<Vec<Vec<[Edge; 3]>>> = LazyLock::new(|| (0..1 << CORNERS).map(triangles).collect());

/// The corner at the lower end of an edge, and the edge's axis.
pub(super) fn edge_from(edge: Edge) -> ([usize; 3], usize) {
    let axis = usize::from(edge / 4);
    let mut corner = [0; 3];
    corner[(axis + 1) % 3] = usize::from(edge & 1);
    corner[(axis + 2) % 3] = usize::from(edge >> 1 & 1);
    (corner, axis)
}

/// The edge between two corners that differ along one axis.
fn edge_between(a: usize, b: usize) -> Edge {
    let (low, axis) = (a & b, (a ^ b).trailing_zeros() as usize);
    let bit = |axis: usize| low >> (axis % 3) & 1;
    (axis * 4 + bit(axis + 1) + 2 * bit(axis + 2)) as Edge
}

/// Triangles of a case: bit `i` says whether corner `i` lies behind the surface.
fn triangles(case: usize) -> Vec<[Edge; 3]> {
    // Where the segment leads that begins at an edge.
    let mut next: [Option<Edge>; EDGES] = [None; EDGES];
    let is_behind = |corner: usize| case >> corner & 1 == 1;
    for face in FACES {
        for i in 0..4 {
            let side = |k: usize| (face[k % 4], face[(k + 1) % 4]);
            let (a, b) = side(i);
            if is_behind(a) || !is_behind(b) {
                continue;
            }
            let out = (1..4).map(|k| side(i + k)).find(|(a, b)| is_behind(*a) && !is_behind(*b));
            if let Some(out) = out {
                next[usize::from(edge_between(a, b))] = Some(edge_between(out.0, out.1));
            }
        }
    }
    let mut found = vec![];
    for first in 0..EDGES {
        let mut ring = vec![];
        let mut at = first;
        while let Some(edge) = next[at].take() {
            ring.push(edge);
            at = usize::from(edge);
        }
        found.extend(fan(&ring));
    }
    found
}

/// A ring as triangles, from the first corner of which no diagonal lies in a face of the cube, where the next cube may have the
/// same.
fn fan(ring: &[Edge]) -> Vec<[Edge; 3]> {
    let n = ring.len();
    if n < 3 {
        return vec![];
    }
    let of = |root: usize, k: usize| ring[(root + k) % n];
    let is_inner = |root: &usize| (2..n - 1).all(|k| !share_a_face(of(*root, 0), of(*root, k)));
    let root = (0..n).find(is_inner).unwrap_or(0);
    (1..n - 1).map(|k| [of(root, 0), of(root, k), of(root, k + 1)]).collect()
}

fn share_a_face(a: Edge, b: Edge) -> bool {
    let on = |edge: Edge, face: &[usize; 4]| (0..4).any(|i| edge_between(face[i], face[(i + 1) % 4]) == edge);
    FACES.iter().any(|face| on(a, face) && on(b, face))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Edges whose two corners lie on different sides.
    fn crossed(case: usize) -> Vec<Edge> {
        let pairs = (0..CORNERS).flat_map(|a| (0..3).map(move |axis| (a, a | 1 << axis))).filter(|(a, b)| a != b);
        let mut edges: Vec<Edge> =
            pairs.filter(|(a, b)| case >> a & 1 != case >> b & 1).map(|(a, b)| edge_between(a, b)).collect();
        edges.sort_unstable();
        edges
    }

    #[test]
    fn every_case_uses_the_edges_that_the_surface_crosses_and_has_borders_on_faces_alone() {
        for (case, triangles) in CASES.iter().enumerate() {
            let mut used: Vec<Edge> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used, crossed(case), "case {case}");
            let mut sides: BTreeMap<(Edge, Edge), i32> = BTreeMap::new();
            for t in triangles {
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    *sides.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
                }
            }
            for ((a, b), balance) in sides.into_iter().filter(|s| s.1 != 0) {
                assert!(balance.abs() == 1 && share_a_face(a, b), "case {case}: {a} {b}");
            }
        }
    }

    #[test]
    fn cubes_that_share_a_face_have_the_same_segments_there_the_other_way_round() {
        // Along x: the right face of one is the left face of the other.
        let on_face = |case: usize, x: usize| {
            let mut found = vec![];
            for t in &CASES[case] {
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    let place = |e: Edge| (edge_from(e).1, edge_from(e).0);
                    let (p, q) = (place(a), place(b));
                    if p.0 != 0 && q.0 != 0 && p.1[0] == x && q.1[0] == x {
                        let flat = |p: (usize, [usize; 3])| (p.0, p.1[1], p.1[2]);
                        found.push((flat(p), flat(q)));
                    }
                }
            }
            // A diagonal in the face runs both ways.
            let all = found.clone();
            found.retain(|(a, b)| !all.contains(&(*b, *a)));
            found.sort_unstable();
            found
        };
        for left in 0..256usize {
            for right in 0..256usize {
                let fits = (0..4).all(|k| left >> (2 * k + 1) & 1 == right >> (2 * k) & 1);
                if fits {
                    let mut other: Vec<_> = on_face(right, 0).into_iter().map(|(a, b)| (b, a)).collect();
                    other.sort_unstable();
                    assert_eq!(on_face(left, 1), other, "{left} {right}");
                }
            }
        }
    }
}

//! A g2o file as a pose graph.

use crate::BenchError;
use percept_formats::g2o::{G2oEdge, G2oGraph};
use percept_geometry::information::from_upper_triangle;
use percept_slam::pose_graph::{Edge, Manifold, PoseGraph};
use std::collections::BTreeMap;

/// The graph of a file, its poses in the order of the vertices, and whether the file holds poses. Where it holds none, there
/// is one for every number that an edge names, ascending, at the origin. The first is fixed if the file fixes none.
///
/// # Errors
/// A vertex that is there twice, or one that has an edge and no pose.
pub fn pose_graph<R: Copy, P: Manifold<D>, const D: usize, const I: usize>(
    file: &G2oGraph<R, I>,
    from_row: impl Fn(R) -> P,
) -> Result<(PoseGraph<P, D>, bool), BenchError> {
    let has_poses = !file.vertices.is_empty();
    let index = numbered(file)?;
    let place =
        |id: u64| index.get(&id).copied().ok_or_else(|| BenchError(format!("vertex {id} has an edge, but no pose")));
    let mut fixed = file.fixed.iter().map(|id| place(*id)).collect::<Result<Vec<u32>, _>>()?;
    if fixed.is_empty() && !index.is_empty() {
        fixed.push(0);
    }
    let edge = |e: &G2oEdge<R, I>| -> Result<Edge<P, D>, BenchError> {
        let information = from_upper_triangle(&e.information);
        Ok(Edge { from: place(e.from)?, to: place(e.to)?, t_from_to: from_row(e.t_from_to), information })
    };
    let edges = file.edges.iter().map(edge).collect::<Result<Vec<_>, _>>()?;
    let poses = match has_poses {
        true => file.vertices.iter().map(|(_, row)| from_row(*row)).collect(),
        false => vec![P::identity(); index.len()],
    };
    Ok((PoseGraph { poses, edges, fixed }, has_poses))
}

/// Places of the vertices by their numbers in the file.
///
/// # Errors
/// A vertex that is there twice.
pub fn numbered<R: Copy, const I: usize>(file: &G2oGraph<R, I>) -> Result<BTreeMap<u64, u32>, BenchError> {
    let mut index: BTreeMap<u64, u32> = BTreeMap::new();
    if file.vertices.is_empty() {
        index.extend(file.edges.iter().flat_map(|e| [(e.from, 0), (e.to, 0)]));
        index.values_mut().zip(0..).for_each(|(place, k)| *place = k);
    }
    for (k, (id, _)) in (0..).zip(&file.vertices) {
        if index.insert(*id, k).is_some() {
            return Err(BenchError(format!("vertex {id} is there twice")));
        }
    }
    Ok(index)
}

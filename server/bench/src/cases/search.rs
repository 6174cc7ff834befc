//! Neighbours.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_perception::search::KdTree;
use serde_json::json;
use std::path::PathBuf;

/// `search_build file=`: the tree of a cloud.
pub(super) fn build(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    Ok(timed(points.len(), move || Ok(KdTree::build(&points)), |tree| json!({"points": tree.len()})))
}

/// `search_knn_all file= k=`: the k nearest of every point; the tree is there before, as it is for the others.
pub(super) fn knn_all(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let tree = KdTree::build(&read_cloud(&args.required::<PathBuf>("file")?)?.positions);
    let k = args.required("k")?;
    Ok(timed(
        tree.len(),
        move || Ok(tree.knn_all(k)),
        |found| {
            let sum: f64 = found.distances2.iter().map(|&d| f64::from(d).sqrt()).sum();
            json!({"neighbors": found.indices.len(), "mean_distance_m": sum / found.indices.len().max(1) as f64})
        },
    ))
}

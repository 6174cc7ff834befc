//! Planes, clusters, ground, objects.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use nalgebra::Vector3;
use percept_perception::cloud::{
    Clusters, DbscanParams, PlaneParams, PlanesParams, dbscan, segment_plane, segment_planes,
};
use serde_json::{Value, json};
use std::path::PathBuf;

fn plane_params(args: &Args) -> Result<PlaneParams, BenchError> {
    let params = PlaneParams::default();
    Ok(PlaneParams {
        distance_m: args.or("distance_m", params.distance_m)?,
        max_iterations: args.or("iterations", params.max_iterations)?,
        early_stop: args.or("early_stop", params.early_stop)?,
        seed: args.or("seed", params.seed)?,
        ..params
    })
}

/// `plane file= distance_m= iterations= early_stop=`: the largest plane, refined, with its points.
pub(super) fn plane(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = plane_params(args)?;
    let items = points.len();
    let work = move || segment_plane(&points, &params).map_err(BenchError::new);
    Ok(timed(items, work, |found| {
        let plane = found.as_ref().map(|f| [f.plane.normal.x, f.plane.normal.y, f.plane.normal.z, f.plane.offset]);
        json!({"inliers": found.as_ref().map_or(0, |f| f.inliers.len()), "plane": plane})
    }))
}

/// `planes file= distance_m= iterations= min_share=`: planes in turn until none holds the share of the cloud.
pub(super) fn planes(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let min_points = (args.or("min_share", 0.05)? * points.len() as f64).ceil() as usize;
    let plane = PlaneParams { min_points: min_points.max(3), ..plane_params(args)? };
    let params = PlanesParams { plane, max_planes: args.or("max_planes", 8)?, ..PlanesParams::default() };
    let items = points.len();
    let work = move || segment_planes(&points, &Vector3::z_axis(), &params).map_err(BenchError::new);
    Ok(timed(items, work, |found| {
        let sizes: Vec<usize> = found.iter().map(|p| p.segment.inliers.len()).collect();
        json!({"planes": sizes})
    }))
}

/// `clusters_dbscan file= eps_m= min_points=`: density-based clusters.
pub(super) fn clusters_dbscan(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = DbscanParams { eps_m: args.or("eps_m", 0.05)?, min_points: args.or("min_points", 10)? };
    let items = points.len();
    Ok(timed(items, move || dbscan(&points, &params).map_err(BenchError::new), sizes))
}

fn sizes(clusters: &Clusters) -> Value {
    let large = clusters.indices().iter().filter(|c| c.len() >= 100).count();
    json!({"clusters": clusters.num_clusters, "clusters_ge100": large})
}

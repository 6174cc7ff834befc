//! Filters and local geometry.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_perception::cloud::{
    NormalParams, RadiusOutlierParams, StatisticalOutlierParams, estimate_normals, local_features, radius_outliers,
    statistical_outliers, voxel_downsample,
};
use serde_json::json;
use std::path::PathBuf;

/// `outliers_statistical file= k= ratio=`.
pub(super) fn outliers_statistical(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = StatisticalOutlierParams { num_neighbours: args.or("k", 20)?, std_ratio: args.or("ratio", 2.0)? };
    let items = points.len();
    let work = move || statistical_outliers(&points, &params).map_err(BenchError::new);
    Ok(timed(items, work, |kept| json!({"out_points": kept.len()})))
}

/// `outliers_radius file= radius= min_neighbours=`.
pub(super) fn outliers_radius(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params =
        RadiusOutlierParams { radius_m: args.required("radius")?, min_neighbours: args.required("min_neighbours")? };
    let items = points.len();
    let work = move || radius_outliers(&points, &params).map_err(BenchError::new);
    Ok(timed(items, work, |kept| json!({"out_points": kept.len()})))
}

/// `voxel_downsample file= voxel_size_m=`.
pub(super) fn voxels(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let path: PathBuf = args.required("file")?;
    let (cloud, size) = (read_cloud(&path)?, args.required("voxel_size_m")?);
    let work = move || voxel_downsample(&cloud, size).map_err(BenchError::new);
    let items = read_cloud(&path)?.len();
    Ok(timed(items, work, |out| json!({"out_points": out.len()})))
}

/// `normals file= k=`, or with `radius_m= max_neighbours=`.
pub(super) fn normals(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let max_neighbours = args.or("k", args.or("max_neighbours", 30)?)?;
    let params = NormalParams { radius_m: args.or("radius_m", f64::INFINITY)?, max_neighbours, min_neighbours: 3 };
    let items = points.len();
    let work = move || estimate_normals(&points, &params, None).map_err(BenchError::new);
    Ok(timed(items, work, |normals| json!({"defined": normals.iter().filter(|n| n.norm_squared() > 0.0).count()})))
}

/// `local_features file= k=`.
pub(super) fn features(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let k = args.required("k")?;
    let items = points.len();
    let work = move || local_features(&points, k).map_err(BenchError::new);
    Ok(timed(items, work, |all| {
        let sum: f64 = all.iter().flatten().map(|f| f64::from(f.planarity)).sum();
        json!({"mean_planarity": sum / all.len().max(1) as f64})
    }))
}

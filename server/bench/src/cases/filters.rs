//! Filters and local geometry.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_perception::cloud::{
    RadiusOutlierParams, StatisticalOutlierParams, radius_outliers, statistical_outliers, voxel_downsample,
};
use serde_json::json;
use std::path::PathBuf;

/// `outliers_statistical file= k= ratio=`.
pub(super) fn outliers_statistical(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = StatisticalOutlierParams { num_neighbors: args.or("k", 20)?, std_ratio: args.or("ratio", 2.0)? };
    let items = points.len();
    let work = move || statistical_outliers(&points, &params).map_err(BenchError::new);
    Ok(timed(items, work, |kept| json!({"out_points": kept.len()})))
}

/// `outliers_radius file= radius= min_neighbors=`.
pub(super) fn outliers_radius(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params =
        RadiusOutlierParams { radius_m: args.required("radius")?, min_neighbors: args.required("min_neighbors")? };
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

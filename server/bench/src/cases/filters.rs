//! Filters of clouds.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_perception::cloud::voxel_downsample;
use serde_json::json;
use std::path::PathBuf;

/// `voxel_downsample file= voxel_size_m=`.
pub(super) fn voxels(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let path: PathBuf = args.required("file")?;
    let (cloud, size) = (read_cloud(&path)?, args.required("voxel_size_m")?);
    let work = move || voxel_downsample(&cloud, size).map_err(BenchError::new);
    let items = read_cloud(&path)?.len();
    Ok(timed(items, work, |out| json!({"out_points": out.len()})))
}

//! Files of clouds.

use super::{Case, timed};
use crate::{Args, BenchError};
use percept_formats::{Limits, read_cloud_file};
use percept_geometry::PointCloud;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Reads a cloud of any format.
pub(super) fn read_cloud(path: &Path) -> Result<PointCloud, BenchError> {
    read_cloud_file(path, &Limits::default()).map(|file| file.cloud).map_err(BenchError::new)
}

/// `load file=`: the file read and decoded.
pub(super) fn load(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let path: PathBuf = args.required("file")?;
    let items = read_cloud(&path)?.len();
    Ok(timed(items, move || read_cloud(&path), |cloud| json!({"points": cloud.len()})))
}

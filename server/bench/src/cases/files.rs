//! Files of clouds.

use super::{Case, timed};
use crate::{Args, BenchError};
use percept_formats::{Limits, pcd, ply, read_file};
use percept_geometry::PointCloud;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Reads a cloud by the ending of its name.
pub(super) fn read_cloud(path: &Path) -> Result<PointCloud, BenchError> {
    let limits = Limits::default();
    let bytes = read_file(path, &limits).map_err(BenchError::new)?;
    match path.extension().and_then(|e| e.to_str()) {
        Some("ply") => ply::decode(&bytes, &limits).map_err(BenchError::new),
        Some("pcd") => pcd::decode(&bytes, &limits).map(|f| f.cloud).map_err(BenchError::new),
        _ => Err(BenchError(format!("{}: not a .pcd or .ply file", path.display()))),
    }
}

/// `load file=`: the file read and decoded.
pub(super) fn load(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let path: PathBuf = args.required("file")?;
    let items = read_cloud(&path)?.len();
    Ok(timed(items, move || read_cloud(&path), |cloud| json!({"points": cloud.len()})))
}

//! Features of points, and registration with no first guess.

use super::files::read_cloud;
use super::registration::read_pose;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_perception::cloud::{NormalParams, estimate_normals};
use percept_perception::registration::{FpfhParams, GlobalParams, compute_fpfh, register_global};
use serde_json::json;
use std::path::PathBuf;

/// `fpfh file= radius_m= [max_neighbours=]`: features alone; normals of 20 neighbours are computed before.
pub(super) fn fpfh(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let cloud = read_cloud(&args.required::<PathBuf>("file")?)?;
    let params = FpfhParams { radius_m: args.required("radius_m")?, max_neighbours: args.or("max_neighbours", 0)? };
    let twenty = NormalParams { radius_m: f64::INFINITY, max_neighbours: 20, ..NormalParams::default() };
    let normals = estimate_normals(&cloud.positions, &twenty, None).map_err(BenchError::new)?;
    let items = cloud.len();
    let work = move || compute_fpfh(&cloud.positions, &normals, &params).map_err(BenchError::new);
    Ok(timed(items, work, |out| json!({"features": out.len()})))
}

/// `register_global source= target= truth= voxel_size_m=` [refine=]: from raw clouds to a judged transform.
pub(super) fn register(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let source = read_cloud(&args.required::<PathBuf>("source")?)?;
    let target = read_cloud(&args.required::<PathBuf>("target")?)?;
    let truth = read_pose(&args.required::<PathBuf>("truth")?)?;
    let refine = args.or("refine", true)?;
    let params = GlobalParams { voxel_size_m: args.required("voxel_size_m")?, refine, ..GlobalParams::default() };
    let items = source.len() + target.len();
    let work = move || register_global(&source, &target, &params).map_err(BenchError::new);
    Ok(timed(items, work, move |out| {
        let off = truth.inverse() * out.t_target_source;
        json!({
            "t_err_m": off.translation.vector.norm(),
            "r_err_deg": off.rotation.angle().to_degrees(),
            "outcome": format!("{:?}", out.outcome),
        })
    }))
}

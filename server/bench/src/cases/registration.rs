//! Local registration.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use percept_geometry::Pose;
use percept_perception::cloud::voxel_downsample;
use percept_perception::registration::{
    IcpMethod, IcpParams, IcpResult, PreparedCloud, RegisterParams, align, register as register_clouds,
};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// `register source= target= truth= method= voxel_size_m= max_distance_m= max_iterations= [preprocessed=true]`: raw
/// clouds to transform, or, preprocessed, the iterations alone.
pub(super) fn register(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let source = read_cloud(&args.required::<PathBuf>("source")?)?;
    let target = read_cloud(&args.required::<PathBuf>("target")?)?;
    let truth = read_pose(&args.required::<PathBuf>("truth")?)?;
    let icp = IcpParams {
        max_distance_m: args.or("max_distance_m", 1.0)?,
        max_iterations: args.or("max_iterations", 30)?,
        ..IcpParams::lidar(method(&args.required::<String>("method")?)?)
    };
    let size: f64 = args.required("voxel_size_m")?;
    let items = source.len() + target.len();
    let start = Pose::identity();
    if args.or("preprocessed", false)? {
        let thin = |cloud| voxel_downsample(cloud, size).map_err(BenchError::new);
        let source = PreparedCloud::source(&thin(&source)?, &icp).map_err(BenchError::new)?;
        let target = PreparedCloud::target(&thin(&target)?, &icp).map_err(BenchError::new)?;
        let items = source.len() + target.len();
        let work = move || align(&source, &target, &start, &icp).map_err(BenchError::new);
        return Ok(timed(items, work, move |result| extra(result, &truth)));
    }
    let params = RegisterParams { voxel_sizes_m: vec![size], icp };
    let work = move || register_clouds(&source, &target, &start, &params).map_err(BenchError::new);
    Ok(timed(items, work, move |result| extra(result, &truth)))
}

fn method(name: &str) -> Result<IcpMethod, BenchError> {
    serde_json::from_value(json!(name)).map_err(BenchError::new)
}

/// A 4x4 matrix in rows of text.
pub(super) fn read_pose(path: &Path) -> Result<Pose, BenchError> {
    let text = std::fs::read_to_string(path).map_err(BenchError::new)?;
    let values: Vec<f64> =
        text.split_whitespace().map(str::parse).collect::<Result<_, _>>().map_err(BenchError::new)?;
    if values.len() != 16 {
        return Err(BenchError(format!("{}: {} numbers, not 16", path.display(), values.len())));
    }
    let m = nalgebra::Matrix4::from_row_slice(&values);
    let r = nalgebra::Rotation3::from_matrix(&m.fixed_view::<3, 3>(0, 0).into_owned());
    let t = m.fixed_view::<3, 1>(0, 3).into_owned();
    Ok(Pose::from_parts(t.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&r)))
}

fn extra(result: &IcpResult, truth: &Pose) -> Value {
    let off = truth.inverse() * result.t_target_source;
    json!({
        "t_err_m": off.translation.vector.norm(),
        "r_err_deg": off.rotation.angle().to_degrees(),
        "iterations": result.iterations,
        "outcome": format!("{:?}", result.outcome),
        "fitness": result.inlier_ratio,
        "rmse_m": result.inlier_rmse_m,
    })
}

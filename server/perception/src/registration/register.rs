//! Raw clouds in, transform out: thinned, prepared and aligned, coarse to fine if asked.

use super::{IcpParams, IcpResult, PreparedCloud, RegistrationError, align};
use crate::cloud::voxel_downsample;
use percept_geometry::{PointCloud, Pose};
use serde::{Deserialize, Serialize};

/// Parameters of [`register`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegisterParams {
    /// Both clouds are thinned to one point a voxel of this edge, metres; the levels in turn, coarse to fine, each
    /// starting where the one before ended. Empty: the clouds as they are, once.
    pub voxel_sizes_m: Vec<f64>,
    /// The finest level; coarser ones pair points farther apart in proportion to their voxels.
    pub icp: IcpParams,
}

/// Lays `source` over `target` from a first guess of `t_target_source`. Non-finite points are left out.
///
/// A cloud's normals are used if it has them; coloured registration needs colours in both.
///
/// # Errors
/// `BadParam`, `TooFewPoints`, `Missing`, `Cloud`. Not converging is an answer.
pub fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Pose,
    params: &RegisterParams,
) -> Result<IcpResult, RegistrationError> {
    let Some((&finest, coarser)) = params.voxel_sizes_m.split_last() else {
        return at_level(source, target, start, &params.icp);
    };
    let mut start = *start;
    for &size in coarser {
        let scale = (size / finest).max(1.0);
        let icp = IcpParams { max_distance_m: params.icp.max_distance_m * scale, ..params.icp.clone() };
        let (source, target) = rayon::join(|| thinned(source, size), || thinned(target, size));
        start = at_level(&source?, &target?, &start, &icp)?.t_target_source;
    }
    let (source, target) = rayon::join(|| thinned(source, finest), || thinned(target, finest));
    at_level(&source?, &target?, &start, &params.icp)
}

fn at_level(
    source: &PointCloud,
    target: &PointCloud,
    start: &Pose,
    params: &IcpParams,
) -> Result<IcpResult, RegistrationError> {
    let (source, target) =
        rayon::join(|| PreparedCloud::source(source, params), || PreparedCloud::target(target, params));
    align(&source?, &target?, start, params)
}

fn thinned(cloud: &PointCloud, size: f64) -> Result<PointCloud, RegistrationError> {
    Ok(voxel_downsample(cloud, size)?)
}

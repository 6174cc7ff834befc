//! Two clouds to a transform.

use super::{Toolbox, registration_error};
use crate::Result;
use percept_geometry::{PointCloud, Pose};
use percept_perception::cloud::{NormalParams, estimate_normals};
use percept_perception::registration::{
    Fpfh, FpfhParams, GlobalParams, GlobalResult, GlobalSearch, IcpResult, RegisterParams, compute_fpfh, register,
};
use std::borrow::Cow;

/// Lays a source over a target from an initial `t_target_source`.
///
/// # Errors
/// `REGISTRATION_INVALID`: too few points, parameters out of bounds, a channel that the method needs is not there;
/// `VOXEL_TOO_SMALL`.
pub fn register_clouds(
    source: &PointCloud,
    target: &PointCloud,
    initial: &Pose,
    params: &RegisterParams,
) -> Result<IcpResult> {
    register(source, target, initial, params).map_err(registration_error)
}

impl Toolbox {
    /// Lays a source over a target with no first guess. That nothing was found is an answer.
    ///
    /// # Errors
    /// `REGISTRATION_INVALID`: too few points, parameters out of bounds; `VOXEL_TOO_SMALL`; `COMPUTATION_TOO_LONG`.
    pub fn register_clouds_globally(
        &self,
        source: &PointCloud,
        target: &PointCloud,
        params: &GlobalParams,
    ) -> Result<GlobalResult> {
        let search = GlobalSearch::new(Cow::Borrowed(source), Cow::Borrowed(target), params);
        let (mut search, mut step) = (search.map_err(registration_error)?, 0);
        loop {
            self.begin_step(step, GlobalSearch::MAX_STEPS, "register_clouds_globally")?;
            if let Some(answer) = search.step() {
                return answer.map_err(registration_error);
            }
            step += 1;
        }
    }
}

/// A feature for every point; normals are estimated from 20 neighbours if the cloud has none.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn compute_point_features(cloud: &PointCloud, params: &FpfhParams) -> Result<Vec<Fpfh>> {
    let estimated;
    let normals = match &cloud.normals {
        Some(normals) => normals,
        None => {
            let twenty = NormalParams { radius_m: params.radius_m, max_neighbours: 20, ..NormalParams::default() };
            estimated = estimate_normals(&cloud.positions, &twenty, None)?;
            &estimated
        }
    };
    Ok(compute_fpfh(&cloud.positions, normals, params)?)
}

//! What local registration minimises, its parameters, and why it cannot run.

use super::RobustKernel;
use crate::cloud::CloudError;
use serde::{Deserialize, Serialize};

/// What local registration minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IcpMethod {
    /// Distances of points (Besl and McKay 1992): needs no normals, converges slowly.
    PointToPoint,
    /// Distances from the target's tangent planes (Chen and Medioni 1992).
    #[default]
    PointToPlane,
    /// Differences weighted by the surfaces of both (Segal et al. 2009).
    Gicp,
    /// As [`IcpMethod::Gicp`], against the mean surface of the target's voxels (Koide et al. 2021): no nearest search.
    Vgicp,
    /// Distances from tangent planes, and differences of brightness along them (Park et al. 2017).
    Colored,
}

/// Parameters of local registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IcpParams {
    /// What is minimised.
    pub method: IcpMethod,
    /// Points farther apart do not correspond, metres, above 0. A few times the expected misalignment.
    pub max_distance_m: f64,
    /// Most iterations, 1 to 1000.
    pub max_iterations: usize,
    /// Converged once a step is shorter, metres, above 0.
    pub translation_tolerance_m: f64,
    /// Converged once a step turns less, radians, above 0.
    pub rotation_tolerance_rad: f64,
    /// How much a residual counts. Its scale is in metres; for GICP and VGICP metres along the surface, and about a
    /// thirtieth of that across it.
    pub kernel: RobustKernel,
    /// A direction with a smaller share of the residuals' sensitivity is degenerate, 0 to 0.3.
    pub degeneracy_threshold: f64,
    /// Point-to-plane only: how much the difference along the plane counts beside the one across it, 0 to 1. 0 is the
    /// classic method; 0.1 keeps sparse scans from sliding along ill-defined normals.
    pub tangent_weight: f64,
    /// Normals come from so many nearest points, the point itself among them, 3 to 1000.
    pub num_neighbours: usize,
    /// VGICP only: edge of the target's voxels, metres, above 0.
    pub target_voxel_size_m: f64,
    /// Coloured only: share of the brightness in what is minimised, 0 to 1 (the paper's 0.032).
    pub colour_share: f64,
}

impl Default for IcpParams {
    fn default() -> Self {
        Self {
            method: IcpMethod::default(),
            max_distance_m: 0.02,
            max_iterations: 50,
            translation_tolerance_m: 1e-5,
            rotation_tolerance_rad: 1e-5,
            kernel: RobustKernel::None,
            degeneracy_threshold: 0.002,
            tangent_weight: 0.0,
            num_neighbours: 20,
            target_voxel_size_m: 1.0,
            colour_share: 0.032,
        }
    }
}

/// Why two clouds cannot be aligned at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is not {requirement}; {remedy}")]
    BadParam {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
        /// What to do instead.
        remedy: &'static str,
    },
    /// A cloud has too few finite points.
    #[error("{field}: {num_points} finite points are fewer than {needed}")]
    TooFewPoints {
        /// Which cloud.
        field: &'static str,
        /// Finite points that it has.
        num_points: usize,
        /// Points that are needed.
        needed: usize,
    },
    /// The method needs what the cloud was not prepared with.
    #[error("{cloud}: has no {channel}, which the method needs")]
    Missing {
        /// Which cloud.
        cloud: &'static str,
        /// What it lacks: colors, normals, voxels.
        channel: &'static str,
    },
    /// A cloud could not be thinned.
    #[error(transparent)]
    Cloud(#[from] CloudError),
}

impl IcpParams {
    /// For scans of a spinning lidar thinned to about 0.25 m, metres apart at most: wide pairs, robust against what
    /// one scan sees and the other does not, steps of a millimetre and a tenth of a degree at the end.
    pub fn lidar(method: IcpMethod) -> Self {
        let surfaces = matches!(method, IcpMethod::Gicp | IcpMethod::Vgicp);
        Self {
            method,
            max_distance_m: 1.0,
            max_iterations: 30,
            translation_tolerance_m: 1e-3,
            rotation_tolerance_rad: 0.1f64.to_radians(),
            // Covariances already discount what is off along the surface.
            kernel: if surfaces { RobustKernel::None } else { RobustKernel::Huber(0.2) },
            tangent_weight: 0.1,
            num_neighbours: 10,
            ..Self::default()
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// `BadParam` with field, value and remedy.
    pub fn validate(&self) -> Result<(), RegistrationError> {
        let bad =
            |field, value, requirement, remedy| Err(RegistrationError::BadParam { field, value, requirement, remedy });
        let kernel_scale = match self.kernel {
            RobustKernel::None => 1.0,
            RobustKernel::Huber(s)
            | RobustKernel::Cauchy(s)
            | RobustKernel::GemanMcClure(s)
            | RobustKernel::Tukey(s) => s,
        };
        let positive = [
            ("max_distance_m", self.max_distance_m),
            ("translation_tolerance_m", self.translation_tolerance_m),
            ("rotation_tolerance_rad", self.rotation_tolerance_rad),
            ("target_voxel_size_m", self.target_voxel_size_m),
            ("kernel", kernel_scale),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return bad(field, value, "positive and finite", "leave it out for the default");
            }
        }
        for (field, value) in [("tangent_weight", self.tangent_weight), ("colour_share", self.colour_share)] {
            if !(0.0..=1.0).contains(&value) {
                return bad(field, value, "within 0 to 1", "leave it out for the default");
            }
        }
        for (field, value, least) in
            [("max_iterations", self.max_iterations, 1), ("num_neighbours", self.num_neighbours, 3)]
        {
            if !(least..=1000).contains(&value) {
                return bad(field, value as f64, "within 1 (neighbours 3) to 1000", "leave it out for the default");
            }
        }
        if !(0.0..=0.3).contains(&self.degeneracy_threshold) {
            return bad("degeneracy_threshold", self.degeneracy_threshold, "within 0 to 0.3", "use 0.002");
        }
        Ok(())
    }
}

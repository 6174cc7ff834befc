//! Registration: two sets of points in, the transform between them with its uncertainty out.
//!
//! Parts that odometry and the toolbox share: [`factors`] (one residual a file), [`RobustKernel`],
//! [`NormalEquations`] summed in fixed chunks, [`Degeneracy`] of the result and [`icp`], the plain
//! iterative closest point of two clouds. Perturbations are on the right, `t_target_source * exp(xi)`.
//! No global search and no feature matching live here.

pub mod degeneracy;
pub mod factors;
pub mod icp;
pub mod kernel;
pub mod normal_equations;

pub use degeneracy::Degeneracy;
pub use icp::{IcpParams, IcpResult, RegistrationError, align_point_to_plane, align_point_to_point};
pub use kernel::RobustKernel;
pub use normal_equations::{NormalEquations, accumulate};

//! Registration: two sets of points in, the transform between them with its uncertainty out.
//!
//! [`register()`] takes raw clouds; [`align`] takes [`PreparedCloud`]s, which can be used many times. Parts that odometry
//! shares: [`factors`] (one residual a file), [`RobustKernel`], [`NormalEquations`] summed in fixed chunks, and
//! [`Degeneracy`] of the result. Perturbations are on the right, `t_target_source * exp(xi)`. [`register_global`] needs no
//! first guess; its features are [`compute_fpfh`]'s.

pub mod degeneracy;
pub mod factors;
mod fpfh;
mod gaussian_voxels;
mod global;
pub mod icp;
pub mod kernel;
pub mod normal_equations;
mod pair_bins;
mod pair_block;
mod pairing;
mod params;
mod prepared;
mod register;

pub use degeneracy::Degeneracy;
pub use fpfh::{FPFH_LEN, Fpfh, FpfhParams, compute_fpfh};
pub use gaussian_voxels::{GaussianVoxel, GaussianVoxels};
pub use global::{GlobalMethod, GlobalOutcome, GlobalParams, GlobalResult, GlobalSearch, register_global};
pub use icp::{IcpOutcome, IcpResult, align};
pub use kernel::RobustKernel;
pub use normal_equations::{NormalEquations, accumulate};
pub use pair_block::PairBlock;
pub use params::{IcpMethod, IcpParams, RegistrationError};
pub use prepared::PreparedCloud;
pub use register::{RegisterParams, register};
